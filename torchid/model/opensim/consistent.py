"""Inertia that a distribution of mass can have, nearest to what a file states.

Second moments of mass about the centre, S = tr(I)/2 - I, are those of a body exactly when no eigenvalue is negative,
which for principal moments of inertia is the triangle inequality. The nearest such matrix in the Frobenius norm has
the same axes and its negative eigenvalues cut off.

Cited. Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018 (consistency); Higham, Linear Algebra Appl 103:103 (1988) (nearest).
"""

from dataclasses import replace

import torch

from torchid.errors import Note
from torchid.model.opensim.model import Inertias
from torchid.model.tree_of_links import LEAST_EXTENT

ROUNDED = 1e-12
"""Resolution. Share of the second moments by which an eigenvalue of zero is missed in double precision."""


def consistent(stated: Inertias, names: tuple[str, ...], source: str) -> tuple[Inertias, tuple[Note, ...]]:
    """Return the nearest inertia that is physically consistent, and what was changed.

    A body with mass keeps an extent of ``LEAST_EXTENT`` along every axis, so that its pseudo-inertia has an inverse.

    Args:
        stated: inertia as the file states it.
        names: names of the bodies.
        source: the file.
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
