"""Masses and inertia of OpenSim's bodies, and the elements that state them."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.markup import Element
from torchid.model.opensim.model import Inertias
from torchid.model.opensim.words import OsimDocument, child_text

MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Cited. Order of OpenSim 4's ``inertia``; older files have an element each."""
SPELT = tuple(f"inertia_{'xyz'[i]}{'xyz'[j]}" for i, j in MOMENTS)
"""Wording. Elements of older files for the moments, in the same order."""


def read_inertias(bodies: Mapping[str, Element], document: OsimDocument) -> Inertias:
    """Return the bodies' inertia as it is stated; OpenSim's own defaults where it is not.

    Args:
        bodies: bodies by name.
        document: the file.

    Raises:
        InputError: ``xml.number``, ``osim.mass`` for a mass that is negative or missing.
    """
    mass, centre, moments = [], [], []
    for element in bodies.values():
        mass.append(document.number(element, "mass", -1.0))
        if mass[-1] < 0.0:
            found = child_text(element, "mass") or "none"
            raise document.fault(element, "osim.mass", "needs a mass of zero or more", found, remedy="Correct it.")
        centre.append(document.vector(element, "mass_center", [0.0] * 3))
        moments.append(matrix(stated_moments(element, document)))
    none = torch.zeros(0, 3, 3, dtype=torch.float64)
    return Inertias(
        torch.tensor(mass, dtype=torch.float64),
        torch.stack(centre) if centre else none[..., 0],
        torch.stack(moments) if moments else none,
    )


def stated_moments(element: Element, document: OsimDocument) -> Float[Tensor, "6"]:
    """Return the moments of a body in the order of ``MOMENTS`` [kg m^2].

    Args:
        element: the body's element.
        document: the file.
    """
    if compact(element, document):
        return document.vector(element, "inertia", [0.0] * 6)
    return torch.tensor(
        [document.number(element, tag, float(k < 3)) for k, tag in enumerate(SPELT)], dtype=torch.float64
    )


def compact(element: Element, document: OsimDocument) -> bool:
    """Return True for a body that states its moments in one element.

    Args:
        element: the body's element.
        document: the file.
    """
    if element.find("inertia") is not None:
        return True
    return document.sets_of_joints and not any(element.find(tag) is not None for tag in SPELT)


def matrix(moments: Float[Tensor, "6"]) -> Float[Tensor, "3 3"]:
    """Return the symmetric matrix of six moments.

    Args:
        moments: in the order of ``MOMENTS``.
    """
    out = moments.new_zeros(3, 3)
    for value, (i, j) in zip(moments, MOMENTS, strict=True):
        out[i, j] = out[j, i] = value
    return out
