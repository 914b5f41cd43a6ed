"""Inverse kinematics: all frames at fixed geometry, each frame on its own damping and its own convergence."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.blocks import Pieces, make_pieces
from torchid.geometry.branches import Partition, make_partition
from torchid.geometry.elimination import back_substitute, eliminate
from torchid.geometry.layout import Layout, make_layout
from torchid.geometry.problem import MarkerProblem, retract

CHUNK = 1024


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
    partition = make_partition(problem.plan, layout, 0)
    q, cost = q.clone(), q.new_empty(q.shape[1])
    for start in range(0, q.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        q[:, part], cost[part] = _solve_chunk(
            problem.frames(part), layout, partition, q[:, part], xi, iterations, tolerance
        )
    return q, cost


def _solve_chunk(
    problem: MarkerProblem,
    layout: Layout,
    partition: Partition,
    q: Tensor,
    xi: Tensor,
    iterations: int,
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    out_q, out_cost = torch.empty_like(q), torch.empty_like(q[0])
    active = torch.arange(q.shape[1], device=q.device)
    cost, damping, before = torch.empty(0), q.new_full((q.shape[1],), 1e-3), q.new_full((q.shape[1],), 1.0)
    for step in range(iterations):
        pieces = make_pieces(problem, layout, q, xi, shared=False)
        cost = cost if step else pieces.cost
        trial = retract(q, _motion_step(partition, pieces, damping))
        new = problem.frame_cost(trial, xi)
        better = new <= cost
        fall = torch.where(better, (cost - new) / cost.clamp(min=1e-300), 1.0)
        q = torch.where(better, trial, q)
        cost = torch.where(better, new, cost)
        damping = torch.where(better, damping / 10.0, damping * 10.0 + 1e-4).clamp(min=1e-10)
        # The falls of a converging frame shrink by a factor that itself shrinks: the next one is known beforehand.
        open_ = ~((fall.square() < 0.1 * tolerance * before) & (fall < before) | (damping > 1e8))
        out_q[:, active], out_cost[active], before = q, cost, fall
        if not bool(open_.any()):
            break
        if open_.sum() < 0.8 * len(active):
            keep = open_.nonzero()[:, 0]
            active, q, cost, damping, before = active[keep], q[:, keep], cost[keep], damping[keep], before[keep]
            problem = problem.frames(keep)
    return out_q, out_cost


def _motion_step(partition: Partition, pieces: Pieces, damping: Tensor) -> Tensor:
    d, _, _ = back_substitute(partition, eliminate(partition, pieces, damping), damping[:0])
    dq = torch.empty_like(d.T)
    dq[partition.dof_rows] = d.T
    return dq
