"""Pseudo-inertia maps and derived quantities."""

import numpy as np
import pinocchio as pin
import pytest
import torch
from inertia_cases import IDENTITY, bodies, relative

from torchid.inertia.posterior import com_jacobian, inertia_com_jacobian
from torchid.model.pseudo import (
    com,
    inertia_com,
    params_to_pseudo,
    pseudo_to_params,
    relative_map,
    triangle,
    untriangle,
)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_pseudo_and_parameters_invert_each_other(seed: int, shape: tuple[int, ...]) -> None:
    """Parameters -> pseudo-inertia -> parameters is the identity for every batch shape."""
    phi = torch.randn(*shape, 10, dtype=torch.float64)
    torch.testing.assert_close(pseudo_to_params(params_to_pseudo(phi)), phi)
    matrix = torch.randn(*shape, 4, 4, dtype=torch.float64)
    matrix = matrix + matrix.mT
    torch.testing.assert_close(untriangle(triangle(matrix)), matrix)
    torch.testing.assert_close(triangle(matrix).square().sum(-1), matrix.square().sum((-1, -2)))


def test_pinocchio_agrees(seed: int) -> None:
    """Pseudo-inertia, centre of mass and inertia about it equal Pinocchio's for random physical bodies."""
    for phi in bodies(20):
        body = pin.Inertia.FromDynamicParameters(phi.numpy())
        pseudo = pin.PseudoInertia.FromDynamicParameters(phi.numpy())
        np.testing.assert_allclose(params_to_pseudo(phi).numpy(), pseudo.toMatrix(), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(com(phi).numpy(), body.lever, rtol=1e-12)
        np.testing.assert_allclose(inertia_com(phi).numpy(), body.inertia, rtol=1e-10, atol=1e-12)


def test_relative_map_sends_identity_to_reference(seed: int) -> None:
    """The relative pseudo-inertia of the reference is 1, and it is definite exactly when the pseudo-inertia is."""
    reference = bodies(5)
    torch.testing.assert_close(relative_map(reference) @ IDENTITY, reference)
    phi = reference + 0.5 * torch.randn_like(reference) * reference.abs()
    W = torch.linalg.eigvalsh(untriangle(relative(phi, reference)))[:, 0] > 0
    P = torch.linalg.eigvalsh(params_to_pseudo(phi))[:, 0] > 0
    torch.testing.assert_close(W, P)


def test_jacobians_of_derived_quantities(seed: int) -> None:
    """Analytic derivatives of centre of mass and central inertia equal automatic ones."""
    phi = bodies(4)
    for function, jacobian in ((com, com_jacobian), (inertia_com, inertia_com_jacobian)):
        expected = torch.stack([torch.autograd.functional.jacobian(function, one) for one in phi])
        torch.testing.assert_close(jacobian(phi), expected, rtol=1e-10, atol=1e-12)
