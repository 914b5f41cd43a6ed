"""The log-det ("entropic") prior: divergence of pseudo-inertias instead of a squared distance.

D(P | P0) = tr(P0^-1 P) - log det(P0^-1 P) - 4 does not depend on the body's axes, origin or units and is infinite at
the boundary of what is physical. In relative parameters it is tr W - log det W - 4, already whitened, and 2 D is
||x - x0||^2 to second order; each body's term is weighed so that this curvature has the mean precision of the prior
covariance over its ten parameters. Correlations between bodies are not part of it.

Reference: Lee, Wensing, Park, IEEE T-RO 36(2), 2020, eq. 19.
"""

import warnings

import cvxpy as cp
import numpy as np
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError
from torchid.inertia.cone import ConeSolution, Linear, Matrix, Vector, squares
from torchid.inertia.newton import Objective, Surface, polish
from torchid.inertia.pseudo import triangle, untriangle

_TOUCHED = 1e-5
"""Multiplier, over the largest or 1, above which a linear row counts as touched."""
_VIOLATED = 1e-10
"""Violation of a linear row of unit length, in relative parameters, above which it must be held."""
_ROUNDS = 10
"""Largest number of changes of the rows that are held; one or none is usual."""


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


def divergence_terms(x: cp.Expression, weights: np.ndarray) -> cp.Expression:
    """Sum of weights * ``divergence`` up to a constant, for CVXPY."""
    terms = [2 * k * (cp.trace(W) - cp.log_det(W)) for k, W in zip(weights, squares(x, len(weights)), strict=True)]
    total = cp.sum(cp.hstack(terms))
    assert isinstance(total, cp.Expression)
    return total


def smooth(hessian: Matrix, pull: Vector, weights: np.ndarray) -> Objective:
    """x' hessian x - 2 pull' x + sum of weights * divergence, for Newton steps."""

    def objective(x: Vector) -> tuple[Vector, Matrix]:
        square = x.reshape(-1, 10)
        bend = 2 * hessian + scipy.linalg.block_diag(*(weights[:, None, None] * _curvature(square)))
        slope = divergence_slope(torch.from_numpy(square)).numpy() * weights[:, None]
        return 2 * (hessian @ x - pull) + slope.ravel(), bend

    return objective


def solve_program(
    objective: cp.Expression, x: cp.Expression, linear: Linear, extra: list[cp.Constraint]
) -> tuple[cp.Problem, np.ndarray]:
    """Solve a convex program with the linear rows and ``extra``; and the multipliers of the inequalities."""
    above = [linear.inequality @ x >= 0] if len(linear.inequality) else []
    equal = [linear.equality @ x == linear.value] if len(linear.value) else []
    problem = cp.Problem(cp.Minimize(objective), above + equal + extra)
    with warnings.catch_warnings():
        # "Solution may be inaccurate": the certificate decides, after the Newton steps.
        warnings.simplefilter("ignore", UserWarning)
        problem.solve(solver=cp.CLARABEL, max_threads=1, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    solved = problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
    return problem, np.asarray(above[0].dual_value) if above and solved else np.zeros(len(linear.inequality))


def minimise(start: Vector, hessian: Matrix, pull: Vector, weights: np.ndarray, linear: Linear) -> ConeSolution:
    """Minimise x' hessian x - 2 pull' x + sum of weights * divergence.

    Args:
        start: optimum of the quadratic approximation; the centre of the solver's coordinates.
        hessian, pull: of the data, in relative parameters.
        weights: omega_2 times ``body_weights``.
        linear: rows that hold besides.

    Raises:
        DataError: Clarabel found no solution.
    """
    factor = np.linalg.cholesky(hessian + np.diag(np.repeat(weights, 10))).T
    rotate = scipy.linalg.solve_triangular(factor, np.eye(len(start)))
    values, axes = np.linalg.eigh(rotate.T @ hessian @ rotate)
    root = np.sqrt(values.clip(0))[:, None] * axes.T
    w = cp.Variable(len(start))
    x = start + rotate @ w
    slope = 2 * rotate.T @ (hessian @ start - pull)
    objective = cp.sum_squares(root @ w) + slope @ w + divergence_terms(x, weights)
    problem, dual = solve_program(objective, x, linear, [])
    if w.value is None:
        raise DataError(
            "inertia.solver", "the entropic fit has no solution", found=f"Clarabel: {problem.status}",
            remedy="Set inertia.prior: quadratic, or check the mass and the plates",
        )  # fmt: skip
    target = smooth(hessian, pull, weights)
    return finish(start + rotate @ w.value, target, linear, dual, problem, float(weights.min()))[0]


def finish(
    x: Vector,
    objective: Objective,
    linear: Linear,
    dual: np.ndarray,
    problem: cp.Problem,
    convexity: float,
    surface: Surface | None = None,
) -> tuple[ConeSolution, float]:
    """Newton steps along the rows that hold with equality (see ``newton.polish``), found by an active-set method.

    The first guess is what the solver's multipliers ``dual`` say; rows that push the wrong way are then let go and
    rows that are violated are held (Nocedal & Wright, Numerical Optimization, 2006, section 16.5).
    """
    held = dual > _TOUCHED * max(1.0, dual.max(initial=0.0))
    for _ in range(_ROUNDS):
        rows = np.vstack([linear.equality, linear.inequality[held]])
        value = np.append(linear.value, np.zeros(int(held.sum())))
        x, multipliers, multiplier = polish(x, objective, rows, value, convexity, surface)
        pushing = multipliers[len(linear.value) :]
        wrong = np.flatnonzero(held)[pushing < 0]
        violated = np.flatnonzero(~held & (linear.inequality @ x < -_VIOLATED))
        if not len(wrong) and not len(violated):
            break
        held[wrong], held[violated] = False, True
    inequality_dual = np.zeros(len(dual))
    inequality_dual[held] = pushing
    return ConeSolution(
        x=x,
        lmi_dual=np.zeros((len(x) // 10, 4, 4)),
        inequality_dual=inequality_dual,
        status="Solved" if problem.status == cp.OPTIMAL else str(problem.status),
        iterations=int(problem.solver_stats.num_iters or 0),
        attempts=1,
        equality_dual=multipliers[: len(linear.value)],
    ), multiplier
