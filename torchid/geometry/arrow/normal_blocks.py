"""This module makes the blocks of the arrow, the normal matrix of a chunk of frames, without any marker Jacobian.

Given q, a marker's position is linear in the offsets and in its own place; H_qq is the mass matrix of point masses
w_m at the markers, the gradient a subtree sum of wrenches. The dense blocks of this module serve covariances and are
what the elimination by branches is tested against.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.geometry.arrow.index_tables import ArrowLayout
from torchid.geometry.arrow.twists import Twists, column_twists, moments, with_markers
from torchid.geometry.problem import MarkerProblem, ProblemPoint


@dataclass(frozen=True)
class NormalBlocks:
    """The quadratic model of the cost of a chunk, with frames first and the columns of motion as in the layout."""

    cost: Tensor
    """Cost (frames,), posture included."""
    g_q: Tensor
    """Gradient of motion (frames, motion)."""
    H_qq: Tensor
    """Lower triangle of the block of motion (frames, motion, motion)."""
    H_qx: Tensor | None = None
    """Mixed block (frames, motion, xi)."""
    g_x: Tensor | None = None
    """Gradient of xi (frames, xi)."""
    H_xx: Tensor | None = None
    """Block of xi (xi, xi), summed over the frames."""


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


def assemble(problem: MarkerProblem, layout: ArrowLayout, q: Tensor, xi: Tensor, shared: bool) -> NormalBlocks:
    """Compute the dense blocks of all frames of a problem.

    Args:
        q: coordinates (dofs, frames).
        shared: False leaves the columns of xi out.
    """
    pieces = make_pieces(problem, layout, problem.evaluate(q, problem.shape(xi)), shared)
    motion = layout.motion if shared else layout.motion_alone
    S, F = pieces.columns.S[:, motion], pieces.columns.F[:, motion]
    H_qq, g_q = torch.bmm(F, S.mT).mul_(lower_mask(layout, layout.motion_body)), pieces.columns.g[:, motion, None]
    if pieces.fold is not None:
        H_qq, g_q = fold_rows(pieces.fold, H_qq, g_q)
    torch.diagonal(H_qq, dim1=1, dim2=2).add_(pieces.curvature)
    blocks = NormalBlocks(pieces.cost, g_q[:, :, 0] + pieces.pull, H_qq)
    return _with_shared(layout, pieces, blocks, S, F, len(xi)) if shared else blocks


def lower_mask(layout: ArrowLayout, body: Tensor) -> Tensor:
    """Return the matrix (body, body) with 1 in the lower triangle where the row's support lies within the column's."""
    return torch.tril(layout.within(body, body))


def _with_shared(
    layout: ArrowLayout, pieces: BlockPieces, blocks: NormalBlocks, S: Tensor, F: Tensor, n_xi: int
) -> NormalBlocks:
    """Return the blocks with the columns of xi added: named parameters, then places of free markers."""
    Se, Fe = pieces.columns.S[:, layout.entries], pieces.columns.F[:, layout.entries]
    inside, around = layout.nesting(layout.motion_body)
    fold = torch.nn.functional.one_hot(layout.entry_xi, n_xi).to(S)
    H_qx = (torch.bmm(F, Se.mT) * inside + torch.bmm(S, Fe.mT) * around) @ fold
    H_qx = H_qx if pieces.fold is None else pieces.fold.mT @ H_qx
    g_x = pieces.columns.g[:, layout.entries] @ fold
    return NormalBlocks(blocks.cost, blocks.g_q, blocks.H_qq, H_qx, g_x, fold.T @ shared_block(layout, pieces) @ fold)


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
