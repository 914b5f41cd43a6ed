"""Levenberg-Marquardt on all frames and everything they share, through the arrow's Schur complement.

The normal matrix is an arrow: one small block per frame and one border for xi. The blocks are factorised in a batch,
V = L^-1 [H_qx g_q] takes one triangular solve, and xi comes from H_xx - V'V. Damping is per frame and driven by the
frame's own model error: near the joint optimum the cost of half the frames rightly rises, and damping them for it
cost fifty iterations instead of five.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import roma
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.blocks import Blocks, assemble
from torchid.geometry.layout import Layout, make_layout
from torchid.geometry.problem import MarkerProblem
from torchid.model.tree import BASE_DOFS

log = logging.getLogger(__name__)
Progress = Callable[[int, float], None]
CHUNK = 256
"""Frames per batch: the intermediates stay in the cache."""


@dataclass(frozen=True)
class Solution:
    """Where a solver stopped."""

    q: Float[Tensor, "dofs frames"]
    xi: Float[Tensor, " xi"]
    cost: float
    iterations: int
    converged: bool
    trace: tuple[float, ...]
    """Cost at the start and after every accepted step."""


@dataclass
class _Damping:
    frame: Tensor
    shared: float = 1e-9


def solve_arrow(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    iterations: int = 60,
    tolerance: float = 1e-6,
    progress: Progress | None = None,
) -> Solution:
    """Minimise over q and xi.

    Args:
        problem: markers, weights and priors.
        q, xi: start.
        iterations: limit.
        tolerance: relative fall of the cost at which to stop.
        progress: called with the iteration and the cost.
    """
    layout = make_layout(problem)
    damping = _Damping(q.new_full((q.shape[1],), 1e-3))
    cost = float(problem.frame_cost(q, xi).sum()) + problem.xi_cost(xi)
    trace, rejected, step = [cost], 0, 0
    for step in range(1, iterations + 1):
        q_new, xi_new, error = _step(problem, layout, q, xi, damping)
        frame_cost = problem.frame_cost(q_new, xi_new)
        new = float(frame_cost.sum()) + problem.xi_cost(xi_new)
        if new <= cost:
            fall, q, xi, cost = (cost - new) / max(cost, 1e-300), q_new, xi_new, new
            damping.frame = _relax(damping.frame, error(frame_cost))
            damping.shared, rejected = max(damping.shared / 10.0, 1e-9), 0
            trace.append(cost)
        else:
            fall, rejected = (new - cost) / max(cost, 1e-300), rejected + 1
            eta = error(frame_cost)
            damping.frame = torch.where(eta > 0.25, damping.frame * 10.0 + 1e-4, damping.frame * 2.0)
            damping.shared = damping.shared * 10.0 + 1e-6
        if progress:
            progress(step, cost)
        log.debug("arrow %d: cost %.6g, change %.1e, rejected %d", step, cost, fall, rejected)
        if (fall < tolerance and rejected in (0, 3)) or rejected > 12:
            break
    return Solution(q, xi, cost, step, rejected <= 3 and step < iterations, tuple(trace))


def _relax(damping: Tensor, eta: Tensor) -> Tensor:
    grown = torch.where(eta > 0.75, damping * 8.0 + 1e-4, torch.where(eta < 0.25, damping / 10.0, damping))
    return grown.clamp(min=1e-10)


def _step(
    problem: MarkerProblem, layout: Layout, q: Tensor, xi: Tensor, damping: _Damping
) -> tuple[Tensor, Tensor, Callable[[Tensor], Tensor]]:
    """One damped Gauss-Newton step; also a function that rates each frame's model error from its new cost."""
    S = torch.diag(problem.xi_precision)
    rhs = problem.xi_precision * (xi - problem.xi_mean)
    scale = problem.xi_precision.clone()
    kept = []
    for start in range(0, q.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        blocks = assemble(problem.frames(part), layout, q[:, part], xi, shared=True)
        assert blocks.H_qx is not None and blocks.H_xx is not None and blocks.g_x is not None
        L = factorise(blocks.H_qq, damping.frame[part])
        V = torch.linalg.solve_triangular(L, torch.cat([blocks.H_qx, blocks.g_q[:, :, None]], 2), upper=False)
        flat = V.reshape(-1, V.shape[2])
        reduced = flat.T @ flat
        S += blocks.H_xx - reduced[:-1, :-1]
        rhs += blocks.g_x.sum(0) - reduced[:-1, -1]
        scale += torch.diagonal(blocks.H_xx)
        kept.append((part, blocks, L, V))
    dx = -torch.cholesky_solve(rhs[:, None], _positive(S, scale, damping))[:, 0]
    dq = torch.empty_like(q)
    predicted, curvature = q.new_empty(q.shape[1]), q.new_empty(q.shape[1])
    for part, blocks, L, V in kept:
        y = V[:, :, -1] + V[:, :, :-1] @ dx
        d = -torch.linalg.solve_triangular(L.mT, y[:, :, None], upper=True)[:, :, 0]
        dq[:, part] = scatter(layout, d)
        predicted[part], curvature[part] = _model(blocks, d, dx)

    def error(cost: Tensor) -> Tensor:
        return (cost - predicted) / (curvature.abs() + 1e-14 * cost.mean())

    return retract(q, dq), xi + dx, error


def _model(blocks: Blocks, d: Tensor, dx: Tensor) -> tuple[Tensor, Tensor]:
    """Predicted cost of each frame and the size of its quadratic term (the part of xi alone left out)."""
    assert blocks.H_qx is not None and blocks.g_x is not None
    quadratic = 0.5 * (d * symmetric_times(blocks.H_qq, d)).sum(1) + (d * (blocks.H_qx @ dx)).sum(1)
    return blocks.cost + (d * blocks.g_q).sum(1) + blocks.g_x @ dx + quadratic, quadratic


def _positive(S: Tensor, scale: Tensor, damping: _Damping) -> Tensor:
    L, info = torch.linalg.cholesky_ex(S + torch.diag(damping.shared * scale))
    while int(info) != 0:
        damping.shared = damping.shared * 10.0 + 1e-6
        L, info = torch.linalg.cholesky_ex(S + torch.diag(damping.shared * scale))
    return L


def factorise(H: Tensor, damping: Tensor) -> Tensor:
    """Cholesky factor of each frame's damped block; a coordinate that nothing determines stays where it is."""
    diagonal = torch.diagonal(H, dim1=1, dim2=2)
    floor = 1e-9 * diagonal.amax(dim=1, keepdim=True) + 1e-12
    damped = H.clone()
    torch.diagonal(damped, dim1=1, dim2=2).add_(damping[:, None] * (diagonal + floor) + floor)
    L, info = torch.linalg.cholesky_ex(damped)
    assert not info.any(), "a Gauss-Newton block is positive semidefinite by construction"
    return L


def symmetric_times(H: Tensor, d: Tensor) -> Tensor:
    """Product of lower-stored symmetric (frames, n, n) with (frames, n)."""
    both = torch.bmm(H, d[:, :, None]) + torch.bmm(H.mT, d[:, :, None])
    return both[:, :, 0] - torch.diagonal(H, dim1=1, dim2=2) * d


def scatter(layout: Layout, d: Tensor) -> Tensor:
    """(frames, motion) in plan order to (dofs, frames)."""
    out = torch.empty(d.shape[1], d.shape[0], dtype=d.dtype, device=d.device)
    out[layout.dof_rows] = d.T
    return out


def retract(q: Tensor, dq: Tensor) -> Tensor:
    """q moved by dq, whose rows 3-5 are a rotation of the base in W."""
    new = q + dq
    R = roma.rotvec_to_rotmat(dq[3:BASE_DOFS].T) @ roma.rotvec_to_rotmat(q[3:BASE_DOFS].T)
    new[3:BASE_DOFS] = roma.rotmat_to_rotvec(R).T
    return new
