"""The semidefinite programs of the inertial fit, stated in CVXPY and solved by Clarabel.

Without constraints the objective is ||w||^2 with phi = phi_free + R^-1 w, R' R the Hessian: the constrained fit is the
point of the cone nearest to the free optimum, measured in posterior standard deviations. CVXPY turns the LMIs into
Clarabel's cones once per number of bodies; a fit adds its linear rows and rotates all columns to w. The 16-body problem
then takes 8-11 iterations and 20 ms on one thread; with phi as the variable and its dense Hessian 11-21 iterations and
up to 43 ms, and "AlmostSolved" when the Hessian's condition number is 1e9; through ``Problem.solve`` with DPP
parameters 32-45 ms.
"""

# Clarabel's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import clarabel
import cvxpy as cp
import numpy as np
import scipy.linalg
import scipy.sparse as sp
from jaxtyping import Float

from torchid.errors import DataError
from torchid.model.pseudo import TRIANGLE

Matrix = Float[np.ndarray, "params params"]
Vector = Float[np.ndarray, " params"]

_SETTINGS = ({}, {"equilibrate_enable": False}, {"direct_solve_method": "qdldl", "max_step_fraction": 0.9})
"""Tried in this order, all Clarabel: another solver is never put in its place."""
SOLVED = ("Solved", "AlmostSolved")
"""Endings whose point is worth a certificate."""


@dataclass(frozen=True)
class LinearConstraints:
    """Linear constraints on relative parameters: ``inequality @ x >= 0`` and ``equality @ x == value``."""

    inequality: Float[np.ndarray, "inequalities params"]
    equality: Float[np.ndarray, "equalities params"]
    value: Float[np.ndarray, " equalities"]


@dataclass(frozen=True)
class ConeSolution:
    """What the solver returned, in relative parameters x (see ``pseudo.relative_map``)."""

    x: Vector
    lmi_dual: Float[np.ndarray, "bodies 4 4"]
    """Multipliers of W >= floor; the objective counts squares without a factor 1/2."""
    inequality_dual: Float[np.ndarray, " inequalities"]
    status: str
    iterations: int
    attempts: int
    equality_dual: Float[np.ndarray, " equalities"] = field(default_factory=lambda: np.zeros(0))
    """Of either sign: the objective's gradient is ``equality.T @ equality_dual`` plus what the other cones add."""


@dataclass(frozen=True)
class ConeRows:
    """b - A x in K, as Clarabel takes it: equalities, inequalities, then one 4 x 4 matrix per body."""

    A: sp.csc_array
    b: np.ndarray
    linear: LinearConstraints
    bodies: int
    """With an LMI."""

    @property
    def cones(self) -> list[object]:
        """All cones, in the order of the rows."""
        equal, above = len(self.linear.equality), len(self.linear.inequality)
        zero = [clarabel.ZeroConeT(equal)] if equal else []
        positive = [clarabel.NonnegativeConeT(above)] if above else []
        return zero + positive + [clarabel.PSDTriangleConeT(4)] * self.bodies

    def solution(self, found: clarabel.DefaultSolution, x: Vector, attempts: int) -> ConeSolution:
        """Clarabel's solution with the point x that its variables mean, and the multipliers of these rows."""
        z, equal = np.asarray(found.z), len(self.linear.equality)
        lmi = equal + len(self.linear.inequality)
        squares = z[lmi : lmi + 10 * self.bodies].reshape(-1, 10) @ _stack_to_square().T
        return ConeSolution(
            x=x,
            lmi_dual=squares.reshape(-1, 4, 4) if self.bodies else np.zeros((len(x) // 10, 4, 4)),
            inequality_dual=z[equal:lmi],
            status=str(found.status),
            iterations=int(found.iterations),
            attempts=attempts,
            equality_dual=-z[:equal],
        )


def _stack_to_square() -> np.ndarray:
    """16 x 10 matrix from the stacked triangle to the entries of a symmetric 4 x 4 matrix."""
    matrix = np.zeros((16, 10))
    for k, (i, j) in enumerate(TRIANGLE):
        matrix[4 * i + j, k] = matrix[4 * j + i, k] = 1 if i == j else 0.5**0.5
    return matrix


def squares(x: cp.Expression, bodies: int) -> list[cp.Expression]:
    """The relative pseudo-inertia of each body as an expression of the stacked parameters."""
    expand = _stack_to_square()
    return [cp.reshape(expand @ x[10 * k : 10 * k + 10], (4, 4), order="C") for k in range(bodies)]


@lru_cache(maxsize=16)
def _lmi_form(bodies: int, floor: float) -> tuple[sp.csc_array, np.ndarray]:
    """Let CVXPY canonicalise the LMIs once; the quadratic objective only keeps every variable alive."""
    x = cp.Variable(10 * bodies)
    constraints: list[cp.Constraint] = [W - floor * np.eye(4) >> 0 for W in squares(x, bodies)]
    data, _, _ = cp.Problem(cp.Minimize(cp.sum_squares(x)), constraints).get_problem_data(cp.CLARABEL)
    dims = data["dims"]
    expected = (0, 0, [4] * bodies, 10 * bodies)
    assert (dims.zero, dims.nonneg, list(dims.psd), data["A"].shape[1]) == expected, dims
    return sp.csc_array(data["A"]), np.asarray(data["b"])


def cone_rows(params: int, linear: LinearConstraints, *, lmi: bool, floor: float) -> ConeRows:
    """Linear rows above the LMIs of all bodies."""
    bodies = params // 10 if lmi else 0
    A, b = _lmi_form(bodies, floor) if lmi else (sp.csc_array((0, params)), np.zeros(0))
    stacked = sp.csc_array(sp.vstack([sp.csc_array(np.vstack([linear.equality, -linear.inequality])), A]))
    return ConeRows(stacked, np.concatenate([linear.value, np.zeros(len(linear.inequality)), b]), linear, bodies)


def _settings(changes: Mapping[str, object]) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads, settings.direct_solve_method = False, 1, "faer"
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    for name, value in changes.items():
        setattr(settings, name, value)
    return settings


def clarabel_solve(
    P: sp.csc_array, q: np.ndarray, A: sp.csc_array, b: np.ndarray, cones: list[object]
) -> tuple[clarabel.DefaultSolution, int]:
    """Return the solution of the first settings that reach ``Solved``, and how many settings were tried.

    Where none does, it is the first ``AlmostSolved`` one, or else the last.
    """
    best = None
    for attempts, changes in enumerate(_SETTINGS, start=1):
        solution = clarabel.DefaultSolver(P, q, A, b, cones, _settings(changes)).solve()
        if str(solution.status) == "Solved":
            return solution, attempts
        if best is None or str(best.status) not in SOLVED:
            best = solution
    return best, len(_SETTINGS)


def project(free: Vector, hessian: Matrix, linear: LinearConstraints, *, lmi: bool, floor: float) -> ConeSolution:
    """Minimise (x - free)' hessian (x - free) over the cone.

    Args:
        free: unconstrained optimum, relative parameters.
        hessian: positive definite.
        linear: rows that hold besides the LMIs.
        lmi: W(x) >= floor for every body.

    Raises:
        DataError: Clarabel found no solution with any of its settings, or double precision does not hold the Hessian.
    """
    rows, rotate = cone_rows(len(free), linear, lmi=lmi, floor=floor), unit_axes(hessian)
    P, q = 2 * sp.eye_array(len(free), format="csc"), np.zeros(len(free))
    solution, attempts = clarabel_solve(P, q, sp.csc_array(rows.A @ rotate), rows.b - rows.A @ free, rows.cones)
    if str(solution.status) not in SOLVED:
        raise no_solution(f"Clarabel: {solution.status}")
    return rows.solution(solution, free + rotate @ np.asarray(solution.x), attempts)


def unit_axes(hessian: Matrix) -> Matrix:
    """R^-1 with R' R the Hessian: in these axes it is the unit matrix.

    Raises:
        DataError: in double precision the Hessian is not positive definite: beside the data, the prior is rounding.
    """
    try:
        factor = np.linalg.cholesky(hessian).T
    except np.linalg.LinAlgError as error:
        found = f"a Hessian that is not positive definite, its largest entry {np.abs(hessian).max():.1e}"
        raise no_solution(found) from error
    return scipy.linalg.solve_triangular(factor, np.eye(len(hessian)))


def no_solution(ending: str) -> DataError:
    """The error of a program that ends so without a solution: that there is none is said only where it says so."""
    if "infeasible" in ending.lower() and "dual" not in ending.lower():
        message = "the solver finds no inertial parameters that fulfil all constraints"
        remedy = "Widen the centre-of-mass boxes and ellipsoids, look at the forces, or scale the rows to their noise"
    else:
        message = "the solver broke down before it found inertial parameters; there may be some"
        remedy = (
            "Scale the rows to their noise or have it estimated, and look at units, weights and boxes far from the "
            "bodies; where the entropic prior breaks down, the quadratic one may not"
        )
    return DataError("inertia.solver", message, found=ending, remedy=remedy)
