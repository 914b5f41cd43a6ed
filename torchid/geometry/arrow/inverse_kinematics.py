"""Inverse kinematics: all frames at fixed geometry, each frame on its own damping and its own convergence."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow.elimination import back_substitute, eliminate
from torchid.geometry.arrow.index_tables import Layout, make_layout
from torchid.geometry.arrow.limb_partition import Partition, make_partition
from torchid.geometry.arrow.normal_blocks import Pieces, make_pieces
from torchid.geometry.problem import MarkerProblem, Shape, retract

CHUNK = 2048
STEP = torch.float32
"""Of the steps alone: half the memory to move, and an error of 1e-7 in a step that the next one mends. Cost, poses and
coordinates keep the precision of the input."""
LEAST_DAMPING = 1e-6
"""Damping that keeps a block in ``STEP`` positive definite."""


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
    layout = make_layout(problem, STEP)
    partition = make_partition(problem.plan, layout, 0)
    q, cost, shape = q.clone(), q.new_empty(q.shape[1]), problem.shape(xi)
    for start in range(0, q.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        q[:, part], cost[part] = _solve_chunk(
            problem.frames(part), layout, partition, q[:, part], shape, iterations, tolerance
        )
    return q, cost


def _solve_chunk(
    problem: MarkerProblem,
    layout: Layout,
    partition: Partition,
    q: Tensor,
    shape: Shape,
    iterations: int,
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    out_q, out_cost = torch.empty_like(q), torch.empty_like(q[0])
    active = torch.arange(q.shape[1], device=q.device)
    seen, damping, before = problem.evaluate(q, shape), q.new_full((q.shape[1],), 1e-3), q.new_ones(q.shape[1])
    for _ in range(iterations):
        trial = retract(q, _motion_step(partition, make_pieces(problem, layout, seen, shared=False), damping))
        new = problem.evaluate(trial, shape)
        better = new.cost <= seen.cost
        fall = torch.where(better, (seen.cost - new.cost) / seen.cost.clamp(min=1e-300), 1.0)
        q, cost = torch.where(better, trial, q), torch.where(better, new.cost, seen.cost)
        damping = torch.where(better, damping / 10.0, damping * 10.0 + 1e-4).clamp(min=LEAST_DAMPING)
        # The falls of a converging frame shrink by a factor that itself shrinks: the next one is known beforehand.
        open_ = ~((fall.square() < 0.1 * tolerance * before) & (fall < before) | (damping > 1e8))
        out_q[:, active], out_cost[active], before = q, cost, fall
        left = int(open_.sum())
        if not left:
            break
        if left < 0.8 * len(active):
            keep = open_.nonzero()[:, 0]
            active, q, damping, before = active[keep], q[:, keep], damping[keep], before[keep]
            problem = problem.frames(keep)
        seen = new if len(better) == len(active) and bool(better.all()) else problem.evaluate(q, shape)
    return out_q, out_cost


def _motion_step(partition: Partition, pieces: Pieces, damping: Tensor) -> Tensor:
    given = damping.to(pieces.pull.dtype)
    d, _, _ = back_substitute(partition, eliminate(partition, pieces, given), given[:0])
    dq = damping.new_empty(d.shape[1], d.shape[0])
    dq[partition.dof_rows] = d.T.to(dq.dtype)
    return dq
