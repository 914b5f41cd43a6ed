"""Inverse kinematics: all frames at fixed geometry, each frame on its own damping and its own convergence."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow import factorise, retract, scatter
from torchid.geometry.blocks import assemble
from torchid.geometry.layout import Layout, make_layout
from torchid.geometry.problem import MarkerProblem

CHUNK = 256


def solve_poses(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    iterations: int = 40,
    tolerance: float = 1e-5,
) -> tuple[Float[Tensor, "dofs frames"], Float[Tensor, " frames"]]:
    """Coordinates that minimise every frame's cost at fixed xi, and that cost.

    Frames that have converged leave the batch. Long sessions need only one chunk of intermediates at a time.
    """
    layout = make_layout(problem)
    q, cost = q.clone(), q.new_empty(q.shape[1])
    for start in range(0, q.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        q[:, part], cost[part] = _solve_chunk(problem.frames(part), layout, q[:, part], xi, iterations, tolerance)
    return q, cost


def _solve_chunk(
    problem: MarkerProblem, layout: Layout, q: Tensor, xi: Tensor, iterations: int, tolerance: float
) -> tuple[Tensor, Tensor]:
    out_q, out_cost = q.clone(), problem.frame_cost(q, xi)
    active = torch.arange(q.shape[1], device=q.device)
    cost, damping = out_cost, q.new_full((q.shape[1],), 1e-3)
    for _ in range(iterations):
        blocks = assemble(problem, layout, q, xi, shared=False)
        L = factorise(blocks.H_qq, damping)
        d = -torch.cholesky_solve(blocks.g_q[:, :, None], L)[:, :, 0]
        trial = retract(q, scatter(layout, d))
        new = problem.frame_cost(trial, xi)
        better = new <= cost
        fall = (cost - new) / cost.clamp(min=1e-300)
        q = torch.where(better, trial, q)
        cost = torch.where(better, new, cost)
        damping = torch.where(better, damping / 10.0, damping * 10.0 + 1e-4).clamp(min=1e-10)
        open_ = ~((better & (fall < tolerance)) | (damping > 1e8))
        out_q[:, active], out_cost[active] = q, cost
        if not bool(open_.any()):
            break
        if open_.sum() < 0.8 * len(active):
            keep = open_.nonzero()[:, 0]
            active, q, cost, damping = active[keep], q[:, keep], cost[keep], damping[keep]
            problem = problem.frames(keep)
    return out_q, out_cost
