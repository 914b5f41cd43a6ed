"""Forces in another unit than N: they agree with the feet once they are as large as a person's."""

import math

import torch
from torch import Tensor

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.evidence import carries_foot
from torchid.checks.plates_against_feet.feet import Feet
from torchid.checks.plates_against_feet.finding import ForceFinding, without
from torchid.conventions import GRAVITY, SAMPLE_LOADED_N
from torchid.io.mend import ForcesAs, PlateAs, number_of
from torchid.recording import Forces, Trial

PERSON_N = 700.0
"""A weight to which forces are brought for the comparison with feet, whatever their unit."""
LEAST = 1e-4
"""Readings below this in any unit are noise."""
NEAR, APART = math.log(1.6), math.log(1.25)
"""A unit is possible within this factor of the weight on record (steps measured in part give less of it), and it is the
one if the next is farther by that factor."""
KN = 0.15, 3.0
"""Weights of people in kN, where none is on record."""
STEP_S = 0.04
"""Time on either side from which an acceleration is taken."""


def unit_findings(
    trial: Trial, feet: Feet, forces: Forces, heights: list[float], mass_kg: float | None
) -> tuple[ForceFinding, ...]:
    """Plates that carry a foot, but less than anybody weighs.

    Args:
        trial: whose markers tell how the body is accelerated.
        feet: at the frames of the forces.
        forces: as read.
        heights: of the plates' surfaces in W [m].
        mass_kg: on record, or None.
    """
    peak = forces.wrench[..., :3].norm(dim=-1).amax(dim=0)
    silent = [k for k in range(len(peak)) if LEAST < float(peak[k]) < SAMPLE_LOADED_N]
    found = [k for k in silent if carries_foot(feet, forces.wrench[:, k] * (PERSON_N / peak[k]), heights[k])]
    if not found:
        return ()
    loud = forces.wrench[..., 2].amax(dim=0) > SAMPLE_LOADED_N
    found = [k for k in found if not _touched(forces.wrench[..., 2], k, loud)]
    if not found:
        return ()
    lift = _lift(trial, feet)
    level = _level(forces.wrench[:, found, 2].sum(dim=1), lift)
    if mass_kg is None and bool(loud.any()):
        mass_kg = _level(forces.wrench[:, loud, 2].sum(dim=1), lift) / GRAVITY
    numbers = {number_of(forces.plates[k], k): forces.plates[k].name for k in found}
    said = f"{', '.join(numbers.values())}: a foot stands on it, yet it reads {level:.3g} N"
    gains = _gains(level, mass_kg)
    whole = len(found) == len([k for k in range(len(peak)) if float(peak[k]) > LEAST])
    changes = tuple(
        Change(what, ForcesAs(gain=g)) if whole else Change(what, plates={n: PlateAs(gain=g) for n in numbers})
        for what, g in gains
    )
    if not gains:
        said += ": volts, or counts that nobody has scaled"
    return (ForceFinding(said, changes, without() if whole else without(*numbers)),)


def _touched(vertical: Tensor, k: int, loud: Tensor) -> bool:
    """Whether the louder plates bear the weight while this one is pressed most: a foot that only touches it."""
    if not bool(loud.any()):
        return False
    total = vertical[:, loud].sum(dim=1)
    pressed = vertical[:, k] > 0.5 * vertical[:, k].max()
    return float(total[pressed].median()) > 0.5 * float(total.max())


def _lift(trial: Trial, feet: Feet) -> Tensor:
    """1 + a / g (n) at the frames of the feet, a being the vertical acceleration of the markers' mean."""
    height = trial.markers.position[..., 2].nanmean(dim=1)
    step = max(1, round(STEP_S * trial.markers.rate))
    before, after = (feet.frames - step).clamp_min(0), (feet.frames + step).clamp_max(len(height) - 1)
    acceleration = (height[after] - 2 * height[feet.frames] + height[before]) * (trial.markers.rate / step) ** 2
    inside = (feet.frames >= step) & (feet.frames < len(height) - step)
    return 1.0 + torch.where(inside, acceleration, 0.0).nan_to_num() / GRAVITY


def _level(vertical: Tensor, lift: Tensor) -> float:
    """Weight that what stands on the plates moves while somebody does: its mean over that of 1 + a / g."""
    loaded = vertical > 0.5 * vertical.max()
    return float(vertical[loaded].mean() / lift[loaded].mean())


def _gains(level: float, mass_kg: float | None) -> list[tuple[str, float]]:
    """Units in which ``level`` is a person's weight, as factors to N, the likeliest first."""
    if mass_kg is None:
        return [("they are in kN", 1000.0)] if KN[0] < level < KN[1] else []
    weight = mass_kg * GRAVITY
    units = [("they are in kN", 1000.0), ("they are in body weights", round(weight, 1))]
    ranked = sorted((abs(math.log(level * gain / weight)), what, gain) for what, gain in units)
    ranked = [item for item in ranked if item[0] < NEAR]
    return [(what, gain) for off, what, gain in ranked if off < ranked[0][0] + APART]
