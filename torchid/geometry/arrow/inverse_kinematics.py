"""This module is inverse kinematics: all frames at fixed geometry, each with its own damping and convergence."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow.elimination import back_substitute, eliminate
from torchid.geometry.arrow.index_tables import ArrowLayout, make_layout
from torchid.geometry.arrow.limb_partition import Partition, make_partition
from torchid.geometry.arrow.normal_blocks import BlockPieces, make_pieces
from torchid.geometry.problem import MarkerProblem, SubjectShape, retract

CHUNK = 2048
"""Frames solved in one batch; chosen for memory."""
STEP_DTYPE = torch.float32
"""Precision of the steps; chosen, because it halves the memory to move and the next step mends the error of one.

Cost, poses and coordinates keep the precision of the input.
"""
DENSE = 64
"""Frames up to which the whole block of a frame is factorised at once instead of limb by limb; chosen: following one
frame after the other takes two thirds of the time (`benchmarks.live`), in batches of some hundreds it takes longer."""
LEAST_DAMPING = 1e-6
"""Least damping; chosen to keep a block in ``STEP_DTYPE`` positive definite."""


@dataclass(frozen=True)
class Prepared:
    """This is all that does not depend on frames: tables of the steps, and the shape of the subject."""

    layout: ArrowLayout
    partition: Partition
    shape: SubjectShape
    inside: Float[Tensor, "columns columns"]
    """1 where the bodies that the row's column of motion moves are among those that the column's moves."""


def prepare(problem: MarkerProblem, xi: Float[Tensor, " xi"]) -> Prepared:
    """Return what every call of ``solve_poses`` needs for problems that differ in their frames alone."""
    layout = make_layout(problem, STEP_DTYPE)
    inside = layout.within(layout.motion_body, layout.motion_body)
    return Prepared(layout, make_partition(problem.plan, layout, 0), problem.shape(xi), inside)


def solve_poses(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    iterations: int = 40,
    tolerance: float = 1e-5,
    prepared: Prepared | None = None,
) -> tuple[Float[Tensor, "dofs frames"], Float[Tensor, " frames"]]:
    """Find the coordinates that minimise every frame's cost at fixed xi.

    Frames that have converged leave the batch. Long sessions need only one chunk of intermediates at a time.

    Args:
        problem: markers, weights and posture prior of all frames.
        q: coordinates to start from.
        iterations: most Levenberg-Marquardt steps of a frame.
        tolerance: relative fall of a frame's cost, as predicted for the next step, at which the frame stops.
        prepared: from ``prepare``, for who calls often; None prepares.

    Returns:
        The coordinates and the cost of each frame.
    """
    ready = prepare(problem, xi) if prepared is None else prepared
    q, cost = q.clone(), q.new_empty(q.shape[1])
    for start in range(0, q.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        q[:, part], cost[part] = _solve_chunk(problem.frames(part), ready, q[:, part], iterations, tolerance)
    return q, cost


def _solve_chunk(
    problem: MarkerProblem,
    ready: Prepared,
    q: Tensor,
    iterations: int,
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    """Return the coordinates (dofs, frames) and cost (frames,) of one chunk; arguments are those of ``solve_poses``."""
    shape, out_q, out_cost = ready.shape, torch.empty_like(q), torch.empty_like(q[0])
    active = torch.arange(q.shape[1], device=q.device)
    seen, damping, before = problem.evaluate(q, shape), q.new_full((q.shape[1],), 1e-3), q.new_ones(q.shape[1])
    for _ in range(iterations):
        pieces = make_pieces(problem, ready.layout, seen, shared=False)
        trial = retract(
            q, _dense_step(ready, pieces, damping) if q.shape[1] <= DENSE else _step(ready, pieces, damping)
        )
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


def _step(ready: Prepared, pieces: BlockPieces, damping: Tensor) -> Tensor:
    """Return the damped Gauss-Newton step (dofs, frames) of the coordinates alone, limb by limb."""
    given, partition = damping.to(pieces.pull.dtype), ready.partition
    d, _, _ = back_substitute(partition, eliminate(partition, pieces, given), given[:0])
    return _in_rows(d, partition.dof_rows, damping)


def _dense_step(ready: Prepared, pieces: BlockPieces, damping: Tensor) -> Tensor:
    """Return the same step from each frame's whole block."""
    motion, given = ready.layout.motion_alone, damping.to(pieces.pull.dtype)
    S, F = (x.index_select(1, motion) for x in (pieces.columns.S, pieces.columns.F))
    half = torch.bmm(F, S.mT) * ready.inside
    H, gradient = half + half.mT * (1.0 - ready.inside), pieces.columns.g.index_select(1, motion)
    if pieces.fold is not None:
        H, gradient = pieces.fold.mT @ H @ pieces.fold, (pieces.fold.mT @ gradient[:, :, None])[:, :, 0]
    floor = 1e-9 * pieces.columns.F[:, 0, 0] + 1e-12
    diagonal = torch.diagonal(H, dim1=1, dim2=2)
    diagonal += pieces.curvature
    diagonal += given[:, None] * (diagonal + floor[:, None]) + floor[:, None]
    d = -torch.cholesky_solve((gradient + pieces.pull)[:, :, None], torch.linalg.cholesky_ex(H).L)[:, :, 0]
    return _in_rows(d, ready.layout.dof_rows, damping)


def _in_rows(d: Tensor, rows: Tensor, like: Tensor) -> Tensor:
    """Return steps (frames, motion) as (dofs, frames), in the order of q."""
    dq = like.new_empty(d.shape[1], d.shape[0])
    dq[rows] = d.T.to(dq.dtype)
    return dq
