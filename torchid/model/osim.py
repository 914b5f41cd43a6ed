"""OpenSim models out (XML of OpenSim 4): custom joints whose coordinates are ours, markers, inertia.

OpenSim's axes are X forward, Y up, Z right: every vector of W and of the bodies is written as (x, z, -y). Joint
coordinates keep name, value and sign. The base's rotation vector has no counterpart there: it becomes three angles,
``<root>_tilt`` about Z, ``<root>_list`` about X, ``<root>_rotation`` about Y, each about the axis reached so far (the
order of OpenSim's gait models); ``osim_coordinates`` converts a motion.
"""

import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.errors import DataError
from torchid.model.markup import Element, document, node, plain_name, spelt, write_xml
from torchid.model.mechanics import Array, MarkerTable, matrix_to_rpy, phi_to_centre, zero_pose
from torchid.model.model import Geometry
from torchid.model.opensim import rotations
from torchid.model.rotation import rotation_matrix
from torchid.model.tree import BASE_DOFS, Body, Dof, Tree

VERSION = "40000"
R_OW = rotations.R_OW.numpy()
"""Our axes in OpenSim's."""
BASE_ANGLES = ("tilt", "list", "rotation")
PARALLEL = 1e-6
"""Sine of the angle below which two axes are one."""

_Column = tuple[Array, Dof | None]
"""Axis and the coordinate that drives it."""


def osim_names(tree: Tree) -> tuple[str, ...]:
    """Names of the coordinates of the written model, in the order of q."""
    root = tree.names[0]
    return (*tree.dof_names[:3], *(f"{root}_{angle}" for angle in BASE_ANGLES), *tree.dof_names[BASE_DOFS:])


def osim_coordinates(q: Float[Tensor, "frames dofs"]) -> Float[Tensor, "frames dofs"]:
    """q as coordinates of the written model [m, rad]: rows 3-5 become tilt, list and rotation, without jumps."""
    like = q.new_tensor(R_OW)
    R = like @ rotation_matrix(q[:, 3:BASE_DOFS]) @ like.T
    tilt = (-R[:, 0, 1]).atan2(R[:, 1, 1])
    sideways = R[:, 2, 1].atan2(R[:, 2, 0].hypot(R[:, 2, 2]))
    turn = (-R[:, 2, 0]).atan2(R[:, 2, 2])
    angles = np.unwrap(np.stack([x.detach().cpu().numpy() for x in (tilt, sideways, turn)], axis=1), axis=0)
    out = q.detach().clone()
    out[:, 3:BASE_DOFS] = q.new_tensor(angles)
    return out


def osim_forces(q: Float[Tensor, "frames dofs"], torque: Float[Tensor, "frames dofs"]) -> Float[Tensor, "frames dofs"]:
    """Forces that do work on the written model's coordinates [N, N m]: the base's moment, along the axes of its angles.

    Args:
        q: coordinates of the model.
        torque: generalised forces; of the base, force and moment about its origin in W.
    """
    tilt, sideways = osim_coordinates(q)[:, 3:5].unbind(1)
    none, one = torch.zeros_like(tilt), torch.ones_like(tilt)
    axes = torch.stack([  # of tilt, list and rotation in OpenSim's axes, each about the axis reached so far
        torch.stack([none, none, one], dim=1),
        torch.stack([tilt.cos(), tilt.sin(), none], dim=1),
        torch.stack([-tilt.sin() * sideways.cos(), tilt.cos() * sideways.cos(), sideways.sin()], dim=1),
    ], dim=1)  # fmt: skip
    out = torque.detach().clone()
    out[:, 3:BASE_DOFS] = torch.einsum("fai,fi->fa", axes, torque[:, 3:BASE_DOFS] @ q.new_tensor(R_OW).T)
    return out


def write_osim(
    tree: Tree,
    geometry: Geometry,
    phi: Float[Tensor, "bodies 10"],
    path: str | Path,
    markers: MarkerTable | None = None,
    name: str = "torchid",
) -> None:
    """Write a model for OpenSim 4.

    Raises:
        DataError: a body has no positive mass, or a joint more than three turns or slides, or two about one line,
            which no joint of OpenSim has.
        InputError: the file cannot be written.
    """
    root = document("OpenSimDocument", Version=VERSION)
    model = node(root, "Model", name=plain_name(name))
    node(node(model, "Ground", name="ground"), "FrameGeometry", name="frame_geometry")
    node(model, "gravity", spelt([0.0, -GRAVITY, 0.0]))
    bodies = node(node(model, "BodySet", name="bodyset"), "objects")
    joints = node(node(model, "JointSet", name="jointset"), "objects")
    offset, hinge = geometry.offset.detach().cpu().double().numpy(), geometry.hinge.detach().tolist()
    for k, body in enumerate(tree.bodies):
        _write_body(bodies, body.name, phi[k].detach().cpu().double().numpy())
        if k:
            _write_joint(joints, tree, body, hinge, offset[k])
        else:
            _write_base(joints, tree)
    marks = node(node(model, "MarkerSet", name="markerset"), "objects")
    taken: set[str] = set()
    for label, (segment, p) in (markers or {}).items():
        taken.add(plain := plain_name(label, taken))
        mark = node(marks, "Marker", name=plain)
        node(mark, "socket_parent_frame", f"/bodyset/{segment}")
        node(mark, "location", spelt(R_OW @ np.asarray(p, dtype=np.float64)))
        node(mark, "fixed", "true")
    write_xml(path, root)


def _write_body(bodies: Element, name: str, phi: Array) -> None:
    mass, centre, inertia = phi_to_centre(phi, name)
    turned = R_OW @ inertia @ R_OW.T
    body = node(bodies, "Body", name=name)
    node(body, "mass", spelt([mass]))
    node(body, "mass_center", spelt(R_OW @ centre))
    node(body, "inertia", spelt(turned[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))))


def _write_base(joints: Element, tree: Tree) -> None:
    root, names, eye = tree.names[0], osim_names(tree), np.eye(3)
    slides: list[_Column] = [(R_OW[:, k], tree.dofs[k]) for k in range(3)]
    turns: list[_Column] = [(eye[axis], Dof(names[3 + k], "rad")) for k, axis in enumerate((2, 0, 1))]
    _write_custom(joints, f"ground_{root}", ("ground", "/ground"), root, np.zeros(3), np.eye(3), turns, slides)


def _write_joint(joints: Element, tree: Tree, body: Body, hinge: list[float], offset: Array) -> None:
    joint, parent = zero_pose(body, hinge), tree.names[body.parent]
    turns: list[_Column] = [(R_OW @ unit, tree.dofs[row]) for row, unit in joint.turns]
    slides: list[_Column] = [(R_OW @ unit, tree.dofs[row]) for row, unit in joint.slides]
    carrier, R = (parent, f"/bodyset/{parent}"), R_OW @ joint.R_PB @ R_OW.T
    _write_custom(joints, f"{body.name}_joint", carrier, body.name, R_OW @ offset, R, turns, slides)


def _write_custom(
    joints: Element,
    name: str,
    parent: tuple[str, str],
    child: str,
    p: Array,
    R: Array,
    turns: list[_Column],
    slides: list[_Column],
) -> None:
    """A custom joint behind a constant pose (p, R) in the parent; a weld where nothing moves."""
    moving = bool(turns or slides)
    joint = node(joints, "CustomJoint" if moving else "WeldJoint", name=name)
    node(joint, "socket_parent_frame", f"{parent[0]}_offset")
    node(joint, "socket_child_frame", f"/bodyset/{child}")
    if moving:
        coordinates = node(joint, "coordinates")
        for _, dof in [*turns, *slides]:
            _write_coordinate(coordinates, dof)
    frame = node(node(joint, "frames"), "PhysicalOffsetFrame", name=f"{parent[0]}_offset")
    node(frame, "socket_parent", parent[1])
    node(frame, "translation", spelt(p))
    node(frame, "orientation", spelt(-matrix_to_rpy(R.T)))  # body-fixed X-Y-Z: the inverse's roll, pitch, yaw, negated
    if moving:
        transform = node(joint, "SpatialTransform")
        for kind, columns in (("rotation", turns), ("translation", slides)):
            for k, (axis, dof) in enumerate(_three(columns, name), start=1):
                _write_axis(transform, f"{kind}{k}", axis, dof)


def _write_coordinate(coordinates: Element, dof: Dof | None) -> None:
    assert dof is not None
    element = node(coordinates, "Coordinate", name=dof.name)
    node(element, "default_value", spelt([dof.rest]))
    if math.isfinite(dof.lower) and math.isfinite(dof.upper):
        node(element, "range", spelt([dof.lower, dof.upper]))


def _write_axis(transform: Element, name: str, axis: Array, dof: Dof | None) -> None:
    element = node(transform, "TransformAxis", name=name)
    node(element, "coordinates", dof.name if dof else "")
    node(element, "axis", spelt(axis))
    if dof:
        node(node(element, "LinearFunction", name="function"), "coefficients", "1 0")
    else:
        node(node(element, "Constant", name="function"), "value", "0")


def _three(columns: list[_Column], name: str) -> list[_Column]:
    """The axes and, behind them, idle ones until there are three; no two about one line."""
    found = list(columns)
    for axis in np.eye(3):
        if len(found) < 3 and all(np.linalg.norm(np.cross(axis, other)) > 0.5 for other, _ in found):
            found.append((axis, None))
    lines = [axis for axis, _ in found]
    twice = any(
        np.linalg.norm(np.cross(a, b)) < PARALLEL for k, a in enumerate(lines) for b in lines[:k]
    )  # fmt: skip
    if len(found) != 3 or twice:
        message = "a joint with more than three turns or slides, or two about one line, has no form in OpenSim"
        raise DataError("osim.joint", message, place=name, remedy="Use the URDF, or split the joint by a link between")
    return found
