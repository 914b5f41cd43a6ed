"""Blocks of the arrow: normal matrix of one chunk of frames, without ever forming a marker Jacobian.

Given q, a marker's position is linear in the offsets and in its own place; H_qq is the mass matrix of point masses
w_m at the markers, the gradient a subtree sum of wrenches. All twists and wrenches are taken about the origin of the
root body of each frame, in W axes.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.geometry.layout import Layout
from torchid.geometry.problem import MarkerProblem
from torchid.kinematics.recursion import Poses, cross


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
class _Moments:
    """Sums over the markers of each subtree, (bodies, ., frames): mass, first and second moments, residual wrench."""

    mass: Tensor
    first: Tensor
    second: Tensor
    force: Tensor
    moment: Tensor


def assemble(problem: MarkerProblem, layout: Layout, q: Tensor, xi: Tensor, shared: bool) -> Blocks:
    """Blocks of the frames of ``problem`` at (q, xi); without the columns of xi unless ``shared``."""
    at, p, residual = problem.residual(q, xi)
    cost, weight = problem.robust_cost(residual)
    p = p - at.p[:1]
    pull = weight[:, None] * residual
    sums = _moments(layout, weight, p, pull)
    S, F = _motion_twists(layout, at, sums)
    g_q = _motion_gradient(S, layout, sums)
    prior_cost, prior_gradient, prior_curvature = problem.posture.pull(q)
    H_qq = torch.bmm(F, S.mT).mul_(layout.motion_over_motion)
    torch.diagonal(H_qq, dim1=1, dim2=2).add_(prior_curvature[layout.dof_rows].T)
    g_q += prior_gradient[layout.dof_rows].T
    if not shared:
        return Blocks(cost + prior_cost, g_q, H_qq)
    return _with_shared(problem, layout, Blocks(cost + prior_cost, g_q, H_qq), at, p, pull, weight, sums, (S, F))


def _moments(layout: Layout, weight: Tensor, p: Tensor, pull: Tensor) -> _Moments:
    markers, _, frames = p.shape
    wp = weight[:, None] * p
    stacked = torch.empty(markers, 16, frames, dtype=p.dtype, device=p.device)
    stacked[:, 0] = weight
    stacked[:, 1:4] = wp
    for k, (i, j) in enumerate(_PAIRS):
        torch.mul(wp[:, i], p[:, j], out=stacked[:, 4 + k])
    stacked[:, 10:13] = pull
    stacked[:, 13:16] = cross(p, pull)
    sums = (layout.subtree @ stacked.view(markers, -1)).view(-1, 16, frames)
    return _Moments(sums[:, 0:1], sums[:, 1:4], sums[:, 4:10], sums[:, 10:13], sums[:, 13:16])


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _second_times(second: Tensor, z: Tensor) -> Tensor:
    """Symmetric (n, 6, frames) times (n, 3, frames)."""
    xx, xy, xz, yy, yz, zz = (second[:, k] for k in range(6))
    x, y, w = z[:, 0], z[:, 1], z[:, 2]
    return torch.stack([xx * x + xy * y + xz * w, xy * x + yy * y + yz * w, xz * x + yz * y + zz * w], dim=1)


def _wrench(mass: Tensor, first: Tensor, second: Tensor, v: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """Momentum of composite point masses that move with twist (v, z)."""
    trace = (second[:, 0] + second[:, 3] + second[:, 5])[:, None]
    return mass * v + cross(z, first), cross(first, v) + trace * z - _second_times(second, z)


def _motion_twists(layout: Layout, at: Poses, sums: _Moments) -> tuple[Tensor, Tensor]:
    """Twists S and wrenches F = I S of the motion columns, each (frames, motion, 6)."""
    frames = at.p.shape[2]
    n = 6 + len(layout.motion_body)
    S = at.p.new_zeros(frames, n, 6)
    F = at.p.new_zeros(frames, n, 6)
    S[:, range(6), range(6)] = 1.0
    mass, first, second = sums.mass[0], sums.first[0], sums.second[0]
    F[:, 0, 0] = F[:, 1, 1] = F[:, 2, 2] = mass[0]
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        F[:, i, 3 + j], F[:, j, 3 + i] = first[k], -first[k]
        F[:, 3 + i, j], F[:, 3 + j, i] = -first[k], first[k]
    trace = second[0] + second[3] + second[5]
    for k, (i, j) in enumerate(_PAIRS):
        F[:, 3 + i, 3 + j] = F[:, 3 + j, 3 + i] = -second[k]
    for k in range(3):
        F[:, 3 + k, 3 + k] += trace
    body = layout.motion_body
    z, slide = at.turn_axis, at.slide_axis
    if len(slide):
        z = torch.cat([z, torch.zeros_like(slide)]).index_select(0, layout.motion_order)
        slide = torch.cat([torch.zeros_like(at.turn_axis), slide]).index_select(0, layout.motion_order)
    v = cross((at.p - at.p[:1]).index_select(0, body), z)
    if len(slide):
        v += slide
    f, m = _wrench(*(x.index_select(0, body) for x in (sums.mass, sums.first, sums.second)), v, z)
    for out, parts in ((S, (v, z)), (F, (f, m))):
        out[:, 6:, :3] = parts[0].permute(2, 0, 1)
        out[:, 6:, 3:] = parts[1].permute(2, 0, 1)
    return S, F


def _motion_gradient(S: Tensor, layout: Layout, sums: _Moments) -> Tensor:
    wrench = torch.cat([sums.force, sums.moment], dim=1)
    g = torch.empty(S.shape[:2], dtype=S.dtype, device=S.device)
    g[:, :6] = wrench[0].T
    torch.sum(S[:, 6:] * wrench.index_select(0, layout.motion_body).permute(2, 0, 1), dim=2, out=g[:, 6:])
    return g


def _with_shared(
    problem: MarkerProblem,
    layout: Layout,
    blocks: Blocks,
    at: Poses,
    p: Tensor,
    pull: Tensor,
    weight: Tensor,
    sums: _Moments,
    motion: tuple[Tensor, Tensor],
) -> Blocks:
    """Add the columns of xi: named parameters, then places of free markers."""
    (S, F), (Sg, Fg, gg) = motion, _shared_twists(layout, at, sums)
    Fm, gm = _marker_twists(problem, at, p, pull, weight)
    named = problem.n_named
    H_qg = torch.bmm(S, Fg.mT).mul_(layout.shared_in_motion)
    H_qg.addcmul_(torch.bmm(F, Sg.mT), layout.motion_in_shared.expand(len(F), -1, -1))
    H_qm = torch.bmm(S, Fm.mT).mul_(layout.marker_in_motion)
    half = layout.shared_in_shared * (_gram(Fg, Sg))
    H_gg = _fold(_fold(half + half.T, layout, named).T, layout, named)
    H_gm = _fold((layout.marker_in_shared * _gram(Sg, Fm)).T, layout, named).T
    H_mm = torch.diag(weight[problem.free].sum(1).repeat_interleave(3))
    H_xx = torch.cat([torch.cat([H_gg, H_gm], dim=1), torch.cat([H_gm.T, H_mm], dim=1)])
    H_qx = torch.cat([_fold(H_qg, layout, named), H_qm], dim=2)
    g_x = torch.cat([_fold(gg, layout, named), gm], dim=1)
    return Blocks(blocks.cost, blocks.g_q, blocks.H_qq, H_qx, g_x, H_xx)


def _gram(a: Tensor, b: Tensor) -> Tensor:
    """Sum over frames of a_k . b_l for (frames, k, 6), (frames, l, 6)."""
    return a.transpose(0, 1).reshape(a.shape[1], 6 * len(a)) @ b.transpose(0, 1).reshape(b.shape[1], 6 * len(b)).T


def _fold(x: Tensor, layout: Layout, named: int) -> Tensor:
    """Sum the entries (last dimension) that belong to the same named parameter."""
    if x.shape[-1] == named:
        return x
    return x[..., :named].index_add(-1, layout.parameter[named:], x[..., named:])


def _shared_twists(layout: Layout, at: Poses, sums: _Moments) -> tuple[Tensor, Tensor, Tensor]:
    """Twists, wrenches (frames, entries, 6) and gradients (frames, entries) of the geometry entries."""
    body = layout.shared_body
    n, frames = len(body), at.p.shape[2]
    v, z = at.p.new_zeros(n, 3, frames), at.p.new_zeros(n, 3, frames)
    R = torch.stack(at.R)
    v[layout.is_offset] = R[layout.offset_axis, layout.offset_parent]
    hinge = at.hinge_axis.index_select(0, layout.hinge_turn)
    origin = (at.p - at.p[:1]).index_select(0, body[~layout.is_offset])
    z[~layout.is_offset] = hinge
    v[~layout.is_offset] = cross(origin, hinge)
    v *= layout.coefficient[:, None, None]
    z *= layout.coefficient[:, None, None]
    f, m = _wrench(*(x.index_select(0, body) for x in (sums.mass, sums.first, sums.second)), v, z)
    g = (v * sums.force.index_select(0, body) + z * sums.moment.index_select(0, body)).sum(1).T
    return _six(v, z), _six(f, m), g


def _marker_twists(
    problem: MarkerProblem, at: Poses, p: Tensor, pull: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Wrenches (frames, 3 markers, 6) and gradients of the free markers' places."""
    free, frames = problem.free, p.shape[2]
    R = torch.stack(at.R, dim=1).index_select(0, problem.body[free])
    f = (weight[free, None, None] * R).reshape(-1, 3, frames)
    g = (R * pull[free, None]).sum(2).reshape(-1, frames).T
    return _six(f, cross(p[free].repeat_interleave(3, 0), f)), g


def _six(linear: Tensor, angular: Tensor) -> Tensor:
    out = torch.empty(linear.shape[2], linear.shape[0], 6, dtype=linear.dtype, device=linear.device)
    out[:, :, :3], out[:, :, 3:] = linear.permute(2, 0, 1), angular.permute(2, 0, 1)
    return out
