"""Pseudo-inertia matrices and what a reader wants of ten inertial parameters.

The pseudo-inertia of a body is the 4 x 4 matrix P = [[Sigma, h], [h', m]] with Sigma = tr(I)/2 - I the second moments
of mass, h = m c and I the inertia about the body's origin. It is positive definite exactly when a positive mass
distribution has these ten parameters.

Reference: Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import INERTIA_PAIRS, Inertial

TRIANGLE = tuple((i, j) for j in range(4) for i in range(j + 1))
"""Upper triangle column by column: the order in which Clarabel stacks a symmetric matrix."""


def inertia_matrix(phi: Float[Tensor, "*batch 10"]) -> Float[Tensor, "*batch 3 3"]:
    """Inertia about the body's origin [kg m^2]."""
    matrix = phi.new_zeros((*phi.shape[:-1], 3, 3))
    for k, (i, j) in enumerate(INERTIA_PAIRS):
        matrix[..., i, j] = matrix[..., j, i] = phi[..., Inertial.IXX + k]
    return matrix


def mass(phi: Float[Tensor, "*batch 10"]) -> Float[Tensor, "*batch"]:
    """Mass [kg]."""
    return phi[..., Inertial.M]


def com(phi: Float[Tensor, "*batch 10"]) -> Float[Tensor, "*batch 3"]:
    """Centre of mass p_BC_B from the body's origin [m]."""
    return phi[..., Inertial.MCX : Inertial.MCZ + 1] / phi[..., Inertial.M, None]


def inertia_com(phi: Float[Tensor, "*batch 10"]) -> Float[Tensor, "*batch 3 3"]:
    """Inertia about the centre of mass, in body axes [kg m^2] (Steiner's theorem)."""
    c, eye = com(phi), torch.eye(3, dtype=phi.dtype, device=phi.device)
    steiner = (c * c).sum(-1)[..., None, None] * eye - c[..., :, None] * c[..., None, :]
    return inertia_matrix(phi) - mass(phi)[..., None, None] * steiner


def params_to_pseudo(phi: Float[Tensor, "*batch 10"]) -> Float[Tensor, "*batch 4 4"]:
    """Pseudo-inertia of ten parameters [kg m^2, kg m, kg]."""
    inertia = inertia_matrix(phi)
    trace = inertia.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    pseudo = phi.new_zeros((*phi.shape[:-1], 4, 4))
    pseudo[..., :3, :3] = 0.5 * trace * torch.eye(3, dtype=phi.dtype, device=phi.device) - inertia
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = phi[..., Inertial.MCX : Inertial.MCZ + 1]
    pseudo[..., 3, 3] = mass(phi)
    return pseudo


def pseudo_to_params(pseudo: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 10"]:
    """Ten parameters of a pseudo-inertia."""
    second = pseudo[..., :3, :3]
    trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    inertia = trace * torch.eye(3, dtype=pseudo.dtype, device=pseudo.device) - second
    moments = [inertia[..., i, j] for i, j in INERTIA_PAIRS]
    return torch.stack([pseudo[..., 3, 3], *pseudo[..., :3, 3].unbind(-1), *moments], dim=-1)


def triangle(matrix: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 10"]:
    """Stacked upper triangle, off-diagonal entries times sqrt(2): dot products of stacks are traces of products."""
    return torch.stack([matrix[..., i, j] * (1 if i == j else 2**0.5) for i, j in TRIANGLE], dim=-1)


def untriangle(stack: Float[Tensor, "*batch 10"]) -> Float[Tensor, "*batch 4 4"]:
    """Symmetric matrix of a stacked triangle."""
    matrix = stack.new_zeros((*stack.shape[:-1], 4, 4))
    for k, (i, j) in enumerate(TRIANGLE):
        matrix[..., i, j] = matrix[..., j, i] = stack[..., k] / (1 if i == j else 2**0.5)
    return matrix


def relative_map(reference: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 10 10"]:
    """Map T from relative to inertial parameters, phi = T x.

    x is the stacked triangle of W = L^-1 P(phi) L^-T with L L' = P(reference): W is the identity at the reference,
    and positive definite exactly when P is. It has no unit, so neither has a bound on its eigenvalues.
    """
    factor = torch.linalg.cholesky(params_to_pseudo(reference))
    units = untriangle(torch.eye(10, dtype=reference.dtype, device=reference.device))
    columns = pseudo_to_params(factor[:, None] @ units @ factor[:, None].mT)
    return columns.mT
