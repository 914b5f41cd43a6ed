"""Masses and inertia of OpenSim's bodies, and the elements that state them."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import Note
from torchid.model.markup import Element
from torchid.model.opensim.model import Inertias
from torchid.model.opensim.words import OsimDocument, child_text
from torchid.model.tree_of_links import LEAST_EXTENT

MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Cited. Order of OpenSim 4's ``inertia``; older files have an element each."""
SPELT = tuple(f"inertia_{'xyz'[i]}{'xyz'[j]}" for i, j in MOMENTS)
"""Wording. Elements of older files for the moments, in the same order."""


def read_inertias(bodies: Mapping[str, Element], document: OsimDocument) -> Inertias:
    """Return the bodies' inertia as it is stated; OpenSim's own defaults where it is not.

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
    """Return the moments of a body in the order of ``MOMENTS`` [kg m^2]."""
    if compact(element, document):
        return document.vector(element, "inertia", [0.0] * 6)
    return torch.tensor(
        [document.number(element, tag, float(k < 3)) for k, tag in enumerate(SPELT)], dtype=torch.float64
    )


def compact(element: Element, document: OsimDocument) -> bool:
    """Return True for a body that states its moments in one element."""
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


ROUNDED = 1e-12
"""Resolution. Share of the second moments by which an eigenvalue of zero is missed in double precision."""


def consistent(stated: Inertias, names: tuple[str, ...], source: str) -> tuple[Inertias, tuple[Note, ...]]:
    """Return the nearest inertia that is physically consistent, and what was changed.

    Second moments of mass about the centre, S = tr(I)/2 - I, are those of a body exactly when no eigenvalue is
    negative, which for principal moments of inertia is the triangle inequality (Wensing, Kim, Slotine, IEEE RA-L 3(1),
    2018). The nearest such matrix in the Frobenius norm has the same axes and its negative eigenvalues cut off (Higham,
    Linear Algebra Appl 103:103, 1988).
    A body with mass keeps an extent of ``LEAST_EXTENT`` along every axis, so that its pseudo-inertia has an inverse.
    """
    eye = torch.eye(3).to(stated.moments)
    trace = stated.moments.diagonal(dim1=-2, dim2=-1).sum(-1)
    values, axes = torch.linalg.eigh(0.5 * trace[:, None, None] * eye - stated.moments)
    least = (stated.mass * LEAST_EXTENT**2)[:, None]
    short = (values < least - ROUNDED * values.abs().sum(1, keepdim=True)).any(1)
    cut = values.clamp(min=least)
    second = (axes * cut[:, None]) @ axes.mT
    nearest = cut.sum(1)[:, None, None] * eye - second
    moments = torch.where(short[:, None, None], nearest, stated.moments)
    notes = tuple(
        Note("osim.inertia", _said(names[k], stated.moments[k], moments[k], bool(values[k, 0] < 0.0)), source)
        for k in short.nonzero().flatten().tolist()
    )
    return replace(stated, moments=moments), notes


def _said(name: str, stated: torch.Tensor, taken: torch.Tensor, impossible: bool) -> str:
    before, after = (
        ", ".join(f"{value:.3g}" for value in torch.linalg.eigvalsh(matrix).tolist()) for matrix in (stated, taken)
    )
    why = "no body has these principal moments" if impossible else f"thinner than {LEAST_EXTENT:g} m"
    return f"{name}: {why} ({before} kg m^2); the nearest that one can have are taken ({after} kg m^2)"
