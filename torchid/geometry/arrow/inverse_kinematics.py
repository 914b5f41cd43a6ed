"""This module is inverse kinematics: all frames at fixed geometry, each with its own damping and convergence."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow.elimination import back_substitute, eliminate
from torchid.geometry.arrow.index_tables import ArrowLayout, make_layout
from torchid.geometry.arrow.limb_partition import Partition, make_partition
from torchid.geometry.arrow.normal_blocks import Pieces, make_pieces
from torchid.geometry.problem import MarkerProblem, Shape, retract

CHUNK = 2048
"""Frames solved in one batch; chosen for memory."""
STEP_DTYPE = torch.float32
"""Precision of the steps; chosen, because it halves the memory to move and the next step mends the error of one.

Cost, poses and coordinates keep the precision of the input.
"""
LEAST_DAMPING = 1e-6
"""Least damping; chosen to keep a block in ``STEP_DTYPE`` positive definite."""


def solve_poses(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    iterations: int = 40,
    tolerance: float = 1e-5,
) -> tuple[Float[Tensor, "dofs frames"], Float[Tensor, " frames"]]:
    """Find the coordinates that minimise every frame's cost at fixed xi.

    Frames that have converged leave the batch. Long sessions need only one chunk of intermediates at a time.

    Args:
        problem: markers, weights and posture prior of all frames.
        q: coordinates to start from.
        xi: geometry and marker places.
        iterations: most Levenberg-Marquardt steps of a frame.
        tolerance: relative fall of a frame's cost, as predicted for the next step, at which the frame stops.

    Returns:
        The coordinates and the cost of each frame.
    """
    layout = make_layout(problem, STEP_DTYPE)
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
    layout: ArrowLayout,
    partition: Partition,
    q: Tensor,
    shape: Shape,
    iterations: int,
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    """Return the coordinates (dofs, frames) and cost (frames,) of one chunk; arguments are those of ``solve_poses``."""
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
        # The falls of a converging frame shrink by a factor that itself shrinks, which bounds the next one.
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
    """Return the damped Gauss-Newton step (dofs, frames) of the coordinates alone."""
    given = damping.to(pieces.pull.dtype)
    d, _, _ = back_substitute(partition, eliminate(partition, pieces, given), given[:0])
    dq = damping.new_empty(d.shape[1], d.shape[0])
    dq[partition.dof_rows] = d.T.to(dq.dtype)
    return dq
