"""Couplers of OpenSim files: constraints that make a coordinate a function of others."""

from collections.abc import Sequence

from torchid.model.markup import Element
from torchid.model.opensim.constraints import COUPLER, enforced
from torchid.model.opensim.function_elements import function_in
from torchid.model.opensim.functions import ScaledFunction
from torchid.model.opensim.model import Coupler
from torchid.model.opensim.words import OsimDocument, child_text


def read_couplers(names: Sequence[str], document: OsimDocument) -> tuple[Coupler, ...]:
    """Return the couplers that hold, each behind those that its leading coordinates need.

    Raises:
        InputError: ``osim.coupler`` for a coupler that has not what it needs, couples two ways or in a circle.
    """
    found: dict[int, tuple[Coupler, Element]] = {}
    for element in enforced(document):
        if element.tag != COUPLER:
            continue
        coupler = _coupler(element, names, document)
        if coupler.dependent in found:
            raise _coupler_fault(element, document, "its coordinate follows in two ways", names[coupler.dependent])
        found[coupler.dependent] = coupler, element
    return _ordered(found, document)


def _coupler(element: Element, names: Sequence[str], document: OsimDocument) -> Coupler:
    """Return a coupler.

    As in OpenSim, a function of n arguments is given the first n of the coordinates that lead and, behind them, the one
    that follows; the next one is its value. This is the one that follows where all others are arguments.
    """
    named = child_text(element, "independent_coordinate_names").split()
    named.append(child_text(element, "dependent_coordinate_name"))
    unknown = [name for name in named if name not in names]
    if unknown:
        raise _coupler_fault(element, document, "couples coordinates that are not there", ", ".join(unknown))
    function = function_in(element, document, "coupled_coordinates_function")
    if function is None or function.n_arguments >= len(named):
        count = "none" if function is None else f"one of {function.n_arguments}"
        raise _coupler_fault(element, document, f"needs a function of {len(named) - 1} coordinate(s)", count)
    scaled = ScaledFunction(function, document.number(element, "scale_factor", 1.0))
    *leading, following = [names.index(name) for name in named[: function.n_arguments + 1]]
    return Coupler(document.name(element), following, tuple(leading), scaled)


def _ordered(found: dict[int, tuple[Coupler, Element]], document: OsimDocument) -> tuple[Coupler, ...]:
    order: list[Coupler] = []
    waiting = dict(found)
    while waiting:
        free = [row for row, (coupler, _) in waiting.items() if not waiting.keys() & set(coupler.independents)]
        if not free:
            element = next(iter(waiting.values()))[1]
            raise _coupler_fault(element, document, "couplers lead each other in a circle")
        order += [waiting.pop(row)[0] for row in free]
    return tuple(order)


def _coupler_fault(element: Element, document: OsimDocument, message: str, found: str = "") -> Exception:
    remedy = "Let one coordinate of the model be a function of others."
    return document.fault(element, "osim.coupler", message, found, remedy=remedy)
