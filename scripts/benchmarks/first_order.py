"""What the arrow is compared with: Adam with analytic gradients, and scipy with the sparse analytic Jacobian."""

import time

import numpy as np
import scipy.sparse as sp
import torch
from scipy.optimize import least_squares
from torch import Tensor

from torchid.geometry.arrow.index_tables import ArrowLayout, make_layout
from torchid.geometry.arrow.normal_blocks import column_axes, column_twists, fold_matrix, moments
from torchid.geometry.problem import MarkerProblem
from torchid.kinematics.recursion import Poses, cross

CHUNK = 1024
Trace = list[tuple[float, float]]
"""(CPU seconds, cost)"""


class OutOfTimeError(Exception):
    """The budget is spent."""


def adam(problem: MarkerProblem, q: Tensor, xi: Tensor, iterations: int, budget: float) -> Trace:
    """Adam on a cosine schedule; learning rates are the best of a grid on such sessions."""
    layout, trace = make_layout(problem), []
    q, xi = torch.nn.Parameter(q.clone()), torch.nn.Parameter(xi.clone())
    groups = [{"params": [q], "lr": 0.02}, {"params": [xi], "lr": 0.005}]
    optimiser = torch.optim.Adam(groups, betas=(0.9, 0.99), foreach=False)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    start = time.process_time()
    for _ in range(iterations):
        with torch.no_grad():
            q.grad, total = torch.empty_like(q), problem.xi_cost(xi)
            xi.grad = problem.xi_precision * (xi - problem.xi_mean)
            for first in range(0, q.shape[1], CHUNK):
                part = slice(first, first + CHUNK)
                cost, g_q, g_x = make_gradient(problem.frames(part), layout, q[:, part], xi, shared=True)
                q.grad[layout.dof_rows, part] = g_q
                xi.grad.index_add_(0, layout.entry_xi, g_x.sum(1))
                total += float(cost.sum())
        trace.append((time.process_time() - start, total))
        if trace[-1][0] > budget:
            break
        optimiser.step()
        schedule.step()
    return trace


def make_gradient(
    problem: MarkerProblem, layout: ArrowLayout, q: Tensor, xi: Tensor, shared: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the cost and its gradient alone, without any block.

    Args:
        problem: markers, weights and posture prior.
        layout: index tables of the problem.
        q: coordinates (dofs, frames).
        xi: geometry and marker places.
        shared: False leaves the entries out.

    Returns:
        Cost (frames,), gradient in motion (motion, frames), and gradient in the entries (entries, frames).
    """
    seen = problem.evaluate(q, problem.shape(xi))
    at, pull = seen.at.about_root(q.dtype), seen.weight[:, None] * seen.residual
    columns = column_gradient(layout, at, seen.p - seen.at.p[:1], pull, shared)
    g_q = columns.index_select(0, layout.motion if shared else layout.motion_alone)
    fold = fold_matrix(layout, q, q.dtype)
    g_q = g_q if fold is None else torch.einsum("tcd,ct->dt", fold, g_q)
    g_q += seen.pull.index_select(0, layout.dof_rows)
    if not shared:
        return seen.cost, g_q, columns[:0]
    free = problem.free
    R = at.R.index_select(0, problem.body[free])
    places = (R * pull[free, None]).sum(2).flatten(0, 1)
    return seen.cost, g_q, torch.cat([columns[layout.entries[: layout.geometric]], places])


def column_gradient(layout: ArrowLayout, at: Poses, p: Tensor, pull: Tensor, shared: bool) -> Tensor:
    """Compute the gradient of ``column_twists`` alone, for a third of the work.

    Args:
        layout: index tables.
        at: poses of all bodies, measured from the root's origin.
        p: the markers' positions from the root's origin (markers, 3, frames).
        pull: weighted residuals (markers, 3, frames).
        shared: False leaves geometry out.

    Returns:
        The gradient (columns, frames).
    """
    z, t = column_axes(layout, at, shared)
    turning, sliding = layout.turning_body[: len(z)], layout.sliding_body[: len(t)]
    wrench = torch.cat([pull, cross(p, pull)], dim=1)
    wrench = (layout.subtree @ wrench.flatten(1)).view(len(layout.subtree), 6, p.shape[2])
    arm = at.p.index_select(0, turning)
    about = wrench.index_select(0, turning)
    turns = (z * (about[:, 3:] - cross(arm, about[:, :3]))).sum(1)
    slides = (t * wrench[:, :3].index_select(0, sliding)).sum(1)
    return torch.cat([wrench[0], turns, slides])


def scipy_sparse(problem: MarkerProblem, q: Tensor, xi: Tensor, budget: float) -> Trace:
    """scipy.optimize.least_squares (trf, lsmr) on all residuals with a sparse Jacobian.

    The base's rotation vector is turned about the start by increments, as the other solvers do.
    """
    pattern, trace, start = _Pattern(problem), [], time.process_time()

    def residuals(x: np.ndarray) -> np.ndarray:
        out = pattern.residuals(*pattern.split(x))
        trace.append((time.process_time() - start, 0.5 * float(out @ out)))
        if trace[-1][0] > budget:
            raise OutOfTimeError
        return out

    x = torch.cat([q.reshape(-1), xi]).numpy()
    try:
        least_squares(
            residuals, x, lambda x: pattern.jacobian(*pattern.split(x)), method="trf", x_scale="jac", tr_solver="lsmr",
            ftol=1e-10, xtol=1e-12, gtol=1e-12, max_nfev=200,
        )  # fmt: skip
    except OutOfTimeError:
        pass
    return trace


class _Pattern:
    """Rows and columns of the non-zero entries, made once."""

    def __init__(self, problem: MarkerProblem) -> None:
        self.problem, self.layout = problem, make_layout(problem)
        layout = self.layout
        self.shape = (len(problem.posture.lower), problem.target.shape[2])
        below = layout.subtree > 0
        body = torch.cat([layout.motion_body, layout.entry_body[: layout.geometric]])
        self.pair_column, self.pair_marker = below[body].nonzero().T
        self.columns = torch.cat([layout.motion, layout.entries[: layout.geometric]])
        n, frames = self.shape
        t, axis = torch.arange(frames), torch.arange(3)
        unknown = torch.cat([layout.dof_rows * frames, n * frames + layout.entry_xi[: layout.geometric]])
        moves = (torch.arange(len(self.columns)) < n).long()
        row = ((self.pair_marker[:, None, None] * 3 + axis[:, None]) * frames + t).reshape(-1)
        column = (unknown[self.pair_column][:, None, None] + moves[self.pair_column][:, None, None] * t).expand(
            -1, 3, -1
        )
        free = problem.free
        place_row = ((free[:, None, None, None] * 3 + axis[:, None]) * frames + t).expand(-1, 3, -1, -1).reshape(-1)
        place = n * frames + problem.n_named + torch.arange(3 * len(free))
        place_column = place.view(-1, 3, 1, 1).expand(-1, -1, 3, frames).reshape(-1)
        base = problem.target.numel()
        size = n * frames + len(problem.xi_mean)
        prior_row = base + torch.arange(size + n * frames)
        prior_column = torch.cat([torch.arange(size), torch.arange(n * frames)])
        self.rows = torch.cat([row, place_row, prior_row]).numpy()
        self.cols = torch.cat([column.reshape(-1), place_column, prior_column]).numpy()
        self.size = (base + size + n * frames, size)

    def split(self, x: np.ndarray) -> tuple[Tensor, Tensor]:
        both = torch.tensor(x)
        n = self.shape[0] * self.shape[1]
        return both[:n].view(self.shape), both[n:]

    def residuals(self, q: Tensor, xi: Tensor) -> np.ndarray:
        problem, posture = self.problem, self.problem.posture
        beyond = (q - posture.upper).clamp(min=0.0) - (posture.lower - q).clamp(min=0.0)
        parts = (
            problem.weight.sqrt()[:, None] * problem.residual(q, xi)[2],
            posture.precision.sqrt() * (q - posture.mean),
            problem.xi_precision.sqrt() * (xi - problem.xi_mean),
            posture.limit_precision**0.5 * beyond,
        )
        return torch.cat([part.reshape(-1) for part in parts]).numpy()

    def jacobian(self, q: Tensor, xi: Tensor) -> sp.csr_matrix:
        problem, posture = self.problem, self.problem.posture
        at, p, _ = problem.residual(q, xi)
        p = p - at.p[:1]
        sums = moments(self.layout, problem.weight, p, torch.zeros_like(p))
        S = column_twists(self.layout, at.about_root(q.dtype), sums, shared=True).S.permute(1, 2, 0)[self.columns]
        S[3:6, 3:] = _rotation_vector_rates(q)
        v, z = S[self.pair_column, :3], S[self.pair_column, 3:]
        root = problem.weight.sqrt()
        J = (v + torch.linalg.cross(z, p[self.pair_marker], dim=1)) * root[self.pair_marker][:, None]
        R = at.R[problem.body[problem.free]] * root[problem.free][:, None, None]
        outside = (q > posture.upper) | (q < posture.lower)
        values = (
            J, R, posture.precision.sqrt().expand_as(q), problem.xi_precision.sqrt(),
            posture.limit_precision**0.5 * outside,
        )  # fmt: skip
        data = torch.cat([value.reshape(-1) for value in values]).numpy()
        return sp.csr_matrix((data, (self.rows, self.cols)), shape=self.size)


def _rotation_vector_rates(q: Tensor) -> Tensor:
    """Axes (3, 3, frames) about which the base turns per unit rate of each entry of its rotation vector."""
    r = q[3:6].T
    angle = r.norm(dim=1)[:, None, None].clamp(min=1e-9)
    K = torch.linalg.cross(r[:, None].expand(-1, 3, -1), torch.eye(3, dtype=q.dtype).expand(len(r), -1, -1)).mT
    eye = torch.eye(3, dtype=q.dtype)
    left = eye - (1 - angle.cos()) / angle**2 * K.mT + (angle - angle.sin()) / angle**3 * (K @ K)
    return left.permute(2, 1, 0)
