"""Joints of OpenSim files, of every kind that is read, as turns and slides driven by functions of coordinates.

Cited. Axes and order of the kinds: OpenSim's Joint classes and the mobilizers of Simbody behind them (Seth, Sherman,
Eastman, Delp, Nonlinear Dynamics 62:291 (2010)). A turn of a mobilizer is about the axes that the turns before it have
reached, a slide along the axes of the parent's frame.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from torchid.model.markup import Element
from torchid.model.opensim.coordinates import coordinate_elements, joint_coordinates, motion_of
from torchid.model.opensim.frames import Frames, Stated
from torchid.model.opensim.function_elements import function_in
from torchid.model.opensim.functions import Constant, Function, LinearFunction, ScaledFunction
from torchid.model.opensim.model import OsimCoordinate, OsimJoint, TransformAxis
from torchid.model.opensim.on_ellipsoid import OnEllipsoid
from torchid.model.opensim.words import OsimDocument, child_text, objects

KINDS: Mapping[str, tuple[str, str]] = {
    "WeldJoint": ("", ""),
    "PinJoint": ("z", ""),
    "SliderJoint": ("", "x"),
    "UniversalJoint": ("xy", ""),
    "BallJoint": ("xyz", ""),
    "GimbalJoint": ("xyz", ""),
    "PlanarJoint": ("z", "xy"),
    "FreeJoint": ("xyz", "xyz"),
}
"""Turns and slides of the joints whose coordinates are their turns, then their slides."""
ELLIPSOID, SCAPULOTHORACIC = "EllipsoidJoint", "ScapulothoracicJoint"
"""Wording. Joints whose child touches an ellipsoid of the parent by its origin, its Z axis along the normal there."""
PLACES = ("rotation1", "rotation2", "rotation3", "translation1", "translation2", "translation3")
"""Wording. Names of a custom joint's axes: three turns, three slides."""


@dataclass(frozen=True)
class JointElement:
    """A joint's element, or a constraint's, and the frames that it stands between."""

    element: Element
    parent: Stated
    child: Stated
    name: str


def joint_elements(document: OsimDocument, frames: Frames, bodies: Mapping[str, Element]) -> list[JointElement]:
    """Return the joints of the file in its order: OpenSim 4 has a set of them, older files one in every body.

    Raises:
        InputError: ``osim.frame`` for a frame that is not there.
    """
    if document.sets_of_joints:
        stated = objects(document.model, "JointSet")
        parents, children = (
            [frames.named(child_text(one, f"socket_{side}_frame"), one) for one in stated]
            for side in ("parent", "child")
        )
        names = [document.name(one) for one in stated]
        return [JointElement(*one) for one in zip(stated, parents, children, names, strict=True)]
    return [
        _in_body(joint, name, document, frames)
        for name, body in bodies.items()
        for holder in body.findall("Joint")
        for joint in holder
    ]


def _in_body(joint: Element, body: str, document: OsimDocument, frames: Frames) -> JointElement:
    """Return a joint of an older file, which stands in the body that it moves."""
    parent = frames.named(child_text(joint, "parent_body"), joint).frame
    parent = frames.offset(parent, joint, ("location_in_parent", "orientation_in_parent"))
    child = frames.offset(frames.named(body, joint).frame, joint, ("location", "orientation"))
    reverse = document.flag(joint, "reverse", False)
    ends = (child, parent) if reverse else (parent, child)
    return JointElement(joint, *ends, document.name(joint))


def read_joint(stated: JointElement, first: int, document: OsimDocument) -> tuple[OsimJoint, list[OsimCoordinate]]:
    """Return a joint and its coordinates.

    Args:
        stated: the joint's element and frames.
        first: row of the joint's first coordinate.

    Raises:
        InputError: ``osim.joint`` for an unknown kind or a number of coordinates that the kind does not have,
            ``osim.function``, ``osim.coordinate``.
    """
    element, kind = stated.element, str(stated.element.tag)
    if kind == "CustomJoint":
        turns, slides, names = _custom(element, first, document)
    elif kind in KINDS:
        turns, slides, names = _plain(element, first, document)
    elif kind in (ELLIPSOID, SCAPULOTHORACIC):
        turns, slides, names = _on_ellipsoid(element, first, document)
    else:
        known = ", ".join(("CustomJoint", *KINDS, ELLIPSOID, SCAPULOTHORACIC))
        remedy = f"Known: {known}. Put one of these there, such as a CustomJoint of functions."
        raise document.fault(element, "osim.joint", "a joint of a kind that is not read", kind, remedy=remedy)
    motions = [motion_of(first + k, turns, slides) for k in range(len(names))]
    coordinates = joint_coordinates(element, names, motions, document)
    joint = OsimJoint(
        name=stated.name,
        kind=kind,
        parent=stated.parent.frame,
        child=stated.child.frame,
        turns=_moving(turns),
        slides=_moving(slides),
        rows=tuple(range(first, first + len(names))),
    )
    return joint, coordinates


_Axes = tuple[list[TransformAxis], list[TransformAxis], list[str]]
"""Turns, slides and the names of the coordinates in the order of their rows."""


def _plain(element: Element, first: int, document: OsimDocument) -> _Axes:
    turns, slides = KINDS[str(element.tag)]
    names = _names(element, len(turns) + len(slides), document)
    axes = [_alone(_unit(axis), first + k) for k, axis in enumerate(turns + slides)]
    return axes[: len(turns)], axes[len(turns) :], names


def _names(element: Element, count: int, document: OsimDocument) -> list[str]:
    """Return the names of the coordinates of a joint that has so many."""
    names = [document.name(one) for one in coordinate_elements(element)]
    if document.sets_of_joints and element.find("coordinates") is None:
        names = [f"{_prefix_of_left_out(element, document)}_coord_{k}" for k in range(count)]
    if len(names) != count:
        remedy = "State one coordinate for every turn and slide, or save the model again with OpenSim."
        found = f"{len(names)} instead of {count}"
        raise document.fault(element, "osim.joint", "not as many coordinates as this joint has", found, remedy=remedy)
    return names


def _alone(unit: torch.Tensor, row: int) -> TransformAxis:
    """Return the axis that a coordinate moves by its own value."""
    return TransformAxis(unit, (row,), LinearFunction(torch.ones(1, dtype=torch.float64), 0.0))


def _on_ellipsoid(element: Element, first: int, document: OsimDocument) -> _Axes:
    """Return the axes of a joint on an ellipsoid.

    An EllipsoidJoint turns about X, Y, Z. A ScapulothoracicJoint turns about Y (abduction), -X (elevation) and Z
    (upward rotation), in the parent frame's axes, and then about an axis in the shoulder blade's plane (winging): in
    OpenSim's ScapulothoracicJoint.cpp the ellipsoid stands turned by 90 degrees about Z (Seth et al., PLoS ONE
    11:e0141028, 2016).
    """
    scapula = element.tag == SCAPULOTHORACIC
    radii = document.vector(element, "thoracic_ellipsoid_radii_x_y_z" if scapula else "radii_x_y_z", [0.0] * 3)
    if not bool((radii > 0.0).all()):
        found = ", ".join(f"{radius:g}" for radius in radii.tolist())
        raise document.fault(element, "osim.joint", "its ellipsoid needs radii above zero", found, remedy="State them.")
    units, centre = [_unit(axis) for axis in "xyz"], torch.zeros(3, dtype=torch.float64)
    if scapula:
        angle = document.number(element, "scapula_winging_axis_direction", 0.0)
        winging = torch.tensor([-math.sin(angle), math.cos(angle), 0.0], dtype=torch.float64)
        units = [_unit("y"), -_unit("x"), _unit("z"), winging]
        centre[:2] = document.vector(element, "scapula_winging_axis_origin", [0.0, 0.0])
    names = _names(element, len(units), document)
    rows = tuple(range(first, first + len(units)))
    slides = [
        TransformAxis(_unit(axis), rows, OnEllipsoid(k, float(radii[k]), torch.stack(units), centre))
        for k, axis in enumerate("xyz")
    ]
    return [_alone(unit, row) for unit, row in zip(units, rows, strict=True)], slides, names


def _prefix_of_left_out(joint: Element, document: OsimDocument) -> str:
    """Return what stands before the names of coordinates that a file leaves out: nothing, as in OpenSim, or the joint's
    name where several joints lack theirs, to which OpenSim gives the same names."""
    parent, lacking = joint.getparent(), 0
    for one in () if parent is None else parent:
        moves = any(KINDS.get(str(one.tag), ())) or one.tag in (ELLIPSOID, SCAPULOTHORACIC)
        lacking += moves and one.find("coordinates") is None
    return document.name(joint) if lacking > 1 else ""


def _custom(element: Element, first: int, document: OsimDocument) -> _Axes:
    transform = element.find("SpatialTransform")
    if transform is None:
        remedy = "Save the model again with OpenSim 3 or newer."
        raise document.fault(element, "osim.joint", "needs a SpatialTransform", remedy=remedy)
    found = transform.findall("TransformAxis")
    stated = {one.get("name", ""): one for one in found}
    if len(stated) < len(found) or not set(stated) <= set(PLACES):
        remedy = f"Name the axes {', '.join(PLACES)}, each once."
        raise document.fault(transform, "osim.axis", "its axes have other names", ", ".join(stated), remedy=remedy)
    used = [name for place in PLACES if place in stated for name in child_text(stated[place], "coordinates").split()]
    names = list(dict.fromkeys(used))
    axes = []
    for place, axis in zip(PLACES, "xyzxyz", strict=True):
        if place in stated:
            axes.append(_axis(stated[place], _unit(axis), {name: first + k for k, name in enumerate(names)}, document))
    count = sum(place in stated for place in PLACES[:3])
    return axes[:count], axes[count:], names


def _axis(element: Element, default: torch.Tensor, rows: Mapping[str, int], document: OsimDocument) -> TransformAxis:
    names = child_text(element, "coordinates").split()
    unit = document.vector(element, "axis", default.tolist())
    if not float(unit.norm()) > 0.0:
        raise document.fault(element, "osim.axis", "an axis of length zero", remedy="Give it a direction.")
    function = function_in(element, document)
    others = [one for one in element if one.tag not in ("coordinates", "axis", "function")]
    if function is None and others:
        remedy = 'Use one of the known functions, and name it "function".'
        raise document.fault(others[0], "osim.function", "no function of its axis", str(others[0].tag), remedy=remedy)
    function = function or Constant(0.0)  # OpenSim's default
    function = function if names else _without_argument(function)
    if function.n_arguments not in (0, len(names)):
        found = f"{len(names)} for {function.n_arguments} argument(s)"
        remedy = "Name one coordinate for every argument of the function."
        raise document.fault(element, "osim.axis", "as many coordinates as arguments are needed", found, remedy=remedy)
    return TransformAxis(unit / unit.norm(), tuple(rows[name] for name in names), function)


def _without_argument(function: Function) -> Function:
    """Return what OpenSim makes of a function of an axis that names no coordinate: of a straight line its first
    coefficient (``SimTK::Function::Linear``, which adds the coefficient behind as many as it has arguments)."""
    if isinstance(function, LinearFunction):
        return Constant(float(function.weights[0]))
    if isinstance(function, ScaledFunction):
        return ScaledFunction(_without_argument(function.function), function.scale)
    return function


def _moving(axes: list[TransformAxis]) -> tuple[TransformAxis, ...]:
    """Return the axes that do something; the others are zero at all coordinates."""
    return tuple(axis for axis in axes if not _zero(axis.function))


def _zero(function: Function) -> bool:
    if isinstance(function, ScaledFunction):
        return function.scale == 0.0 or _zero(function.function)
    return isinstance(function, Constant) and function.value == 0.0


def _unit(axis: str) -> torch.Tensor:
    return torch.eye(3, dtype=torch.float64)["xyz".index(axis)]
