"""Constraints of an OpenSim file: which hold, and between which frames of which bodies."""

from collections.abc import Iterator

from torchid.model.markup import Element
from torchid.model.opensim.frames import Frames, component_path
from torchid.model.opensim.joints import JointElement
from torchid.model.opensim.model import OsimJoint
from torchid.model.opensim.words import OsimDocument, child_text

COUPLER, WELD = "CoordinateCouplerConstraint", "WeldConstraint"
_POINTS = (("socket_body_1", "body_1"), ("socket_body_2", "body_2"))
ENDS = {
    WELD: (("socket_frame1", "body_1"), ("socket_frame2", "body_2")),
    "PointConstraint": _POINTS,
    "ConstantDistanceConstraint": _POINTS,
    "PointOnLineConstraint": (("socket_line_body", "line_body"), ("socket_follower_body", "follower_body")),
    "RollingOnSurfaceConstraint": (("socket_rolling_body", "rolling_body"), ("socket_surface_body", "surface_body")),
}
"""Cited. Elements that name the two frames of a constraint, in OpenSim 4 and before (``updateFromXMLNode`` of OpenSim's
constraints)."""
OLD_OFFSETS = (("location_body_1", "orientation_body_1"), ("location_body_2", "orientation_body_2"))
"""Cited. Offsets of a weld's frames from its bodies before OpenSim 4, likewise."""
_ANY = "isEnforced isDisabled components"
_OWN = {
    WELD: f"frames {' '.join(tag for pair in OLD_OFFSETS for tag in pair)}",
    "PointConstraint": "location_body_1 location_body_2",
    "ConstantDistanceConstraint": "location_body_1 location_body_2 constant_distance",
    "PointOnLineConstraint": "line_direction_vec point_on_line point_on_follower",
    "RollingOnSurfaceConstraint": "surface_normal surface_height friction_coefficient contact_radius",
}
PROPERTIES = {
    COUPLER: f"{_ANY} coupled_coordinates_function scale_factor independent_coordinate_names dependent_coordinate_name",
    **{kind: " ".join([_ANY, _OWN[kind], *(tag for pair in ends for tag in pair)]) for kind, ends in ENDS.items()},
}
"""Cited. What may stand in the elements of constraints, in the words of any version."""
HOLDERS = ("ConstraintSet", "ComponentSet", "components", "objects")
"""Wording. Elements of a model that hold its constraints: their own set, and those of components of any kind."""


def constraint_elements(document: OsimDocument) -> list[Element]:
    """Return the constraints of a model, also those that are switched off."""
    return list(_within(document.model, False))


def _within(holder: Element, of_constraints: bool) -> Iterator[Element]:
    for element in holder:
        tag = str(element.tag)
        if tag in HOLDERS:
            yield from _within(element, of_constraints or tag == "ConstraintSet")
        elif holder.tag in HOLDERS[2:] and (of_constraints or tag.endswith("Constraint")):
            yield element


def enforced(document: OsimDocument) -> list[Element]:
    """Return the constraints that hold.

    Raises:
        InputError: ``osim.flag``.
    """
    return [one for one in constraint_elements(document) if not _is_off(one, document)]


def _is_off(element: Element, document: OsimDocument) -> bool:
    """Whether a constraint is switched off; OpenSim 4 passes over the older word in files of its own version."""
    off = not document.flag(element, "isEnforced", True)
    return off if document.sets_of_joints else document.flag(element, "isDisabled", off)


def links(document: OsimDocument, frames: Frames) -> list[JointElement]:
    """Return the constraints that hold two bodies, with their frames.

    Raises:
        InputError: ``osim.constraint`` for a kind that OpenSim does not have, ``osim.frame``.
    """
    found: dict[str, JointElement] = {}
    for element in enforced(document):
        if element.tag != COUPLER:
            name = component_path(element, document)
            name = name if name not in found else f"{name}_{len(found)}"
            found[name] = _link(element, name, document, frames)
    return list(found.values())


def _link(element: Element, name: str, document: OsimDocument, frames: Frames) -> JointElement:
    kind = str(element.tag)
    if kind not in ENDS:
        remedy = f"Known: {COUPLER}, {', '.join(ENDS)}. Remove it, or switch it off with isEnforced."
        raise document.fault(element, "osim.constraint", "a constraint that cannot be read", kind, remedy=remedy)
    word = 0 if document.sets_of_joints else 1
    first, second = (frames.named(child_text(element, tags[word]), element) for tags in ENDS[kind])
    if kind == WELD and not document.sets_of_joints:
        first, second = (
            frames.offset(one.frame, element, tags) for one, tags in zip((first, second), OLD_OFFSETS, strict=True)
        )
    return JointElement(element, first, second, name)


def weld_of(link: JointElement) -> OsimJoint:
    """Return the joint that a weld is."""
    return OsimJoint(link.name, WELD, link.parent.frame, link.child.frame, (), (), ())
