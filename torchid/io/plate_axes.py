"""A force plate's own axes: its six channels there, and the wrench about the origin of W that they stand for."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.recording import Plate


def frame_of(corners: Float[Tensor, "4 3"]) -> tuple[Float[Tensor, "3 3"], Float[Tensor, " 3"]]:
    """Axes R_WF and centre p_WF of a plate from its corners [m] in the quadrants ++, -+, --, +-."""
    x = corners[0] - corners[1]
    z = torch.linalg.cross(x, corners[0] - corners[3])
    x, z = x / x.norm(), z / z.norm()
    return torch.stack([x, torch.linalg.cross(z, x), z], dim=1), corners.mean(dim=0)


def in_plate(wrench: Float[Tensor, "samples 6"], plate: Plate) -> Float[Tensor, "samples 6"]:
    """A wrench about the origin of W as the plate's six channels: in its axes, about its transducer."""
    assert plate.corners is not None
    R_WF, p_WF = frame_of(plate.corners)
    force, moment = wrench[:, :3], wrench[:, 3:]
    force_F = force @ R_WF
    moment_F = (moment - torch.linalg.cross(p_WF.expand_as(force), force)) @ R_WF
    return torch.cat([force_F, moment_F + torch.linalg.cross(_depth(plate).expand_as(force), force_F)], dim=1)


def from_plate(channels: Float[Tensor, "samples 6"], plate: Plate) -> Float[Tensor, "samples 6"]:
    """The inverse of ``in_plate``."""
    assert plate.corners is not None
    R_WF, p_WF = frame_of(plate.corners)
    force, moment = channels[:, :3], channels[:, 3:]
    moment = (moment - torch.linalg.cross(_depth(plate).expand_as(force), force)) @ R_WF.T
    force = force @ R_WF.T
    return torch.cat([force, moment + torch.linalg.cross(p_WF.expand_as(force), force)], dim=1)


def _depth(plate: Plate) -> Tensor:
    assert plate.corners is not None
    return plate.corners.new_zeros(3) if plate.origin is None else plate.origin
