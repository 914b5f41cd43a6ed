"""The log-det ("entropic") prior: divergence of pseudo-inertias instead of a squared distance.

D(P | P0) = tr(P0^-1 P) - log det(P0^-1 P) - 4 does not depend on the body's axes, origin or units and is infinite at
the boundary of what is physical. In relative parameters it is tr W - log det W - 4, already whitened, and 2 D is
||x - x0||^2 to second order; each body's term is weighed so that this curvature has the mean precision of the prior
covariance over its ten parameters. Correlations between bodies are not part of it.

Reference: Lee, Wensing, Park, IEEE T-RO 36(1), 2020, eqs. 18-22.
"""

import warnings

import cvxpy as cp
import numpy as np
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError
from torchid.inertia.cone import Boxes, ConeSolution, Matrix, Vector, squares
from torchid.inertia.pseudo import triangle, untriangle

_NEWTON_STEPS = 20
_TOUCHED = 1e-5
"""Multiplier above which a box counts as touched."""


def body_weights(
    covariance: Float[Tensor, "params params"], T: Float[Tensor, "bodies 10 10"]
) -> Float[Tensor, " bodies"]:
    """Weight of each body's divergence: mean prior precision over its ten relative parameters."""
    bodies = len(T)
    blocks = covariance.reshape(bodies, 10, bodies, 10).diagonal(dim1=0, dim2=2).movedim(-1, 0)
    relative = torch.linalg.solve(T, torch.linalg.solve(T, blocks).mT)
    return 10 / relative.diagonal(dim1=-2, dim2=-1).sum(-1)


def curvature_covariance(
    weights: Float[Tensor, " bodies"], T: Float[Tensor, "bodies 10 10"]
) -> Float[Tensor, "params params"]:
    """Covariance of the Gaussian that has the divergence's curvature at the prior mean."""
    return torch.block_diag(*(T @ T.mT / weights[:, None, None]))


def divergence(x: Float[Tensor, "bodies 10"]) -> Float[Tensor, " bodies"]:
    """2 D of each body, from relative parameters."""
    W = untriangle(x)
    return 2 * (W.diagonal(dim1=-2, dim2=-1).sum(-1) - torch.logdet(W) - 4)


def divergence_slope(x: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 10"]:
    """Gradient of ``divergence`` with respect to the relative parameters."""
    W = untriangle(x)
    eye = torch.eye(4, dtype=x.dtype, device=x.device)
    return 2 * triangle(eye - torch.linalg.inv(W))


def _curvature(x: np.ndarray) -> np.ndarray:
    """Hessian (bodies, 10, 10) of ``divergence``: 2 W^-1 dW W^-1."""
    inverse = torch.linalg.inv(untriangle(torch.from_numpy(x)))[:, None]
    units = untriangle(torch.eye(10, dtype=torch.float64))
    return 2 * triangle(inverse @ units @ inverse).mT.numpy()


def minimise(start: Vector, hessian: Matrix, pull: Vector, weights: np.ndarray, boxes: Boxes = ()) -> ConeSolution:
    """Minimise x' hessian x - 2 pull' x + sum of weights * divergence.

    Args:
        start: optimum of the quadratic approximation; the centre of the solver's coordinates.
        hessian, pull: of the data, in relative parameters.
        weights: omega_2 times ``body_weights``.
        boxes: rows C with C x >= 0.

    Raises:
        DataError: Clarabel found no solution.
    """
    factor = np.linalg.cholesky(hessian + np.diag(np.repeat(weights, 10))).T
    rotate = scipy.linalg.solve_triangular(factor, np.eye(len(start)))
    values, axes = np.linalg.eigh(rotate.T @ hessian @ rotate)
    root = np.sqrt(values.clip(0))[:, None] * axes.T
    w = cp.Variable(len(start))
    x = start + rotate @ w
    terms = [2 * k * (cp.trace(W) - cp.log_det(W)) for k, W in zip(weights, squares(x, len(weights)), strict=True)]
    slope = 2 * rotate.T @ (hessian @ start - pull)
    constraints = [np.array(boxes) @ x >= 0] if boxes else []
    problem = cp.Problem(cp.Minimize(cp.sum_squares(root @ w) + slope @ w + cp.sum(terms)), constraints)
    with warnings.catch_warnings():
        # "Solution may be inaccurate": the certificate decides, after the Newton steps.
        warnings.simplefilter("ignore", UserWarning)
        problem.solve(solver=cp.CLARABEL, max_threads=1, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    if w.value is None:
        raise DataError("inertia.solver", "the entropic fit has no solution", found=f"Clarabel: {problem.status}")
    dual = np.asarray(constraints[0].dual_value) if boxes else np.zeros(0)
    rows = np.array(boxes).reshape(len(boxes), len(start))
    touched = dual > _TOUCHED * max(1.0, dual.max(initial=0.0))
    solution, multiplier = _polish(start + rotate @ w.value, hessian, pull, weights, rows[touched])
    dual = np.zeros(len(boxes))
    dual[touched] = multiplier
    status = "Solved" if problem.status == cp.OPTIMAL else str(problem.status)
    zero = np.zeros((len(weights), 4, 4))
    return ConeSolution(solution, zero, dual, status, int(problem.solver_stats.num_iters or 0), 1)


def _polish(
    x: Vector, hessian: Matrix, pull: Vector, weights: np.ndarray, rows: Float[np.ndarray, "touched params"]
) -> tuple[Vector, Float[np.ndarray, " touched"]]:
    """Damped Newton steps along the touched boxes, rows x = 0, and the boxes' multipliers.

    The exponential cones leave a stationarity residual of 1e-6 that smooth steps remove.
    """
    multiplier = np.zeros(len(rows))
    for _ in range(_NEWTON_STEPS):
        square = x.reshape(-1, 10)
        bend = 2 * hessian + scipy.linalg.block_diag(*(weights[:, None, None] * _curvature(square)))
        slope = divergence_slope(torch.from_numpy(square)).numpy() * weights[:, None]
        gradient = 2 * (hessian @ x - pull) + slope.ravel()
        system = np.block([[bend, -rows.T], [-rows, np.zeros((len(rows), len(rows)))]])
        solution = np.linalg.solve(system, np.concatenate([-gradient, rows @ x]))
        step, multiplier = solution[: len(x)], solution[len(x) :]
        decrement = float(np.sqrt(max(step @ bend @ step, 0.0)))
        # Self-concordance holds for the divergence with weight 1/2 or more; smaller weights shorten the step.
        x = x + step / (1 + decrement / np.sqrt(2 * min(weights.min(), 0.5)))
        if decrement < 1e-10:
            break
    return x, multiplier
