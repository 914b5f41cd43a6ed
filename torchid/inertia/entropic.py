"""The log-det ("entropic") prior: divergence of pseudo-inertias instead of a squared distance.

D(P | P0) = tr(P0^-1 P) - log det(P0^-1 P) - 4 does not depend on the body's axes, origin or units and is infinite at
the boundary of what is physical. In relative parameters it is tr W - log det W - 4, already whitened, and 2 D is
||x - x0||^2 to second order; each body's term is weighed so that this curvature has the mean precision of the prior
covariance over its ten parameters. Correlations between bodies are not part of it.

Reference: Lee, Wensing, Park, IEEE T-RO 36(2), 2020, eq. 19.
"""

import warnings
from contextlib import suppress

import cvxpy as cp
import numpy as np
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.inertia.cone import ConeSolution, LinearConstraints, Matrix, Vector, no_solution, squares, unit_axes
from torchid.inertia.newton import Objective, Surface, polish
from torchid.model.pseudo import triangle, untriangle

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


def divergence_slope(x: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 10"]:
    """Gradient of 2 D with respect to the relative parameters."""
    W = untriangle(x)
    eye = torch.eye(4, dtype=x.dtype, device=x.device)
    return 2 * triangle(eye - torch.linalg.inv(W))


def _curvature(x: np.ndarray) -> np.ndarray:
    """Hessian (bodies, 10, 10) of 2 D: 2 W^-1 dW W^-1."""
    inverse = torch.linalg.inv(untriangle(torch.from_numpy(x)))[:, None]
    units = untriangle(torch.eye(10, dtype=torch.float64))
    return 2 * triangle(inverse @ units @ inverse).mT.numpy()


def divergence_terms(x: cp.Expression, weights: np.ndarray) -> cp.Expression:
    """Sum of weights times 2 D up to a constant, for CVXPY."""
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
    objective: cp.Expression, x: cp.Expression, linear: LinearConstraints, extra: list[cp.Constraint]
) -> tuple[cp.Problem, np.ndarray]:
    """Solve a convex program with the linear rows and ``extra``; and the multipliers of the inequalities.

    Where Clarabel ends without a solution, the variables of ``x`` have no value (see ``ending``).
    """
    above = [linear.inequality @ x >= 0] if len(linear.inequality) else []
    equal = [linear.equality @ x == linear.value] if len(linear.value) else []
    problem = cp.Problem(cp.Minimize(objective), above + equal + extra)
    # SolverError: CVXPY's word for an end without a solution, whose status is then None.
    with warnings.catch_warnings(), suppress(cp.SolverError):
        # "Solution may be inaccurate": the certificate decides, after the Newton steps.
        warnings.simplefilter("ignore", UserWarning)
        problem.solve(solver=cp.CLARABEL, max_threads=1, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    solved = problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
    return problem, np.asarray(above[0].dual_value) if above and solved else np.zeros(len(linear.inequality))


def ending(problem: cp.Problem) -> str:
    """How Clarabel ended a program, in CVXPY's words."""
    return f"Clarabel: {problem.status or cp.SOLVER_ERROR}"


def minimise(
    start: Vector, hessian: Matrix, pull: Vector, weights: np.ndarray, linear: LinearConstraints
) -> ConeSolution:
    """Minimise x' hessian x - 2 pull' x + sum of weights * divergence.

    Args:
        start: optimum of the quadratic approximation; the centre of the solver's coordinates.
        hessian, pull: of the data, in relative parameters.
        weights: omega_2 times ``body_weights``.
        linear: rows that hold besides.

    Raises:
        DataError: Clarabel or the Newton steps found no solution, or double precision does not hold the Hessian.
    """
    rotate = unit_axes(hessian + np.diag(np.repeat(weights, 10)))
    values, axes = np.linalg.eigh(rotate.T @ hessian @ rotate)
    root = np.sqrt(values.clip(0))[:, None] * axes.T
    w = cp.Variable(len(start))
    x = start + rotate @ w
    slope = 2 * rotate.T @ (hessian @ start - pull)
    objective = cp.sum_squares(root @ w) + slope @ w + divergence_terms(x, weights)
    problem, dual = solve_program(objective, x, linear, [])
    if w.value is None:
        raise no_solution(ending(problem))
    target = smooth(hessian, pull, weights)
    return finish(start + rotate @ w.value, target, linear, dual, problem, float(weights.min()))[0]


def _polished(
    x: Vector, objective: Objective, rows: np.ndarray, value: np.ndarray, convexity: float, surface: Surface | None
) -> tuple[Vector, np.ndarray, float]:
    """What ``newton.polish`` returns; DataError where one of its steps has no solution."""
    try:
        return polish(x, objective, rows, value, convexity, surface)
    except (np.linalg.LinAlgError, torch.linalg.LinAlgError) as error:  # pyright: ignore[reportPrivateImportUsage]
        raise no_solution(f"Newton steps: {error}") from error


def _definite(x: Vector) -> bool:
    """Whether every body's pseudo-inertia is positive definite, which none with NaN is."""
    return not bool(torch.linalg.cholesky_ex(untriangle(torch.from_numpy(x).reshape(-1, 10))).info.any())


def finish(
    x: Vector,
    objective: Objective,
    linear: LinearConstraints,
    dual: np.ndarray,
    problem: cp.Problem,
    convexity: float,
    surface: Surface | None = None,
) -> tuple[ConeSolution, float]:
    """Newton steps along the rows that hold with equality (see ``newton.polish``), found by an active-set method.

    The first guess is what the solver's multipliers ``dual`` say; rows that push the wrong way are then let go and
    rows that are violated are held (Nocedal & Wright, Numerical Optimization, 2006, section 16.5). Where the rounds end
    before the rows are settled, the certificate tells.

    Raises:
        DataError: a step has no solution, or the steps end outside of what is physical.
    """
    held = dual > _TOUCHED * max(1.0, dual.max(initial=0.0))
    for _ in range(_ROUNDS):
        rows = np.vstack([linear.equality, linear.inequality[held]])
        value = np.append(linear.value, np.zeros(int(held.sum())))
        x, multipliers, multiplier = _polished(x, objective, rows, value, convexity, surface)
        pushing = np.zeros(len(dual))
        pushing[held] = multipliers[len(linear.value) :]
        wrong, violated = pushing < 0, ~held & (linear.inequality @ x < -_VIOLATED)
        if not (wrong | violated).any():
            break
        held = held & ~wrong | violated
    if not _definite(x):
        raise no_solution("Newton steps: the point is not physical")
    return ConeSolution(
        x=x,
        lmi_dual=np.zeros((len(x) // 10, 4, 4)),
        inequality_dual=pushing,
        status="Solved" if problem.status == cp.OPTIMAL else str(problem.status),
        iterations=int(problem.solver_stats.num_iters or 0),
        attempts=1,
        equality_dual=multipliers[: len(linear.value)],
    ), multiplier
