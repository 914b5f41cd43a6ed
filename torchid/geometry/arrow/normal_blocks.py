"""Blocks of the arrow: normal matrix of one chunk of frames, without ever forming a marker Jacobian.

Given q, a marker's position is linear in the offsets and in its own place; H_qq is the mass matrix of point masses
w_m at the markers, the gradient a subtree sum of wrenches. The dense blocks of this module serve covariances and are
what the elimination by branches is tested against.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.geometry.arrow.index_tables import Layout
from torchid.geometry.arrow.twists import Twists, column_gradient, column_twists, moments, with_markers
from torchid.geometry.problem import Evaluation, MarkerProblem


@dataclass(frozen=True)
class Blocks:
    """Quadratic model of the cost of a chunk: frames first, motion columns in plan order."""

    cost: Tensor
    """(frames,)"""
    g_q: Tensor
    """(frames, motion)"""
    H_qq: Tensor
    """(frames, motion, motion), lower triangle."""
    H_qx: Tensor | None = None
    """(frames, motion, xi)"""
    g_x: Tensor | None = None
    """(frames, xi)"""
    H_xx: Tensor | None = None
    """(xi, xi), summed over the frames."""


@dataclass(frozen=True)
class Pieces:
    """What all blocks of a chunk are made of."""

    cost: Tensor
    """(frames,), posture included."""
    columns: Twists
    pull: Tensor
    """Gradient of the posture prior, (frames, motion)."""
    curvature: Tensor
    """Its second derivative, (frames, motion)."""
    marker_weight: Tensor
    """Sum of the free markers' weights over the frames, three times each; empty without xi."""


def make_pieces(problem: MarkerProblem, layout: Layout, seen: Evaluation, shared: bool) -> Pieces:
    """Twists, wrenches and gradients of the frames of ``problem`` where it was evaluated, in the layout's precision."""
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
    return Pieces(seen.cost, columns, pull, curvature, total)


def make_gradient(
    problem: MarkerProblem, layout: Layout, q: Tensor, xi: Tensor, shared: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Cost (frames,) and gradient of each frame in motion (motion, frames) and entries (entries, frames)."""
    seen = problem.evaluate(q, problem.shape(xi))
    at, pull = seen.at.about_root(q.dtype), seen.weight[:, None] * seen.residual
    columns = column_gradient(layout, at, seen.p - seen.at.p[:1], pull, shared)
    g_q = columns.index_select(0, layout.motion if shared else layout.motion_alone)
    g_q += seen.pull.index_select(0, layout.dof_rows)
    if not shared:
        return seen.cost, g_q, columns[:0]
    free = problem.free
    R = at.R.index_select(0, problem.body[free])
    places = (R * pull[free, None]).sum(2).flatten(0, 1)
    return seen.cost, g_q, torch.cat([columns[layout.entries[: layout.geometric]], places])


def assemble(problem: MarkerProblem, layout: Layout, q: Tensor, xi: Tensor, shared: bool) -> Blocks:
    """Blocks of the frames of ``problem`` at (q, xi); without the columns of xi unless ``shared``."""
    pieces = make_pieces(problem, layout, problem.evaluate(q, problem.shape(xi)), shared)
    motion = layout.motion if shared else layout.motion_alone
    S, F = pieces.columns.S[:, motion], pieces.columns.F[:, motion]
    H_qq = torch.bmm(F, S.mT).mul_(lower_mask(layout, layout.motion_body))
    torch.diagonal(H_qq, dim1=1, dim2=2).add_(pieces.curvature)
    blocks = Blocks(pieces.cost, pieces.columns.g[:, motion] + pieces.pull, H_qq)
    return _with_shared(layout, pieces, blocks, S, F, len(xi)) if shared else blocks


def lower_mask(layout: Layout, body: Tensor) -> Tensor:
    """(motion, motion) 1 in the lower triangle where the row's support lies within the column's."""
    return torch.tril(layout.within(body, body))


def _with_shared(layout: Layout, pieces: Pieces, blocks: Blocks, S: Tensor, F: Tensor, n_xi: int) -> Blocks:
    """Add the columns of xi: named parameters, then places of free markers."""
    Se, Fe = pieces.columns.S[:, layout.entries], pieces.columns.F[:, layout.entries]
    inside, around = layout.nesting(layout.motion_body)
    fold = torch.nn.functional.one_hot(layout.entry_xi, n_xi).to(S)
    H_qx = (torch.bmm(F, Se.mT) * inside + torch.bmm(S, Fe.mT) * around) @ fold
    g_x = pieces.columns.g[:, layout.entries] @ fold
    return Blocks(blocks.cost, blocks.g_q, blocks.H_qq, H_qx, g_x, fold.T @ shared_block(layout, pieces) @ fold)


def shared_block(layout: Layout, pieces: Pieces) -> Tensor:
    """H of the entries (entries, entries), summed over the frames."""
    geometric = layout.geometric
    S, F = _rows(pieces.columns.S, layout.entries[:geometric]), _rows(pieces.columns.F, layout.entries)
    H, FS = torch.diag(torch.cat([F.new_zeros(geometric), pieces.marker_weight])), F @ S.T
    inside = layout.within(layout.entry_body, layout.entry_body[:geometric])
    own = inside[:geometric]
    half = (own - 0.5 * own * own.T) * FS[:geometric]
    H[:geometric, :geometric] = half + half.T
    H[geometric:, :geometric] = inside[geometric:] * FS[geometric:]
    H[:geometric, geometric:] = H[geometric:, :geometric].T
    return H


def shared_curve(layout: Layout, pieces: Pieces, dx: Tensor) -> Tensor:
    """dx' H dx / 2 of the entries alone, for each frame; left out of a frame's model, it looks like a bad model."""
    geometric, step = layout.geometric, dx[layout.entry_xi]
    S, F = layout.of_entries(pieces.columns.S), layout.of_entries(pieces.columns.F)
    inside = layout.within(layout.entry_body, layout.entry_body[:geometric])
    inside[:geometric] -= 0.5 * inside[:geometric] * inside[:geometric].T
    work = (F * ((inside * step[:geometric]) @ S[:, :geometric])).sum(2)
    work[:, geometric:] += 0.5 * step[geometric:] * (F[:, geometric:, :3] * S[:, geometric:, :3]).sum(2)
    return work @ step


def _rows(x: Tensor, columns: Tensor) -> Tensor:
    """Some columns of (frames, n, 6) as (columns, 6 frames)."""
    return x.transpose(0, 1).index_select(0, columns).reshape(len(columns), x.shape[0] * x.shape[2])
