"""Inertia of bodies that are welded together: of all of them in one frame, and back to each of them.

All of it is done on pseudo-inertias, which move by congruence and add (Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018).
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import Inertial
from torchid.model.opensim.binding import OsimBinding
from torchid.model.opensim.model import Inertias
from torchid.model.opensim.rotations import inverse
from torchid.model.pseudo import params_to_pseudo, pseudo_to_params


def of_groups(binding: OsimBinding, phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "groups 10"]:
    """Return the parameters of the tree's bodies, about their origins, in their axes.

    Args:
        phi: parameters of the file's bodies, likewise in their own frames.
    """
    P = binding.X_TB @ params_to_pseudo(phi) @ binding.X_TB.mT
    return pseudo_to_params(torch.stack([P[list(members)].sum(0) for members in binding.groups]))


def of_bodies(binding: OsimBinding, phi: Float[Tensor, "groups 10"]) -> Inertias:
    """Return mass, centre and inertia of the file's bodies whose groups have these parameters.

    With P = U U' of a group before and now (U upper triangular), A = U_now U_before^-1 is an affine map: its last row
    moves no place into mass. A P_k A' of the group's bodies are pseudo-inertias again, and add up to the group's new
    one: all of its mass is moved and stretched alike. Bodies in no group stay as they are.
    """
    P = binding.X_TB @ params_to_pseudo(binding.model.inertias.phi) @ binding.X_TB.mT
    new = torch.zeros_like(P)
    for wanted, members in zip(params_to_pseudo(phi), binding.groups, strict=True):
        rows = list(members)
        before, massless = _upper(P[rows].sum(0))
        if massless or len(rows) == 1:
            new[rows[0]] = wanted  # what has no mass cannot be stretched
        else:
            A = _upper(wanted)[0] @ torch.linalg.inv(before)
            new[rows] = A @ P[rows] @ A.mT
    X_BT = inverse(binding.X_TB)
    found, old = _centred(pseudo_to_params(X_BT @ new @ X_BT.mT)), binding.model.inertias
    ours = torch.tensor([body in binding.bodies for body in range(len(new))], device=phi.device)
    return Inertias(
        torch.where(ours, found.mass, old.mass),
        torch.where(ours[:, None], found.centre, old.centre),
        torch.where(ours[:, None, None], found.moments, old.moments),
    )


def _upper(P: Float[Tensor, "4 4"]) -> tuple[Float[Tensor, "4 4"], bool]:
    """U of P = U U', and whether P has none because it is singular."""
    L, info = torch.linalg.cholesky_ex(P.flip(0, 1))
    return L.flip(0, 1), bool(info)


def _centred(phi: Float[Tensor, "bodies 10"]) -> Inertias:
    """Mass, centre and inertia about the centre."""
    P = params_to_pseudo(phi)
    mass, centre = P[:, 3, 3], P[:, :3, 3] / P[:, 3:, 3].clamp(min=torch.finfo(P.dtype).tiny)
    second = P[:, :3, :3] - mass[:, None, None] * centre[:, :, None] * centre[:, None]
    trace = second.diagonal(dim1=1, dim2=2).sum(1)[:, None, None]
    return Inertias(mass, centre, trace * torch.eye(3).to(phi) - second)


def heavy_enough(phi: Float[Tensor, "groups 10"], least: float, extent: float) -> tuple[Tensor, Sequence[int]]:
    """Return parameters in which no body is lighter than ``least`` [kg], and the bodies that were.

    A body without mass gets it at its origin, with ``extent`` [m] along every axis.

    Args:
        least: mass [kg].
        extent: root of the second moment per mass [m].
    """
    light = [k for k, mass in enumerate(phi[:, Inertial.M].tolist()) if mass < least]
    point = params_to_pseudo(phi.clone())
    for k in light:
        point[k] = torch.diag(phi.new_tensor([extent**2, extent**2, extent**2, 1.0])) * least
    return pseudo_to_params(point), light
