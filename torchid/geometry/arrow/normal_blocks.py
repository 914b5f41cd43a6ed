"""This module makes the blocks of the arrow, the normal matrix of a chunk of frames, without any marker Jacobian.

Given q, a marker's position is linear in the offsets and in its own place; H_qq is the mass matrix of point masses
w_m at the markers, the gradient a subtree sum of wrenches.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow.index_tables import ArrowLayout
from torchid.geometry.arrow.twists import Twists, column_twists, moments, with_markers
from torchid.geometry.problem import MarkerProblem, ProblemPoint


@dataclass(frozen=True)
class BlockPieces:
    """The parts of which all blocks of a chunk of frames are made."""

    cost: Tensor
    """Cost (frames,), posture included."""
    columns: Twists
    """Twists, wrenches and gradients of all columns."""
    pull: Tensor
    """Gradient of the posture prior (frames, motion)."""
    curvature: Tensor
    """Diagonal of the posture prior's second derivative (frames, motion)."""
    marker_weight: Tensor
    """Sum of the weights of each free marker over the frames, three times (3 * free,)."""
    fold: Tensor | None = None
    """Derivatives of the columns of motion by the coordinates (frames, columns, dofs); None where they are the same."""


def fold_matrix(layout: ArrowLayout, q: Tensor, dtype: torch.dtype) -> Tensor | None:
    """Return the derivatives of the columns of motion by the coordinates (frames, columns, dofs); None for identity.

    Args:
        q: coordinates (dofs, frames).
    """
    if layout.coupling is None:
        return None
    own = torch.eye(len(q)).to(q)[:, :, None].expand(-1, -1, q.shape[1])
    both = torch.cat([own, layout.coupling.jacobian(q)]).index_select(0, layout.axis_rows)
    return both.permute(2, 0, 1).to(dtype)


def fold_rows(fold: Tensor, lower: Tensor, beside: Tensor) -> tuple[Tensor, Tensor]:
    """Fold the block of the columns of motion and what stands beside it into those of the coordinates.

    Args:
        fold: from ``fold_matrix``.
        lower: lower triangle of the block (frames, columns, columns).
        beside: mixed columns or gradient (frames, columns, some).

    Returns:
        The whole block (frames, dofs, dofs), and what stands beside it (frames, dofs, some).
    """
    whole = lower + torch.tril(lower, -1).mT
    return fold.mT @ whole @ fold, fold.mT @ beside


def make_pieces(problem: MarkerProblem, layout: ArrowLayout, seen: ProblemPoint, shared: bool) -> BlockPieces:
    """Compute twists, wrenches and gradients of all frames of a problem, in the layout's precision.

    Args:
        shared: False leaves the columns of xi out.
    """
    dtype = layout.subtree.dtype
    at, weight, p = seen.at.about_root(dtype), seen.weight.to(dtype), (seen.p - seen.at.p[:1]).to(dtype)
    pull = weight[:, None] * seen.residual.to(dtype)
    columns = column_twists(layout, at, moments(layout, weight, p, pull), shared)
    total = weight[problem.free].sum(1).repeat_interleave(3)
    if shared and len(problem.free):
        free = problem.free
        R = at.R.index_select(0, problem.body[free])
        columns = with_markers(columns, R, p[free], weight[free], pull[free])
    pull, curvature = (x.to(dtype).index_select(0, layout.dof_rows).T for x in (seen.pull, seen.curvature))
    return BlockPieces(seen.cost, columns, pull, curvature, total, fold_matrix(layout, seen.at.q, dtype))


def posture_block(
    problem: MarkerProblem, layout: ArrowLayout, q: Tensor, xi: Tensor
) -> Float[Tensor, "frames motion motion"]:
    """Return the lower triangle of the block of motion of every frame, at q (dofs, frames) and without the entries."""
    pieces = make_pieces(problem, layout, problem.evaluate(q, problem.shape(xi)), shared=False)
    S, F = pieces.columns.S[:, layout.motion_alone], pieces.columns.F[:, layout.motion_alone]
    H_qq = torch.bmm(F, S.mT).mul_(lower_mask(layout, layout.motion_body))
    if pieces.fold is not None:
        H_qq, _ = fold_rows(pieces.fold, H_qq, H_qq[:, :, :0])
    torch.diagonal(H_qq, dim1=1, dim2=2).add_(pieces.curvature)
    return H_qq


def lower_mask(layout: ArrowLayout, body: Tensor) -> Tensor:
    """Return the matrix (body, body) with 1 in the lower triangle where the row's support lies within the column's."""
    return torch.tril(layout.within(body, body))


def shared_block(layout: ArrowLayout, pieces: BlockPieces) -> Tensor:
    """Return the normal matrix of the entries (entries, entries), summed over the frames of ``pieces``."""
    geometric = layout.geometric
    S, F = _stacked(pieces.columns.S, layout.entries[:geometric]), _stacked(pieces.columns.F, layout.entries)
    H, FS = torch.diag(torch.cat([F.new_zeros(geometric), pieces.marker_weight])), F @ S.T
    inside = layout.within(layout.entry_body, layout.entry_body[:geometric])
    own = inside[:geometric]
    half = (own - 0.5 * own * own.T) * FS[:geometric]
    H[:geometric, :geometric] = half + half.T
    H[geometric:, :geometric] = inside[geometric:] * FS[geometric:]
    H[:geometric, geometric:] = H[geometric:, :geometric].T
    return H


def shared_curve(layout: ArrowLayout, pieces: BlockPieces, dx: Tensor) -> Tensor:
    """Return dx' H dx / 2 of the entries alone, for each frame (frames,).

    A frame's quadratic model needs the term: without it, a good model looks like a bad one.

    Args:
        dx: step of xi (xi,).
    """
    geometric, step = layout.geometric, dx[layout.entry_xi]
    S, F = layout.of_entries(pieces.columns.S), layout.of_entries(pieces.columns.F)
    inside = layout.within(layout.entry_body, layout.entry_body[:geometric])
    inside[:geometric] -= 0.5 * inside[:geometric] * inside[:geometric].T
    work = (F * ((inside * step[:geometric]) @ S[:, :geometric])).sum(2)
    work[:, geometric:] += 0.5 * step[geometric:] * (F[:, geometric:, :3] * S[:, geometric:, :3]).sum(2)
    return work @ step


def _stacked(x: Tensor, columns: Tensor) -> Tensor:
    """Return some columns of x (frames, n, 6) as a matrix (columns, 6 frames)."""
    return x.transpose(0, 1).index_select(0, columns).reshape(len(columns), x.shape[0] * x.shape[2])
