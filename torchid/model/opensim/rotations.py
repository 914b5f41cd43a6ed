"""Rotations and poses as OpenSim states them, with the batch first."""

import torch
from jaxtyping import Float
from torch import Tensor

R_OW = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], dtype=torch.float64)
"""Our axes (X forward, Y left, Z up) in OpenSim's (X forward, Y up, Z right)."""


def about_axis(axis: Float[Tensor, "3"], angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3 3"]:
    """Return rotations about a unit axis (Rodrigues).

    Args:
        axis: unit vector.
        angle: angles [rad].
    """
    K = cross_matrix(axis.to(angle))
    sine, versine = angle.sin()[..., None, None], (1.0 - angle.cos())[..., None, None]
    return torch.eye(3).to(angle) + sine * K + versine * (K @ K)


def cross_matrix(axis: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Return the matrix that takes the cross product of an axis with what it is given."""
    x, y, z = axis.tolist()
    return axis.new_tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def body_xyz(angles: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Return rotations about X, then the new Y, then the new Z (OpenSim's ``orientation``).

    Args:
        angles: three angles [rad].
    """
    x, y, z = (about_axis(axis, angle) for axis, angle in zip(torch.eye(3), angles.unbind(-1), strict=True))
    return x @ y @ z


def pose(R: Float[Tensor, "*batch 3 3"], p: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 4 4"]:
    """Return homogeneous matrices."""
    last = R.new_tensor([[0.0, 0.0, 0.0, 1.0]]).expand(*R.shape[:-2], 1, 4)
    return torch.cat([torch.cat([R, p[..., None]], dim=-1), last], dim=-2)


def inverse(X: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Return the inverses of poses."""
    R = X[..., :3, :3].mT
    return pose(R, -(R @ X[..., :3, 3:])[..., 0])


def moved(X: Float[Tensor, "*#batch 4 4"], p: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Return points carried by poses.

    Args:
        p: points in the axes of the poses.
    """
    return (X[..., :3, :3] @ p[..., None])[..., 0] + X[..., :3, 3]
