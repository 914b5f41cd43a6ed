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
from torchid.model.model import Geometry
from torchid.model.tree import Tree

CHUNK = 512
"""Frames per batch; fixed, since sums of other sizes differ in the last digit."""


class BodyRows(NamedTuple):
    """A of all bodies, in W axes about the root's origin; bodies in plan order, frames last."""

    force: Float[Tensor, "3 4 bodies frames"]
    """Only m and mc enter the force [N per parameter]."""
    moment: Float[Tensor, "3 10 bodies frames"]


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
    at = poses(plan, q, geometry)
    return DynamicState(plan, at, body_motion(plan, at, v, a))


def body_rows(state: DynamicState) -> BodyRows:
    """A of every body at every frame."""
    lift = state.motion.a.new_tensor([0.0, 0.0, GRAVITY])[:, None]
    at, motion = state.at, state.motion
    X, Y, Z = at.R
    return inertial_columns(X, Y, Z, at.p - at.p[:1], motion.w, motion.alpha, motion.a + lift)


def inertial_columns(X: Tensor, Y: Tensor, Z: Tensor, p: Tensor, w: Tensor, alpha: Tensor, a: Tensor) -> BodyRows:
    """A from columns of R_WB, place, rates and acceleration minus gravity, each (bodies, 3, frames).

    Functional and without branches, so that ``torch.compile`` fuses it into one pass over memory.
    """
    R = [[column[:, k] for k in range(3)] for column in (X, Y, Z)]
    p_, w_, alpha_, a_ = ([x[:, k] for k in range(3)] for x in (p, w, alpha, a))
    S = _spin_matrix(w_, alpha_)
    force = [a_] + [[_dot(S[i], column) for i in range(3)] for column in R]
    moment = [_cross(p_, a_)]
    for column, pull in zip(R, force[1:], strict=True):
        arm, own = _cross(p_, pull), _cross(column, a_)
        moment.append([arm[i] + own[i] for i in range(3)])
    moment += _inertia_columns(R, w_, alpha_)
    return BodyRows(_stack(force), _stack(moment))


def _stack(columns: list[list[Tensor]]) -> Tensor:
    return torch.stack([torch.stack([column[i] for column in columns]) for i in range(3)])


def _dot(u: list[Tensor], v: list[Tensor]) -> Tensor:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(a: list[Tensor], b: list[Tensor]) -> list[Tensor]:
    return [a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3] for k in range(3)]


def _spin_matrix(w: list[Tensor], alpha: list[Tensor]) -> list[list[Tensor]]:
    """[alpha x] + [w x]^2, rows first."""
    xx, yy, zz = w[0] * w[0], w[1] * w[1], w[2] * w[2]
    xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
    return [
        [-yy - zz, xy - alpha[2], xz + alpha[1]],
        [xy + alpha[2], -xx - zz, yz - alpha[0]],
        [xz - alpha[1], yz + alpha[0], -xx - yy],
    ]


def _inertia_columns(R: list[list[Tensor]], w: list[Tensor], alpha: list[Tensor]) -> list[list[Tensor]]:
    """I alpha + w x I w for unit Ixx, Ixy, Iyy, Ixz, Iyz, Izz in body axes, turned into W."""
    x, y, z = (_dot(column, w) for column in R)
    ax, ay, az = (_dot(column, alpha) for column in R)
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    body = [
        [ax, xz, -xy],
        [ay - xz, ax + yz, xx - yy],
        [-yz, ay, xy],
        [az + xy, zz - xx, ax - yz],
        [yy - zz, az - xy, ay + xz],
        [yz, -xz, az],
    ]
    return [[R[0][i] * b[0] + R[1][i] * b[1] + R[2][i] * b[2] for i in range(3)] for b in body]


def base_rows(plan: Plan, rows: BodyRows) -> Float[Tensor, "6 params frames"]:
    """Y_O: rows of the floating base; parameters of body 0 first, in tree order."""
    frames, bodies = rows.force.shape[3], rows.force.shape[2]
    position = list(plan.position)
    Y = rows.force.new_zeros(6, bodies, 10, frames)
    Y[:3, :, :4] = rows.force[:, :, position].transpose(1, 2)
    Y[3:] = rows.moment[:, :, position].transpose(1, 2)
    return Y.reshape(6, 10 * bodies, frames)


def base_gram(
    plan: Plan, rows: BodyRows, wrench: Float[Tensor, "6 frames"]
) -> tuple[Float[Tensor, "params params"], Float[Tensor, " params"]]:
    """Y_O' Y_O and Y_O' F summed over the frames, without Y_O; the order of parameters of ``base_rows``.

    Six of ten columns of the force rows are zero: their product is left out (a third of the work).
    """
    bodies = rows.force.shape[2]
    gram, rhs = wrench.new_zeros(10, bodies, 10, bodies), wrench.new_zeros(10, bodies)
    for axis in range(3):
        for columns, side in ((rows.moment[axis], wrench[3 + axis]), (rows.force[axis], wrench[axis])):
            own, flat = columns.shape[0], columns.reshape(columns.shape[0] * bodies, -1)
            gram[:own, :, :own] += (flat @ flat.T).view(own, bodies, own, bodies)
            rhs[:own] += (flat @ side).view(own, bodies)
    position = list(plan.position)
    ordered = gram.permute(1, 0, 3, 2)[position][:, :, position]
    return ordered.reshape(10 * bodies, -1), rhs.T[position].reshape(-1)


def body_wrenches(plan: Plan, rows: BodyRows, phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 6 frames"]:
    """Wrench that each body's motion needs, about the root's origin; plan order."""
    ordered = phi[list(plan.order)]
    force = torch.einsum("icbt,bc->bit", rows.force, ordered[:, :4])
    moment = torch.einsum("icbt,bc->bit", rows.moment, ordered)
    return torch.cat([force, moment], dim=1)


def joint_axes(state: DynamicState) -> tuple[Float[Tensor, "dofs 6 frames"], Tensor]:
    """Twist about the root's origin per unit rate of every dof, and the plan position of the body it carries."""
    plan, at = state.plan, state.at
    frames = at.p.shape[2]
    S = at.p.new_zeros(len(plan.tree.dofs), 6, frames)
    S[range(6), range(6)] = 1.0
    position = plan.position
    body = torch.zeros(len(plan.tree.dofs), dtype=torch.long, device=at.p.device)
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
    plan = state.plan
    total = wrenches.clone()
    for level, above in zip(plan.levels[:0:-1], plan.levels[-2::-1], strict=True):
        parents = torch.tensor(level.parents, device=total.device) + above.start
        total.index_add_(0, parents, total[level.start : level.stop].clone())
    S, body = joint_axes(state)
    return (S * total.index_select(0, body)).sum(1)


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
