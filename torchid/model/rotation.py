"""Rotations: rotation vectors, matrices, quaternions and their products, over frames.

Solvers keep frames last, and matrices by their columns; everything else keeps frames first. Tests hold both equal to
roma, whose import alone takes as long as that of torch.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

SMALL = 20_000
"""Entries of a result below which one product that is summed beats three strided ones (a third to two thirds of the
time; above, up to one and a half times it)."""

LEAST = 1e-30
"""Resolution. Square of an angle from which on its root has a derivative."""


def compose(
    A: Float[Tensor, "n 3 3 #frames"], B: Float[Tensor, "n columns 3 #frames"]
) -> Float[Tensor, "n columns 3 frames"]:
    """A B; the second dimension counts columns."""
    if B.numel() < SMALL:
        return (A[:, None] * B[:, :, :, None]).sum(2)
    out = A[:, None, 0] * B[:, :, 0, None]
    out.addcmul_(A[:, None, 1], B[:, :, 1, None])
    return out.addcmul_(A[:, None, 2], B[:, :, 2, None])


def turned(A: Float[Tensor, "n 3 3 #frames"], b: Float[Tensor, "n 3 #frames"]) -> Float[Tensor, "n 3 frames"]:
    """A b."""
    if A.numel() < 2 * SMALL:
        return (A * b[:, :, None]).sum(1)
    out = A[:, 0] * b[:, 0, None]
    out.addcmul_(A[:, 1], b[:, 1, None])
    return out.addcmul_(A[:, 2], b[:, 2, None])


def generators(axis: Float[Tensor, "n 3"]) -> Float[Tensor, "n 9 3"]:
    """G such that Rot(axis, t) = G [1, sin t, 1 - cos t], columns of the matrix one below the other (Rodrigues)."""
    identity = _identity(axis)
    squared = axis[:, :, None] * axis[:, None] - identity
    return torch.stack([identity.expand_as(squared), skew(axis.T).permute(2, 0, 1), squared], dim=3).flatten(1, 2)


def skew(r: Float[Tensor, "3 n"]) -> Float[Tensor, "3 3 n"]:
    """Columns of the matrix that multiplies like r x."""
    x, y, z = r
    zero = torch.zeros_like(x)
    return torch.stack([zero, z, -y, -z, zero, x, y, -x, zero]).view(3, 3, -1)


def _identity(like: Tensor) -> Tensor:
    return torch.eye(3, dtype=like.dtype, device=like.device)


def rodrigues(G: Float[Tensor, "n 9 3"], angle: Float[Tensor, "n frames"]) -> Float[Tensor, "n 3 3 frames"]:
    """Rotations by ``angle`` about the axes whose ``generators`` are G."""
    parts = torch.stack([torch.ones_like(angle), torch.sin(angle), 1.0 - torch.cos(angle)], dim=1)
    return torch.bmm(G, parts).view(len(G), 3, 3, angle.shape[1])


def exp(r: Float[Tensor, "3 frames"]) -> Float[Tensor, "3 3 frames"]:
    """Columns of the rotation matrix of a rotation vector."""
    squared = (r * r).sum(0)
    turns = squared.clamp(min=LEAST).sqrt() / math.pi
    b = 0.5 * torch.sinc(0.5 * turns).square()
    R = torch.addcmul(b * r[:, None] * r, torch.sinc(turns), skew(r))
    return torch.addcmul(R, 1.0 - b * squared, _identity(r)[:, :, None])


def quaternion(r: Float[Tensor, "3 frames"]) -> Float[Tensor, "4 frames"]:
    """Unit quaternion (vector, scalar) of a rotation vector."""
    half = 0.5 * (r * r).sum(0).sqrt()
    return torch.cat([0.5 * torch.sinc(half / math.pi) * r, torch.cos(half)[None]])


def log(quaternion: Float[Tensor, "4 frames"]) -> Float[Tensor, "3 frames"]:
    """Rotation vector, of length pi at most, of a unit quaternion."""
    vector, scalar = quaternion[:3], quaternion[3]
    length = (vector * vector).sum(0).clamp(min=LEAST).sqrt()
    near = torch.where(scalar < 0, -1.0, 1.0)
    angle = 2.0 * torch.atan2(length, scalar.abs())
    return vector * (near * torch.where(length < 1e-12, 2.0, angle / length.clamp(min=1e-30)))


def after(second: Float[Tensor, "3 frames"], first: Float[Tensor, "3 frames"]) -> Float[Tensor, "3 frames"]:
    """Rotation vector of ``first`` followed by ``second``."""
    a, b = quaternion(second), quaternion(first)
    vector = a[3] * b[:3] + b[3] * a[:3] + torch.linalg.cross(a[:3], b[:3], dim=0)
    return log(torch.cat([vector, (a[3] * b[3] - (a[:3] * b[:3]).sum(0))[None]]))


def rotation_matrix(r: Float[Tensor, "*some 3"]) -> Float[Tensor, "*some 3 3"]:
    """Rotation matrix of a rotation vector; differentiable, at zero too."""
    return exp(r.reshape(-1, 3).T).permute(2, 1, 0).reshape(*r.shape, 3)


def rotation_vector(R: Float[Tensor, "*some 3 3"]) -> Float[Tensor, "*some 3"]:
    """Rotation vector, of length pi at most, of a rotation matrix."""
    return log(unit_quaternion(R.reshape(-1, 3, 3)).T).T.reshape(R.shape[:-1])


def unit_quaternion(R: Float[Tensor, "frames 3 3"]) -> Float[Tensor, "frames 4"]:
    """Unit quaternion (vector, scalar) of a rotation matrix, its largest part positive.

    The symmetric matrix is four times the quaternion's dyadic product with itself; the column of its largest diagonal
    entry loses no digits (Shepperd, J Guid Control 1:223 (1978)).
    """
    x, y, z = R.unbind(1)
    trace = x[:, 0] + y[:, 1] + z[:, 2]
    B = torch.stack([
        1.0 + 2.0 * x[:, 0] - trace, x[:, 1] + y[:, 0], x[:, 2] + z[:, 0], z[:, 1] - y[:, 2],
        x[:, 1] + y[:, 0], 1.0 + 2.0 * y[:, 1] - trace, y[:, 2] + z[:, 1], x[:, 2] - z[:, 0],
        x[:, 2] + z[:, 0], y[:, 2] + z[:, 1], 1.0 + 2.0 * z[:, 2] - trace, y[:, 0] - x[:, 1],
        z[:, 1] - y[:, 2], x[:, 2] - z[:, 0], y[:, 0] - x[:, 1], 1.0 + trace,
    ], 1).view(-1, 4, 4)  # fmt: skip
    largest = B.diagonal(dim1=1, dim2=2).argmax(1)
    return torch.nn.functional.normalize(B[torch.arange(len(B), device=R.device), largest], dim=1)


def nearest_rotation(M: Float[Tensor, "*some 3 3"]) -> Float[Tensor, "*some 3 3"]:
    """Rotation R with the largest trace of R' M (Umeyama, IEEE Trans Pattern Anal Mach Intell 13:376 (1991))."""
    U, _, Vh = torch.linalg.svd(M)
    hand = torch.linalg.det(U @ Vh)[..., None]
    return torch.cat([U[..., :2], U[..., 2:] * hand[..., None]], -1) @ Vh
