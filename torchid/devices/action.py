"""Lines of action: length or angle of an element at every pose, and what one unit of its force does to the body.

For a path the length is l = sum of the distances between its points, and a unit of tension pulls every point towards
its neighbours. These forces on segments have the generalised force S' W = -dl/dq (virtual work; S the joints' axes of
the recursion), so that J = dl/dq costs no differentiation. About an axis fixed in the first segment the angle is the
twist of the second segment's rotation about it (swing-twist decomposition; Dobrowolski, arXiv:1506.05481, 2015), and
the torques are +-1 along it. A coordinate's angle is the coordinate.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.devices.device import WORLD, Axis, Coordinate, Device, Element, Handle, Path, SegmentPoint
from torchid.dynamics.equations_of_motion import DynamicState, generalised_forces
from torchid.errors import ConfigError
from torchid.model.tree import Tree

SHORT = 1e-12
"""Distance of two points of a path from which on their direction is not asked for; derived: rounding at a metre [m]."""


@dataclass(frozen=True)
class ElementAction:
    """Where an element is at some frames, and what a unit of its force or torque does."""

    length: Float[Tensor, " frames"]
    """Length [m] or angle [rad]."""
    jacobian: Float[Tensor, "dofs frames"]
    """Derivative of the length or angle with respect to the coordinates, rates of the base as in ``Motion.v``."""
    unit: Float[Tensor, "dofs frames"]
    """Generalised force of a unit of its force, inner or from the ground."""
    ground: dict[str, Float[Tensor, "6 frames"]]
    """Wrench on segments about the world's origin for a unit of its force, where an end is in W; else empty."""

    def rate(self, v: Float[Tensor, "dofs frames"]) -> Float[Tensor, " frames"]:
        """Return how fast length or angle changes [m/s, rad/s]."""
        return (self.jacobian * v).sum(0)


def segment_index(tree: Tree, name: str, element: str) -> int:
    """Return the index of a segment that an element is on.

    Raises:
        ConfigError: ``device.segment`` where the model has none of that name.
    """
    if name not in tree.names:
        raise ConfigError(
            "device.segment", "the model has no such segment", place=element, found=name,
            remedy=f"Known: {', '.join(tree.names)}",
        )  # fmt: skip
    return tree.index(name)


def action(element: Element, state: DynamicState, q: Float[Tensor, "dofs frames"]) -> ElementAction:
    """Return what an element does at the poses of a state.

    Args:
        element: with a coordinate, an axis or a path; supports with recorded forces have no length.

    Raises:
        ConfigError: ``device.segment`` or ``device.coordinate`` where the model has no such thing.
    """
    line = element.line
    assert not isinstance(line, Handle), "a recorded support has no line of its own"
    if isinstance(line, Coordinate):
        return _on_coordinate(line, element, state, q)
    if isinstance(line, Axis):
        return _about_axis(line, element, state)
    return _along_path(line, element, state)


def coordinate_row(tree: Tree, name: str, element: str) -> int:
    """Return the row of a coordinate.

    Raises:
        ConfigError: ``device.coordinate`` where the model has none of that name.
    """
    if name not in tree.dof_names:
        raise ConfigError(
            "device.coordinate", "the model has no such coordinate", place=element, found=name,
            remedy=f"Known: {', '.join(tree.dof_names[6:])}",
        )  # fmt: skip
    return tree.dof_names.index(name)


def refuse_foreign(device: Device, tree: Tree) -> None:
    """Raise ConfigError where a device is on segments or coordinates that a model does not have.

    Args:
        device: as its sheet says it.

    Raises:
        ConfigError: ``device.segment`` or ``device.coordinate``.
    """
    for part in device.parts:
        segment_index(tree, part.segment, part.name)
    for element in device.elements:
        line = element.line
        points = line.points if isinstance(line, Path) else (line.point,) if isinstance(line, Handle) else ()
        for name in (*element.between, *(point.segment for point in points)):
            if name != WORLD:
                segment_index(tree, name, element.name)
        if isinstance(line, Coordinate):
            coordinate_row(tree, line.name, element.name)


def _on_coordinate(line: Coordinate, element: Element, state: DynamicState, q: Tensor) -> ElementAction:
    row = coordinate_row(state.plan.tree, line.name, element.name)
    value = q[row]
    one = torch.zeros(len(state.plan.tree.dofs), len(value), dtype=value.dtype, device=value.device)
    one[row] = 1.0
    return ElementAction(value, one, one, {})


def _about_axis(line: Axis, element: Element, state: DynamicState) -> ElementAction:
    first, second = (_place(state, name, element.name) for name in element.between)
    axis = state.at.R.new_tensor(line.direction)
    a_W = torch.einsum("cif,c->if", state.at.R[first], axis)
    R_AB = torch.einsum("aif,bif->abf", state.at.R[first], state.at.R[second])
    unit = torch.zeros(len(state.plan.order), 6, a_W.shape[1], dtype=a_W.dtype, device=a_W.device)
    unit[second, 3:] += a_W
    unit[first, 3:] -= a_W
    work = generalised_forces(state, unit)
    return ElementAction(_twist(R_AB, axis), work, work, {})


def _twist(R: Float[Tensor, "3 3 frames"], axis: Float[Tensor, " 3"]) -> Float[Tensor, " frames"]:
    """Twist of rotations about an axis, continuous over frames: 2 atan2(v . a, s) of the quaternion (s, v)."""
    curl = torch.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    along = torch.einsum("i,ijf,j->f", axis, R, axis)
    # 4 s v . a and 4 s^2 and 4 (v . a)^2, without a quaternion's choice of sign
    sine, cosine, square = axis @ curl, 1.0 + trace, 1.0 + 2.0 * along - trace
    angle = torch.atan2(2.0 * sine, cosine - square)
    step = torch.diff(angle, prepend=angle[:1])
    turns = torch.cumsum(torch.round(step / (2.0 * torch.pi)), 0)
    return angle - 2.0 * torch.pi * turns


def _place(state: DynamicState, segment: str, element: str) -> int:
    return state.plan.position[segment_index(state.plan.tree, segment, element)]


def point_in_world(point: SegmentPoint, state: DynamicState, element: str) -> Float[Tensor, "3 frames"]:
    """Return where a point is in W [m].

    Args:
        state: poses.

    Raises:
        ConfigError: ``device.marker`` where it is a marker's that nobody placed, or ``device.segment``.
    """
    if point.place is None:
        raise ConfigError(
            "device.marker", "the place of a marker that it holds to is not known", place=element, found=point.marker,
            remedy="Place the device's markers first (torchid.devices.placed)",
        )  # fmt: skip
    place = state.at.p.new_tensor(point.place)
    if point.segment == WORLD:
        return place[:, None].expand(3, state.at.p.shape[2])
    k = _place(state, point.segment, element)
    return state.at.p[k] + torch.einsum("cif,c->if", state.at.R[k], place)


def _along_path(line: Path, element: Element, state: DynamicState) -> ElementAction:
    p = [point_in_world(point, state, element.name) for point in line.points]
    if line.rail is not None:
        p = _on_rail(p, line, p[0].new_tensor(line.rail))
    pull = [torch.zeros_like(p[0]) for _ in p]
    length = torch.zeros_like(p[0][0])
    for k in range(len(p) - 1):
        way = p[k + 1] - p[k]
        distance = torch.linalg.vector_norm(way, dim=0)
        length = length + distance
        way = way / distance.clamp_min(SHORT)
        pull[k], pull[k + 1] = pull[k] + way, pull[k + 1] - way
    unit = torch.zeros(len(state.plan.order), 6, len(length), dtype=length.dtype, device=length.device)
    ground: dict[str, Tensor] = {}
    for point, at, force in zip(line.points, p, pull, strict=True):
        if point.segment != WORLD:
            k = _place(state, point.segment, element.name)
            unit[k] += torch.cat([force, torch.linalg.cross(at - state.at.p[0], force, dim=0)])
            wrench = torch.cat([force, torch.linalg.cross(at, force, dim=0)])
            ground[point.segment] = ground.get(point.segment, 0.0) + wrench
    work = generalised_forces(state, unit)
    return ElementAction(length, -work, work, ground if element.grounded else {})


def _on_rail(p: list[Tensor], line: Path, rail: Float[Tensor, " 3"]) -> list[Tensor]:
    """Let every point in W that ends the path follow its neighbour along the rail."""
    moved = list(p)
    for k, beside in ((0, 1), (len(p) - 1, len(p) - 2)):
        if line.points[k].segment == WORLD:
            moved[k] = p[k] + rail[:, None] * (rail @ (p[beside] - p[k]))
    return moved
