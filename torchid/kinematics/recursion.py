"""Poses and accelerations of all bodies, frames last, in a few operations on all joints at once.

Every joint's rotation is made in its parent's axes, all bodies side by side; only their products down the tree go
level by level. Positions, velocities and accelerations are then sums over ancestors: one matrix product each. Some
fifty operations a call instead of the chain's thousands (tests hold the two equal).

Reference: Featherstone, Rigid Body Dynamics Algorithms (2008), sections 4.1 and 5.3, in world axes.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.kinematics.plan import Plan, plan_tree
from torchid.kinematics.tables import Joints, Tables, make_joints
from torchid.model.model import Geometry
from torchid.model.rotation import compose, exp, rodrigues, turned
from torchid.model.tree import BASE_DOFS, Tree

CHUNK = 1024
"""Frames whose transforms are made together: their intermediates stay in the cache."""
SMALL = 20_000
"""Entries below which one call of the library's cross product beats six strided ones (above, it is half as fast)."""


@dataclass(frozen=True)
class Poses:
    """Where every body is; bodies and axes in plan order, frames last, W axes."""

    joints: Joints
    R: Float[Tensor, "bodies 3 3 frames"]
    """R_WB; the second dimension counts columns."""
    p: Float[Tensor, "bodies 3 frames"]
    """p_WB_W [m]."""
    local: Float[Tensor, "turns 3 3 frames"]
    """Rotation of the parent's axes by each turn and those before it in the same joint."""
    q: Float[Tensor, "dofs frames"]
    """Coordinates [m, rad]."""

    def about_root(self, dtype: torch.dtype) -> "Poses":
        """The same with places measured from the root's, in another precision."""
        p = self.p - self.p[:1]
        return Poses(self.joints.to(dtype), self.R.to(dtype), p.to(dtype), self.local.to(dtype), self.q)

    @property
    def tables(self) -> Tables:
        """Constants of the plan."""
        return self.joints.tables

    @property
    def turn_axis(self) -> Float[Tensor, "turns 3 frames"]:
        """Axes of the moving turns, signs included."""
        axis, n = self.joints.turn[:, :, None], self.tables.first
        R = self.R.index_select(0, self.tables.turn_parent)
        moved = turned(self.local.index_select(0, self.tables.turn_before), axis[n:])
        return torch.cat([turned(R[:n], axis[:n]), turned(R[n:], moved)])

    @cached_property
    def hinge_axis(self) -> Float[Tensor, "hinges 3 frames"]:
        """Axes of the turns by hinge angles, signs included."""
        local = turned(_padded(self.local).index_select(0, self.tables.hinge_before), self.joints.hinge[:, :, None])
        return turned(self.R.index_select(0, self.tables.hinge_parent), local)

    @property
    def slide_axis(self) -> Float[Tensor, "slides 3 frames"]:
        """Directions of the slides."""
        parent = self.tables.parent.index_select(0, self.tables.slide_link)
        return turned(self.R.index_select(0, parent), self.joints.slide[:, :, None])


@dataclass(frozen=True)
class BodyMotion:
    """Velocities and classical accelerations of the bodies' frames (gravity not included), W axes, plan order."""

    w: Float[Tensor, "bodies 3 frames"]
    """Angular velocity [rad/s]."""
    alpha: Float[Tensor, "bodies 3 frames"]
    """Angular acceleration [rad/s^2]."""
    v: Float[Tensor, "bodies 3 frames"]
    """Velocity of the origin [m/s]."""
    a: Float[Tensor, "bodies 3 frames"]
    """Acceleration of the origin [m/s^2]."""


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Cross product along the last dimension but one of (..., 3, frames) tensors."""
    if max(a.numel(), b.numel()) < SMALL or torch.compiler.is_compiling():
        return torch.linalg.cross(a, b, dim=-2)
    # NumPy's: torch.broadcast_shapes brings SymPy, 0.2 s of a start.
    out = torch.empty(np.broadcast_shapes(a.shape, b.shape), dtype=a.dtype, device=a.device)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        torch.mul(a[..., i, :], b[..., j, :], out=out[..., k, :])
        out[..., k, :].addcmul_(a[..., j, :], b[..., i, :], value=-1)
    return out


def lengths(x: Tensor) -> Tensor:
    """Lengths along the last dimension but one of (..., 3, frames) tensors, which ``norm`` takes thirty times as long
    for."""
    a, b, c = x.unbind(-2)
    return (a * a).addcmul_(b, b).addcmul_(c, c).sqrt_()


def poses(plan: Plan, q: Float[Tensor, "dofs frames"], geometry: Geometry | Joints) -> Poses:
    """Walk the tree: poses of all bodies; the axes of their joints follow from them on demand.

    Args:
        q: coordinates, frames last [m, rad].
        geometry: offsets and hinge angles, or the joints made of them.
    """
    joints = geometry if isinstance(geometry, Joints) else make_joints(plan, geometry)
    tables = joints.tables
    s = plan.tree.axes(q)
    turns = rodrigues(joints.generators, s.index_select(0, tables.turn_row))
    slots = [turns[: tables.first]]
    for start, stop, before in tables.slots:
        slots.append(compose(slots[-1].index_select(0, before), turns[start:stop]))
    local = torch.cat(slots)
    links = _links(tables, joints, local)
    levels = [exp(q[3:BASE_DOFS])[None]]
    for start, stop, parents in tables.parents:
        levels.append(compose(levels[-1].index_select(0, parents), links[start - 1 : stop - 1]))
    R = torch.cat(levels)
    offset = joints.offset[:, :, None]
    if plan.slides:
        slid = joints.slide[:, :, None] * s.index_select(0, tables.slide_row)[:, None]
        offset = offset.expand(-1, -1, q.shape[1]).index_add(0, tables.slide_link, slid)
    arm = turned(R.index_select(0, tables.parent), offset)
    return Poses(joints, R, _summed(q[:3], tables.above[:, 1:], arm), local, q)


def body_motion(plan: Plan, at: Poses, v: Float[Tensor, "dofs frames"], a: Float[Tensor, "dofs frames"]) -> BodyMotion:
    """Velocities and accelerations of all bodies at poses ``at``.

    Args:
        at: the poses of the same frames.
        v: velocities: base linear and angular in W, then time derivatives of the joint coordinates.
        a: accelerations, likewise.
    """
    tables, z = at.tables, at.turn_axis
    v, a = plan.tree.rates(at.q, v, a)
    rate = z * v.index_select(0, tables.turn_row)[:, None]
    w = _summed(v[3:BASE_DOFS], tables.turns_above, rate)
    own = torch.addcmul(cross(_carried(tables, w, rate), rate), z, a.index_select(0, tables.turn_row)[:, None])
    alpha = _summed(a[3:BASE_DOFS], tables.turns_above, own)
    arm = at.p[1:] - at.p.index_select(0, tables.parent)
    w_parent = w.index_select(0, tables.parent)
    drift = cross(w_parent, arm)
    pull = cross(alpha.index_select(0, tables.parent), arm) + cross(w_parent, drift)
    if plan.slides:
        t, row, link = at.slide_axis, tables.slide_row, tables.slide_link
        sliding = t * v.index_select(0, row)[:, None]
        drift = drift.index_add(0, link, sliding)
        coriolis = 2.0 * cross(w_parent.index_select(0, link), sliding)
        pull = pull.index_add(0, link, torch.addcmul(coriolis, t, a.index_select(0, row)[:, None]))
    links = tables.above[:, 1:]
    return BodyMotion(w, alpha, _summed(v[:3], links, drift), _summed(a[:3], links, pull))


def _carried(tables: Tables, w: Tensor, rate: Tensor) -> Float[Tensor, "turns 3 frames"]:
    """Angular velocity of every turn's axis: the parent's and the turns' before it in the same joint."""
    slots, done = [w.index_select(0, tables.turn_parent[: tables.first])], 0
    for start, _, before in tables.slots:
        slots.append((slots[-1] + rate[done:start]).index_select(0, before))
        done = start
    return torch.cat(slots)


def body_transforms(
    tree: Tree, q: Float[Tensor, "frames dofs"], geometry: Geometry
) -> Float[Tensor, "frames bodies 4 4"]:
    """X_WB of all bodies in the tree's order, frames first.

    Args:
        q: coordinates [m, rad].
        geometry: offsets and hinge angles.
    """
    plan = plan_tree(tree)
    joints, place = make_joints(plan, geometry), list(plan.position)
    X_WB = q.new_zeros(len(q), len(tree.bodies), 4, 4)
    X_WB[..., 3, 3] = 1.0
    for some, X in zip(q.split(CHUNK), X_WB.split(CHUNK), strict=True):
        at = poses(plan, some.T.contiguous(), joints)
        X[..., :3, :3], X[..., :3, 3] = at.R[place].permute(3, 0, 2, 1), at.p[place].permute(2, 0, 1)
    return X_WB


def points(at: Poses, body: Tensor, p_BM_B: Float[Tensor, "markers 3"]) -> Float[Tensor, "markers 3 frames"]:
    """p_WM_W of points fixed to the bodies at plan positions ``body``."""
    return turned(at.R.index_select(0, body), p_BM_B[:, :, None]).add_(at.p.index_select(0, body))


def _summed(base: Tensor, which: Tensor, parts: Tensor) -> Tensor:
    """The base's vector (3, frames) plus those of some parts (n, 3, frames), for each row of ``which``."""
    return torch.addmm(base.reshape(-1), which, parts.flatten(1)).view(len(which), 3, base.shape[1])


def _links(tables: Tables, joints: Joints, local: Tensor) -> Tensor:
    """Rotation of every body but the root in its parent's axes, (links, 3 columns, 3, frames)."""
    whole = local if tables.all_turn else _padded(local)
    links = whole.index_select(0, tables.last)
    if len(tables.remaining):
        k = tables.remaining
        links[k] = compose(links.index_select(0, k), joints.remainder[..., None])
    return links


def _padded(local: Tensor) -> Tensor:
    """The turns' rotations with the identity behind them."""
    identity = torch.eye(3, dtype=local.dtype, device=local.device)[None, :, :, None]
    return torch.cat([local, identity.expand(-1, -1, -1, local.shape[3])])
