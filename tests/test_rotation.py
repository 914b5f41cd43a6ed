"""Rotations equal roma's, with frames last and first."""

import math

import roma
import torch
from torch.testing import assert_close

from torchid.model.rotation import (
    after,
    compose,
    exp,
    generators,
    log,
    nearest_rotation,
    quaternion,
    rodrigues,
    rotation_matrix,
    rotation_vector,
    turned,
)

LENGTHS = (0.0, 1e-12, 1e-6, 0.3, 1.0, 3.0, math.pi - 1e-6, math.pi - 1e-9)


def vectors(limit: float = math.inf) -> torch.Tensor:
    """Rotation vectors (3, frames) of all lengths up to ``limit``, in random directions."""
    lengths = torch.tensor([x for x in (*LENGTHS, 4.0, 6.0) if x < limit], dtype=torch.float64).repeat(20)
    direction = torch.randn(3, len(lengths), dtype=torch.float64)
    return direction / direction.norm(dim=0) * lengths


def test_exponential_is_a_rotation_matrix(seed):
    """Matrices equal roma's; so do those of unit quaternions."""
    r = vectors()
    R = roma.rotvec_to_rotmat(r.T)
    assert_close(exp(r).permute(2, 1, 0), R, rtol=0, atol=1e-12)
    assert_close(roma.unitquat_to_rotmat(quaternion(r).T), R, rtol=0, atol=1e-12)


def test_logarithm_undoes_the_quaternion(seed):
    """Rotation vectors up to half a turn come back, also from the opposite quaternion."""
    r = vectors(math.pi)
    assert_close(log(quaternion(r)), r, rtol=0, atol=1e-12)
    assert_close(log(-quaternion(r)), r, rtol=0, atol=1e-12)


def test_one_rotation_after_another_is_their_product(seed):
    """The vector of a product turns like the product, and is at most half a turn long."""
    first, second = vectors(), vectors()
    both = after(second, first)
    product = roma.rotvec_to_rotmat(second.T) @ roma.rotvec_to_rotmat(first.T)
    assert_close(exp(both).permute(2, 1, 0), product, rtol=0, atol=1e-12)
    assert float(both.norm(dim=0).max()) <= math.pi + 1e-12


def test_turns_about_axes_are_rotation_matrices(seed):
    """Rodrigues' formula, products of columns and turned vectors equal roma's and matrix products."""
    axis = torch.nn.functional.normalize(torch.randn(5, 3, dtype=torch.float64), dim=1)
    angle = 4.0 * torch.randn(5, 7, dtype=torch.float64)
    turn = rodrigues(generators(axis), angle)
    R = roma.rotvec_to_rotmat(axis[:, None] * angle[..., None])
    assert_close(turn.permute(0, 3, 2, 1), R, rtol=0, atol=1e-12)
    b = torch.randn(5, 3, 7, dtype=torch.float64)
    assert_close(turned(turn, b).permute(0, 2, 1), (R @ b.permute(0, 2, 1)[..., None])[..., 0], rtol=0, atol=1e-12)
    assert_close(compose(turn, turn).permute(0, 3, 2, 1), R @ R, rtol=0, atol=1e-12)


def test_matrices_and_vectors_of_frames_equal_romas(seed):
    """Whatever the angle, half turns included; the derivative at no turn at all is that of the skew matrix."""
    r = vectors(math.pi).T.contiguous()
    R = roma.rotvec_to_rotmat(r)
    assert_close(rotation_matrix(r.view(4, -1, 3)).flatten(0, 1), R, rtol=0, atol=1e-12)
    assert_close(rotation_matrix(rotation_vector(R)), R, rtol=0, atol=1e-12)
    half = torch.nn.functional.normalize(torch.randn(30, 3, dtype=torch.float64), dim=1) * math.pi
    assert_close(rotation_matrix(rotation_vector(roma.rotvec_to_rotmat(half))), roma.rotvec_to_rotmat(half))
    assert rotation_vector(R[0]).shape == (3,)
    still = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    weight = torch.randn(3, 3, dtype=torch.float64)
    (rotation_matrix(still)[0] * weight).sum().backward()
    assert still.grad is not None
    assert_close(
        still.grad[0],
        torch.stack([weight[2, 1] - weight[1, 2], weight[0, 2] - weight[2, 0], weight[1, 0] - weight[0, 1]]),
    )


def test_the_nearest_rotation_is_romas(seed):
    """Of matrices that mirror, too."""
    M = torch.randn(50, 3, 3, dtype=torch.float64)
    assert_close(nearest_rotation(M), torch.as_tensor(roma.special_procrustes(M)), rtol=0, atol=1e-9)
    assert_close(torch.linalg.det(nearest_rotation(M)), torch.ones(50, dtype=torch.float64))
