"""Frames in which a foot stands where no plate bears it, told by markers alone: who is weighed in them weighs less."""

import torch
from jaxtyping import Bool
from torch import Tensor

from torchid.checks.plates_against_feet.feet import OFTEN, Feet, find_feet
from torchid.conventions import SAMPLE_LOADED_N, STANDING_M_S
from torchid.recording import Forces, Markers

REACH_M = 0.25
"""Choice. A pressure further than this from all markers of a foot is not that foot's: a foot is hardly longer, and two
feet of a step are further apart."""
RAISED_M = 0.04
"""Choice. A marker of a foot that stands is less than this above the lowest that it often comes."""


def beside_plates(markers: Markers, forces: Forces) -> Bool[Tensor, " frames"]:
    """Return the frames in which some foot stands and no pressure is near it.

    A pressure that no foot is near lies between feet that share a plate; then none is beside it. Feet on a belt that
    moves do not stand, and are on it.

    Args:
        markers: of any set.
        forces: on the clock of the markers.
    """
    found = torch.zeros(len(markers.time), dtype=torch.bool)
    feet = find_feet(markers, torch.arange(len(markers.time)))
    if feet is None:
        return found
    pressure = forces.centre_of_pressure(SAMPLE_LOADED_N)[feet.frames]
    near = torch.stack([_near(feet, k, pressure) for k in range(feet.count)])
    shared = (pressure[..., 0].isfinite() & ~near.any(dim=0)).any(dim=-1)
    stands = torch.stack([_stands(feet, k) for k in range(feet.count)])
    found[feet.frames] = (stands & ~near.any(dim=-1)).any(dim=0) & ~shared
    return found


def _near(feet: Feet, k: int, pressure: Tensor) -> Bool[Tensor, "frames plates"]:
    """Return which plates' pressures are within reach of a foot."""
    place = feet.position[:, None, feet.foot == k, :2]
    apart = (pressure[:, :, None, :2] - place).norm(dim=-1)
    return (apart < REACH_M).any(dim=-1)


def _stands(feet: Feet, k: int) -> Bool[Tensor, " frames"]:
    """Return the frames in which some marker of a foot is low and slow."""
    height, speed = feet.position[:, feet.foot == k, 2], feet.velocity[:, feet.foot == k].norm(dim=-1)
    low = height < torch.nanquantile(height, OFTEN, dim=0) + RAISED_M
    return (low & (speed < STANDING_M_S)).any(dim=1)
