"""A problem of the shape of the human data of Lee, Wensing & Park (IEEE T-RO 36(2), 2020), and its direct solution.

Sixteen bodies, 160 parameters, base rows of random motion. The direct solution shares nothing with torchid but the
numbers: pseudo-inertias relative to the prior as matrix variables, uncompressed rows, CVXPY and Clarabel.
"""

import warnings
from dataclasses import dataclass
from functools import cache

import cvxpy as cp
import numpy as np
import torch

from torchid.dynamics.equations_of_motion import base_rows, body_rows, dynamic_state
from torchid.model.pseudo import relative_map
from torchid.model.whole_body import whole_body

ENTRIES = [(4, (0, 0)), (5, (0, 1)), (6, (1, 1)), (7, (0, 2)), (8, (1, 2)), (9, (2, 2))]
"""Column of each moment of inertia: Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
TIGHT = 1e-12
"""Tolerance of the direct programs: at Clarabel's default their own error is 1e-5 of a body."""
SNUG = 3.3
"""Squared semi-axis of a bounding ellipsoid over the second moment per mass; 5 for a uniform ellipsoid."""


@dataclass(frozen=True)
class RowsProblem:
    """Whitened rows, prior mean, ellipsoids and the subject behind the rows."""

    Y: np.ndarray
    F: np.ndarray
    mean: np.ndarray
    Q: np.ndarray
    truth: np.ndarray
    names: tuple[str, ...]

    @property
    def sums(self) -> tuple[np.ndarray, np.ndarray, float, int]:
        return self.Y.T @ self.Y, self.Y.T @ self.F, float(self.F @ self.F), len(self.F)


def pseudo(phi: np.ndarray) -> np.ndarray:
    """Pseudo-inertia of ten parameters."""
    inertia = np.zeros((3, 3))
    for column, (i, j) in ENTRIES:
        inertia[i, j] = inertia[j, i] = phi[column]
    P = np.zeros((4, 4))
    P[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    P[:3, 3] = P[3, :3] = phi[1:4]
    P[3, 3] = phi[0]
    return P


def parameters(P: np.ndarray) -> np.ndarray:
    """Ten parameters of a pseudo-inertia."""
    inertia = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    return np.array([P[3, 3], *P[:3, 3], *(inertia[i, j] for _, (i, j) in ENTRIES)])


def snug_ellipsoid(P: np.ndarray) -> np.ndarray:
    """Matrix of an ellipsoid around a body's centre of mass, of the body's own proportions."""
    mass, centre = P[3, 3], P[:3, 3] / P[3, 3]
    A = np.linalg.inv(SNUG * (P[:3, :3] / mass - np.outer(centre, centre)))
    return np.block([[-A, (A @ centre)[:, None]], [A @ centre, np.array([1 - centre @ A @ centre])]])


def wander(mean: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Draw a subject whose pseudo-inertias stray by an eighth from the prior's, relative to it."""
    truth = []
    for phi in mean:
        L, S = np.linalg.cholesky(pseudo(phi)), generator.normal(size=(4, 4))
        truth.append(parameters(L @ (np.eye(4) + 0.125 * (S + S.T) / 2**0.5) @ L.T))
    return np.stack(truth)


def problem_of(Y: np.ndarray, mean: np.ndarray, names: tuple[str, ...], generator: np.random.Generator) -> RowsProblem:
    """Rows with wrenches of a subject and unit noise."""
    truth = wander(mean, generator)
    F = Y @ truth.ravel() + generator.normal(size=len(Y))
    return RowsProblem(Y, F, mean, np.stack([snug_ellipsoid(pseudo(phi)) for phi in mean]), truth, names)


@cache
def small(seed: int = 5) -> RowsProblem:
    """Three limbs and 60 dense rows that see a relative change of a parameter at ten times their noise."""
    generator = np.random.default_rng(seed)
    mean = whole_body(1.75, 70.0).inertia.mean.numpy()[-3:]
    blocks = torch.linalg.inv(relative_map(torch.from_numpy(mean)))
    Y = 10 * generator.normal(size=(60, 30)) @ torch.block_diag(*blocks).numpy()
    return problem_of(Y, mean, ("thigh", "shank", "foot"), generator)


@cache
def human(seed: int = 3, frames: int = 60) -> RowsProblem:
    """Rows (6 frames, 160) of rank 141, whitened by 8 N and 3 N m."""
    generator = np.random.default_rng(seed)
    model = whole_body(1.75, 70.0)
    geometry = model.geometry.geometry(model.geometry.mean)
    dofs = len(model.tree.dofs)
    q, v, a = (torch.from_numpy(size * generator.normal(size=(dofs, frames))) for size in (0.4, 1.0, 6.0))
    state = dynamic_state(model.tree, geometry, q, v, a)
    rows = base_rows(state.plan, body_rows(state))  # (6, params, frames)
    Y = rows.permute(2, 0, 1).reshape(6 * frames, -1).numpy() / np.tile([8.0, 8.0, 8.0, 3.0, 3.0, 3.0], frames)[:, None]
    mean = model.inertia.mean.numpy()
    return problem_of(Y, mean, model.tree.names, generator)


def direct(
    problem: RowsProblem,
    kind: str,
    scale: float,
    *,
    weight: float | None = None,
    rms_bound: float | None = None,
    mass: float | None = None,
    floor: float = 1e-6,
) -> np.ndarray:
    """Parameters of the program as it is written in the paper, weighed or under an error bound."""
    factors = [np.linalg.cholesky(pseudo(phi)) for phi in problem.mean]
    squares = [cp.Variable((4, 4), symmetric=True) for _ in factors]
    columns = []
    for L, W in zip(factors, squares, strict=True):
        to_params = np.stack([parameters(L @ unit.reshape(4, 4) @ L.T) for unit in np.eye(16)], axis=1)
        columns.append(to_params @ cp.vec(W, order="C"))
    phi = cp.hstack(columns)
    eye = np.eye(4)
    if kind == "euclidean":
        distance = cp.sum_squares((phi - problem.mean.ravel()) / scale)
    elif kind == "pullback":
        distance = cp.sum([cp.sum_squares(W - eye) for W in squares]) / scale**2
    else:
        distance = cp.sum([2 * (cp.trace(W) - cp.log_det(W) - 4) for W in squares]) / scale**2
    constraints = [cp.trace(L.T @ Q @ L @ W) >= 0 for L, Q, W in zip(factors, problem.Q, squares, strict=True)]
    constraints += [W >> floor * eye for W in squares] if kind != "entropic" else []
    constraints += [cp.sum([column[0] for column in columns]) == mass] if mass else []
    if rms_bound is None:
        objective = cp.sum_squares(problem.Y @ phi - problem.F) + weight * distance
    else:
        objective = distance
        constraints += [cp.norm(problem.Y @ phi - problem.F) <= rms_bound * len(problem.F) ** 0.5]
    program = cp.Problem(cp.Minimize(objective), constraints)
    with warnings.catch_warnings():
        # Where rounding ends the iterations first, the comparison itself tells whether the point is good enough.
        warnings.simplefilter("ignore", UserWarning)
        program.solve(
            solver=cp.CLARABEL, tol_gap_abs=TIGHT, tol_gap_rel=TIGHT, tol_feas=TIGHT, max_threads=1, max_iter=100
        )
    assert phi.value is not None, program.status
    return phi.value.reshape(-1, 10)
