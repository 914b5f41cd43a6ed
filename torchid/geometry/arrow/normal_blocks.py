"""This module makes the blocks of the arrow, the normal matrix of a chunk of frames, without any marker Jacobian.

Given q, a marker's position is linear in the offsets and in its own place; H_qq is the mass matrix of point masses
w_m at the markers, the gradient a subtree sum of wrenches.

Every coordinate, of motion or of geometry, moves the markers of one subtree as a rigid body. All twists and wrenches
are taken about the origin of the root body of each frame, in W axes. Columns: six of the base, turns, hinge entries,
slides, offset entries (``ArrowLayout``).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow.index_tables import ArrowLayout
from torchid.geometry.problem import MarkerProblem, ProblemPoint
from torchid.kinematics.recursion import Poses, cross


@dataclass(frozen=True)
class Twists:
    """The twist, wrench and gradient of every column, with frames first."""

    S: Tensor
    """Twists (frames, columns, 6)."""
    F: Tensor
    """Wrenches (frames, columns, 6) of the subtree's markers, point masses of their weight, that move with S."""
    g: Tensor
    """Gradient of the markers' cost (frames, columns)."""


def moments(layout: ArrowLayout, weight: Tensor, p: Tensor, pull: Tensor) -> Tensor:
    """Sum weights and residuals over the markers of each subtree.

    Args:
        weight: weights of the markers (markers, frames).
        p: the markers' positions from the root's origin (markers, 3, frames).
        pull: weighted residuals (markers, 3, frames).

    Returns:
        Sums (bodies, 16, frames): mass, three first and six second moments of the weights, then force and moment of
        the weighted residuals.
    """
    markers, _, frames = p.shape
    stacked = torch.empty(markers, 16, frames, dtype=p.dtype, device=p.device)
    stacked[:, 0] = weight
    wp = torch.mul(weight[:, None], p, out=stacked[:, 1:4])
    torch.mul(wp[:, :1], p, out=stacked[:, 4:7])
    torch.mul(wp[:, 1:2], p[:, 1:], out=stacked[:, 7:9])
    torch.mul(wp[:, 2], p[:, 2], out=stacked[:, 9])
    stacked[:, 10:13] = pull
    stacked[:, 13:16] = cross(p, pull)
    return (layout.subtree @ stacked.flatten(1)).view(len(layout.subtree), 16, frames)


def column_twists(layout: ArrowLayout, at: Poses, sums: Tensor, shared: bool) -> Twists:
    """Compute the twists of the columns of motion, and of geometry.

    Args:
        at: poses of all bodies, measured from the root's origin.
        sums: from ``moments``.
        shared: False leaves geometry out.
    """
    z, t = column_axes(layout, at, shared)
    turning, sliding = layout.turning_body[: len(z)], layout.sliding_body[: len(t)]
    twist = z.new_empty(6 + len(z) + len(t), 6, z.shape[2])
    wrench = torch.empty_like(twist)
    _fill_base(layout.composite, sums[0], twist[:6], wrench[:6])
    _fill_turns(at, sums.index_select(0, turning), turning, z, twist[6 : 6 + len(z)], wrench[6 : 6 + len(z)])
    _fill_slides(sums.index_select(0, sliding), t, twist[6 + len(z) :], wrench[6 + len(z) :])
    g = torch.empty_like(twist[:, 0])
    g[:6] = sums[0, 10:]
    pull = sums[:, 10:].index_select(0, torch.cat([turning, sliding]))
    torch.sum(twist[6:] * pull, dim=1, out=g[6:])
    return Twists(_frames_first(twist), _frames_first(wrench), g.T)


def column_axes(layout: ArrowLayout, at: Poses, shared: bool) -> tuple[Tensor, Tensor]:
    """Return the axes of turns and hinge entries, and the directions of slides and offset entries."""
    z, t = at.turn_axis.index_select(0, layout.turn_order), at.slide_axis
    if not shared:
        return z, t
    frames = z.shape[2]
    hinge = (layout.hinge_map @ at.hinge_axis.flatten(1)).view(len(layout.hinge_map), 3, frames)
    offset = (layout.offset_map @ at.R.flatten(0, 1).flatten(1)).view(len(layout.offset_map), 3, frames)
    return torch.cat([z, hinge]), torch.cat([t, offset])


def _frames_first(x: Tensor) -> Tensor:
    """Turn (n, 6, frames) into (frames, n, 6) by a transpose of matrices, which torch copies fast."""
    return x.flatten(0, 1).T.contiguous().view(x.shape[2], x.shape[0], 6)


def _fill_base(composite: Tensor, sums: Tensor, twist: Tensor, wrench: Tensor) -> None:
    """Fill in the root's translations and rotations: the identity, and the composite inertia of all markers."""
    twist.copy_(torch.eye(6, dtype=twist.dtype, device=twist.device)[:, :, None])
    torch.mm(composite, sums[:10], out=wrench.view(36, -1))


def _fill_turns(at: Poses, sums: Tensor, body: Tensor, z: Tensor, twist: Tensor, wrench: Tensor) -> None:
    """Fill in the turns about axes z through the origins of their bodies."""
    mass, first, second = sums[:, :1], sums[:, 1:4], sums[:, 4:10]
    v = cross(at.p.index_select(0, body), z)
    twist[:, :3], twist[:, 3:] = v, z
    torch.addcmul(cross(z, first), mass, v, out=wrench[:, :3])
    moment = torch.addcmul(cross(first, v), second[:, 0:1] + second[:, 3:4] + second[:, 5:6], z)
    for row, entries in enumerate(((0, 1, 2), (1, 3, 4), (2, 4, 5))):
        for column, k in enumerate(entries):
            moment[:, row].addcmul_(second[:, k], z[:, column], value=-1)
    wrench[:, 3:] = moment


def _fill_slides(sums: Tensor, t: Tensor, twist: Tensor, wrench: Tensor) -> None:
    """Fill in the translations along t."""
    twist[:, :3] = t
    twist[:, 3:] = 0.0
    torch.mul(sums[:, :1], t, out=wrench[:, :3])
    wrench[:, 3:] = cross(sums[:, 1:4], t)


def with_markers(columns: Twists, R: Tensor, p: Tensor, weight: Tensor, pull: Tensor) -> Twists:
    """Append the columns of some markers' places: three each, along the axes of the marker's body.

    Args:
        columns: twists of motion and named parameters.
        R: columns of R_WB of each marker's body (markers, 3 columns, 3, frames).
        p: the markers' positions from the root's origin (markers, 3, frames).
        weight: weights of the markers (markers, frames).
        pull: weighted residuals (markers, 3, frames).
    """
    n, frames = len(p), p.shape[2]
    twist, wrench = (torch.zeros(n, 3, 6, frames, dtype=p.dtype, device=p.device) for _ in range(2))
    twist[:, :, :3] = R
    f = torch.mul(weight[:, None, None], R, out=wrench[:, :, :3])
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        torch.mul(p[:, None, i], f[:, :, j], out=wrench[:, :, 3 + k])
        wrench[:, :, 3 + k].addcmul_(p[:, None, j], f[:, :, i], value=-1)
    g = (R * pull[:, None]).sum(2).flatten(0, 1).T
    return Twists(
        torch.cat([columns.S, _frames_first(twist.flatten(0, 1))], dim=1),
        torch.cat([columns.F, _frames_first(wrench.flatten(0, 1))], dim=1),
        torch.cat([columns.g, g], dim=1),
    )


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
