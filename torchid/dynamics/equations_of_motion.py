"""Equations of motion, linear in the inertial parameters: one tensor for base rows, joint rows and inverse dynamics.

For every body, A (6 x 10) maps its inertial parameters (about its origin, in its axes) to the wrench that its motion
needs, in W axes about a point that moves with the root body. Base rows are the A of all bodies side by side; joint
rows are the joints' axes against subtree sums. Moments about the laboratory's origin would multiply every plate error
by the walking distance.

Reference: Atkeson, An & Hollerbach, Int J Robotics Res 5(3), 1986; Ayusawa, Venture & Nakamura, IJRR 33(3), 2014.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.kinematics.plan import Plan, plan_tree
from torchid.kinematics.recursion import BodyMotion, Poses, body_motion, cross, poses
from torchid.kinematics.tables import Joints, make_joints
from torchid.model.model import Geometry
from torchid.model.rotation import compose
from torchid.model.tree import Tree


class BodyRows(NamedTuple):
    """A of all bodies, in W axes about the root's origin; bodies in plan order, frames last."""

    force: Float[Tensor, "bodies 4 3 frames"]
    """Only m and mc enter the force [N per parameter]."""
    moment: Float[Tensor, "bodies 10 3 frames"]


@dataclass(frozen=True)
class DynamicState:
    """Everything the equations of motion need about some frames."""

    plan: Plan
    at: Poses
    motion: BodyMotion


def dynamic_state(
    tree: Tree,
    geometry: Geometry,
    q: Float[Tensor, "dofs frames"],
    v: Float[Tensor, "dofs frames"],
    a: Float[Tensor, "dofs frames"],
) -> DynamicState:
    """Walk the tree for poses, velocities and accelerations."""
    plan = plan_tree(tree)
    return walk(plan, make_joints(plan, geometry), q, v, a)


def walk(
    plan: Plan,
    joints: Joints,
    q: Float[Tensor, "dofs frames"],
    v: Float[Tensor, "dofs frames"],
    a: Float[Tensor, "dofs frames"],
) -> DynamicState:
    """The same with the joints made beforehand: what is left are tensor operations that ``torch.compile`` fuses."""
    at = poses(plan, q, joints)
    return DynamicState(plan, at, body_motion(plan, at, v, a))


def body_rows(state: DynamicState, about: Float[Tensor, "3 frames"] | None = None) -> BodyRows:
    """A of every body at every frame, moments about a point, the root's origin if none is given."""
    lift = state.motion.a.new_tensor([0.0, 0.0, GRAVITY])[:, None]
    at, motion = state.at, state.motion
    arm = at.p - (at.p[0] if about is None else about)
    return inertial_columns(at.R, arm, motion.w, motion.alpha, motion.a + lift)


def inertial_columns(
    R: Float[Tensor, "bodies 3 3 frames"],
    p: Float[Tensor, "bodies 3 frames"],
    w: Float[Tensor, "bodies 3 frames"],
    alpha: Float[Tensor, "bodies 3 frames"],
    a: Float[Tensor, "bodies 3 frames"],
) -> BodyRows:
    """A from rotations (columns first), places, rates and accelerations minus gravity, in W axes."""
    force = torch.cat([a[:, None], compose(_spin_matrix(w, alpha), R)], dim=1)
    moment = cross(p[:, None], force)
    moment[:, 1:] += cross(R, a[:, None])
    inertia = compose(R, _inertia_columns(_in_body(R, w), _in_body(R, alpha)))
    return BodyRows(force, torch.cat([moment, inertia], dim=1))


def _in_body(R: Tensor, v: Tensor) -> Tensor:
    """R' v."""
    out = R[:, :, 0] * v[:, 0, None]
    out.addcmul_(R[:, :, 1], v[:, 1, None])
    return out.addcmul_(R[:, :, 2], v[:, 2, None])


def _spin_matrix(w: Tensor, alpha: Tensor) -> Tensor:
    """Columns of [alpha x] + [w x]^2."""
    x, y, z = w.unbind(1)
    ax, ay, az = alpha.unbind(1)
    (xx, yy, zz), (xy, yz, xz) = (w * w).unbind(1), (w * w.roll(-1, 1)).unbind(1)
    entries = [-yy - zz, xy + az, xz - ay, xy - az, -xx - zz, yz + ax, xz + ay, yz - ax, -xx - yy]
    return torch.stack(entries, dim=1).view(len(w), 3, 3, w.shape[2])


def _inertia_columns(w: Tensor, alpha: Tensor) -> Float[Tensor, "bodies 6 3 frames"]:
    """I alpha + w x I w for unit Ixx, Ixy, Iyy, Ixz, Iyz, Izz; all in body axes."""
    x, y, z = w.unbind(1)
    ax, ay, az = alpha.unbind(1)
    (xx, yy, zz), (xy, yz, xz) = (w * w).unbind(1), (w * w.roll(-1, 1)).unbind(1)
    entries = [
        ax, xz, -xy,
        ay - xz, ax + yz, xx - yy,
        -yz, ay, xy,
        az + xy, zz - xx, ax - yz,
        yy - zz, az - xy, ay + xz,
        yz, -xz, az,
    ]  # fmt: skip
    return torch.stack(entries, dim=1).view(len(w), 6, 3, w.shape[2])


def base_rows(plan: Plan, rows: BodyRows) -> Float[Tensor, "6 params frames"]:
    """Y_O: rows of the floating base; parameters of body 0 first, in tree order."""
    bodies, _, _, frames = rows.moment.shape
    Y, position = rows.moment.new_zeros(6, bodies, 10, frames), list(plan.position)
    Y[:3, :, :4] = rows.force[position].permute(2, 0, 1, 3)
    Y[3:] = rows.moment[position].permute(2, 0, 1, 3)
    return Y.reshape(6, 10 * bodies, frames)


def body_wrenches(plan: Plan, rows: BodyRows, phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 6 frames"]:
    """Wrench that each body's motion needs, about the root's origin; plan order."""
    ordered = phi[list(plan.order)]
    force = torch.einsum("bcit,bc->bit", rows.force, ordered[:, :4])
    moment = torch.einsum("bcit,bc->bit", rows.moment, ordered)
    return torch.cat([force, moment], dim=1)


def joint_axes(state: DynamicState) -> tuple[Float[Tensor, "axes 6 frames"], Tensor]:
    """Twist about the root's origin per unit rate of every axis value (of every dof, where the tree has no coupling),
    and the plan position of the body it carries."""
    plan, at = state.plan, state.at
    frames = at.p.shape[2]
    S = at.p.new_zeros(plan.tree.n_axes, 6, frames)
    S[range(6), range(6)] = 1.0
    position = plan.position
    body = torch.zeros(plan.tree.n_axes, dtype=torch.long, device=at.p.device)
    for columns, axes in ((plan.turns, at.turn_axis), (plan.slides, at.slide_axis)):
        if not columns:
            continue
        rows = [c.row for c in columns]
        body[rows] = torch.tensor([position[c.body] for c in columns], device=body.device)
        origin = (at.p - at.p[:1])[body[rows]]
        S[rows, :3] = axes if columns[0].slide else cross(origin, axes)
        if not columns[0].slide:
            S[rows, 3:] = axes
    return S, body


def generalised_forces(state: DynamicState, wrenches: Float[Tensor, "bodies 6 frames"]) -> Float[Tensor, "dofs frames"]:
    """S^T (subtree sums): what the actuators must supply for these body wrenches (needed minus external).

    Rows 0-5 are the residual force and moment at the root's origin, in W.
    """
    above = state.at.tables.above
    total = (above.mT @ wrenches.flatten(1)).view_as(wrenches)
    S, body = joint_axes(state)
    return state.plan.tree.fold(state.at.q, (S * total.index_select(0, body)).sum(1))


def inverse_dynamics(
    tree: Tree,
    geometry: Geometry,
    phi: Float[Tensor, "bodies 10"],
    q: Float[Tensor, "dofs frames"],
    v: Float[Tensor, "dofs frames"],
    a: Float[Tensor, "dofs frames"],
) -> Float[Tensor, "dofs frames"]:
    """Generalised forces of a motion without contact; base rows about the root's origin in W [N, N m]."""
    state = dynamic_state(tree, geometry, q, v, a)
    return generalised_forces(state, body_wrenches(state.plan, body_rows(state), phi))


def wrench_about(wrench: Float[Tensor, "*batch 6"], point: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 6"]:
    """A wrench about the world's origin, taken about ``point`` instead."""
    force, moment = wrench[..., :3], wrench[..., 3:]
    return torch.cat([force, moment - torch.linalg.cross(point.expand_as(force), force)], dim=-1)


def wrenches_about(
    wrench: Float[Tensor, "6 some frames"], point: Float[Tensor, "3 frames"]
) -> Float[Tensor, "6 some frames"]:
    """Several wrenches about the world's origin, frames last, taken about ``point`` instead."""
    found, force = wrench.clone(), wrench[:3]
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        found[3 + k].addcmul_(point[i], force[j], value=-1).addcmul_(point[j], force[i])
    return found
