"""Coordinates of OpenSim files."""

from collections.abc import Sequence

from torchid.model.markup import Element
from torchid.model.opensim.functions import LinearFunction
from torchid.model.opensim.model import CoordinateKind, OsimCoordinate, TransformAxis
from torchid.model.opensim.words import OsimDocument

RANGE = (-10.0, 10.0)
"""Cited. Range of a coordinate that states none (OpenSim, Coordinate::constructProperties)."""


def coordinate_elements(joint: Element) -> list[Element]:
    """Return the elements of a joint's coordinates."""
    return [*joint.findall("coordinates/Coordinate"), *joint.findall("CoordinateSet/objects/Coordinate")]


def motion_of(row: int, turns: Sequence[TransformAxis], slides: Sequence[TransformAxis]) -> CoordinateKind:
    """Return the kind of a coordinate, decided as OpenSim does: by the last axis that it moves in proportion 1.

    Args:
        turns: turns of its joint.
        slides: slides of its joint.
    """
    motion = CoordinateKind.COUPLED
    for axes, kind in ((turns, CoordinateKind.ROTATIONAL), (slides, CoordinateKind.TRANSLATIONAL)):
        for axis in axes:
            straight = isinstance(axis.function, LinearFunction) and abs(float(axis.function.weights[0])) == 1.0
            motion = kind if row in axis.rows and straight else motion
    return motion


def joint_coordinates(
    joint: Element, names: Sequence[str], motions: Sequence[CoordinateKind], document: OsimDocument
) -> list[OsimCoordinate]:
    """Return the coordinates of a joint in the order of their rows.

    Args:
        names: names that its axes use.

    Raises:
        InputError: ``osim.twice`` for two of one name, ``osim.coordinate`` for one that no axis uses,
            ``osim.range`` for a range upside down.
    """
    elements = coordinate_elements(joint)
    stated = {document.name(one): one for one in elements}
    if len(stated) < len(elements):
        found = ", ".join(stated)
        remedy = "Rename one of them."
        raise document.fault(joint, "osim.twice", "two of its coordinates have one name", found, remedy=remedy)
    idle = sorted(set(stated) - set(names))
    if idle:
        remedy = "Let an axis of the joint name it, or remove it."
        raise document.fault(
            joint, "osim.coordinate", "a coordinate that moves nothing", ", ".join(idle), remedy=remedy
        )
    return [_coordinate(name, stated.get(name), kind, document) for name, kind in zip(names, motions, strict=True)]


def _coordinate(name: str, element: Element | None, motion: CoordinateKind, document: OsimDocument) -> OsimCoordinate:
    if element is None:
        return OsimCoordinate(name, motion, 0.0, *RANGE, clamped=False, locked=False, prescribed=False)
    lower, upper = document.vector(element, "range", RANGE).tolist()
    if lower > upper:
        found = f"{lower:g} > {upper:g}"
        raise document.fault(element, "osim.range", "the range is upside down", found, remedy="Exchange its ends.")
    return OsimCoordinate(
        name=name,
        motion=motion,
        default=document.number(element, "default_value", 0.0),
        lower=lower,
        upper=upper,
        clamped=document.flag(element, "clamped", False),
        locked=document.flag(element, "locked", False),
        prescribed=document.flag(element, "prescribed", False),
    )
