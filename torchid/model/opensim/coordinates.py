"""Coordinates and couplers of OpenSim files."""

from collections.abc import Sequence

from torchid.model.markup import Element
from torchid.model.opensim.function_elements import function_in
from torchid.model.opensim.functions import LinearFunction, ScaledFunction
from torchid.model.opensim.model import CoordinateKind, Coupler, OsimCoordinate, TransformAxis
from torchid.model.opensim.words import OsimDocument, child_text, objects

RANGE = (-10.0, 10.0)
"""Cited. Range of a coordinate that states none (OpenSim, Coordinate::constructProperties)."""
COUPLER = "CoordinateCouplerConstraint"


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


def read_couplers(names: Sequence[str], document: OsimDocument) -> tuple[Coupler, ...]:
    """Return the couplers that hold, each behind those that its leading coordinate needs.

    Raises:
        InputError: ``osim.constraint`` for another constraint that holds, ``osim.coupler`` for a coupler that has not
            what it needs, couples two ways or in a circle.
    """
    found: dict[int, tuple[Coupler, Element]] = {}
    for element in objects(document.model, "ConstraintSet"):
        off = document.flag(element, "isDisabled", not document.flag(element, "isEnforced", True))
        if off:
            continue
        if element.tag != COUPLER:
            remedy = (
                f"Only {COUPLER} is read: remove it, or state what it does by joints; disabled ones are passed over."
            )
            message = "a constraint that cannot be read"
            raise document.fault(element, "osim.constraint", message, str(element.tag), remedy=remedy)
        coupler = _coupler(element, names, document)
        if coupler.dependent in found:
            raise _coupler_fault(element, document, "its coordinate follows two others", names[coupler.dependent])
        found[coupler.dependent] = coupler, element
    return _ordered(found, document)


def _coupler(element: Element, names: Sequence[str], document: OsimDocument) -> Coupler:
    leading = child_text(element, "independent_coordinate_names").split()
    following = child_text(element, "dependent_coordinate_name")
    unknown = [name for name in (*leading, following) if name not in names]
    if unknown or len(leading) != 1:
        found = ", ".join(unknown or leading)
        raise _coupler_fault(element, document, "needs one coordinate that leads and one that follows", found)
    function = function_in(element, document, "coupled_coordinates_function")
    if function is None or function.n_arguments > 1:
        raise _coupler_fault(element, document, "needs a function of one coordinate")
    scaled = ScaledFunction(function, document.number(element, "scale_factor", 1.0))
    return Coupler(document.name(element), names.index(following), names.index(leading[0]), scaled)


def _ordered(found: dict[int, tuple[Coupler, Element]], document: OsimDocument) -> tuple[Coupler, ...]:
    order: list[Coupler] = []
    waiting = dict(found)
    while waiting:
        free = [row for row, (coupler, _) in waiting.items() if coupler.independent not in waiting]
        if not free:
            element = next(iter(waiting.values()))[1]
            raise _coupler_fault(element, document, "couplers lead each other in a circle")
        order += [waiting.pop(row)[0] for row in free]
    return tuple(order)


def _coupler_fault(element: Element, document: OsimDocument, message: str, found: str = "") -> Exception:
    remedy = "Couple one coordinate of the model to one other."
    return document.fault(element, "osim.coupler", message, found, remedy=remedy)
