"""The semidefinite programs of the inertial fit, stated in CVXPY and solved by Clarabel.

Without constraints the objective is ||w||^2 with phi = phi_free + R^-1 w, R' R the Hessian: the constrained fit is the
point of the cone nearest to the free optimum, measured in posterior standard deviations. CVXPY turns the constraints
into Clarabel's cones once per number of bodies; a fit only rotates their columns to w. The 16-body problem then takes
8-11 iterations and 20 ms on one thread; with phi as the variable and its dense Hessian 11-21 iterations and up to
43 ms, and "AlmostSolved" when the Hessian's condition number is 1e9; through ``Problem.solve`` with DPP parameters
32-45 ms.
"""

# Clarabel's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import clarabel
import cvxpy as cp
import numpy as np
import scipy.linalg
import scipy.sparse as sp
from jaxtyping import Float

from torchid.errors import DataError
from torchid.inertia.pseudo import TRIANGLE

Matrix = Float[np.ndarray, "params params"]
Vector = Float[np.ndarray, " params"]
Boxes = tuple[tuple[float, ...], ...]
"""Rows of a matrix C over all relative parameters with C x >= 0, as a hashable tuple."""

_SETTINGS = ({}, {"equilibrate_enable": False}, {"direct_solve_method": "qdldl", "max_step_fraction": 0.9})
"""Tried in this order, all Clarabel: another solver is never put in its place."""


@dataclass(frozen=True)
class ConeSolution:
    """What the solver returned, in relative parameters x (see ``pseudo.relative_map``)."""

    x: Vector
    lmi_dual: Float[np.ndarray, "bodies 4 4"]
    """Multipliers of W >= floor; the objective counts squares without a factor 1/2."""
    box_dual: Float[np.ndarray, " boxes"]
    status: str
    iterations: int
    attempts: int


@dataclass(frozen=True)
class _ConeForm:
    """b - A x in K, as CVXPY hands it to Clarabel."""

    A: sp.csc_array
    b: np.ndarray
    boxes: int
    bodies: int


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
def _cone_form(bodies: int, lmi: bool, floor: float, boxes: Boxes) -> _ConeForm:
    """Let CVXPY canonicalise the constraints once; the quadratic objective only keeps every variable alive."""
    x = cp.Variable(10 * bodies)
    constraints: list[cp.Constraint] = [np.array(boxes) @ x >= 0] if boxes else []
    if lmi:
        constraints += [W - floor * np.eye(4) >> 0 for W in squares(x, bodies)]
    data, _, _ = cp.Problem(cp.Minimize(cp.sum_squares(x)), constraints).get_problem_data(cp.CLARABEL)
    dims = data["dims"]
    expected = (0, len(boxes), [4] * (bodies if lmi else 0), 10 * bodies)
    assert (dims.zero, dims.nonneg, list(dims.psd), data["A"].shape[1]) == expected, dims
    return _ConeForm(sp.csc_array(data["A"]), np.asarray(data["b"]), len(boxes), bodies if lmi else 0)


def _settings(changes: Mapping[str, object]) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads, settings.direct_solve_method = False, 1, "faer"
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    for name, value in changes.items():
        setattr(settings, name, value)
    return settings


def project(free: Vector, hessian: Matrix, *, lmi: bool, floor: float, boxes: Boxes = ()) -> ConeSolution:
    """Minimise (x - free)' hessian (x - free) over the cone.

    Args:
        free: unconstrained optimum, relative parameters.
        hessian: positive definite.
        lmi: W(x) >= floor for every body.
        boxes: rows C with C x >= 0.

    Raises:
        DataError: Clarabel found no solution with any of its settings.
    """
    form = _cone_form(len(free) // 10, lmi, floor, boxes)
    factor = np.linalg.cholesky(hessian).T
    rotate = scipy.linalg.solve_triangular(factor, np.eye(len(free)))
    A, b = sp.csc_array(form.A @ rotate), form.b - form.A @ free
    cones = [clarabel.NonnegativeConeT(form.boxes)] if form.boxes else []
    cones += [clarabel.PSDTriangleConeT(4)] * form.bodies
    P, q = 2 * sp.eye_array(len(free), format="csc"), np.zeros(len(free))
    attempts, solution = 0, None
    while attempts < len(_SETTINGS) and (solution is None or str(solution.status) != "Solved"):
        solution = clarabel.DefaultSolver(P, q, A, b, cones, _settings(_SETTINGS[attempts])).solve()
        attempts += 1
    assert solution is not None
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        raise DataError(
            "inertia.solver",
            "no inertial parameters fulfil all constraints",
            found=f"Clarabel: {solution.status}",
            remedy="Widen the centre-of-mass boxes, or look at the forces",
        )
    z = np.asarray(solution.z)
    return ConeSolution(
        x=free + rotate @ np.asarray(solution.x),
        lmi_dual=(z[form.boxes :].reshape(-1, 10) @ _stack_to_square().T).reshape(-1, 4, 4),
        box_dual=z[: form.boxes],
        status=str(solution.status),
        iterations=int(solution.iterations),
        attempts=attempts,
    )
