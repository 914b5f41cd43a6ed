"""Forces in another unit than N: they agree with the feet once they are as large as a person's."""

import math

from torch import Tensor

from torchid.agreement.changes import Change
from torchid.agreement.evidence import agrees, gather
from torchid.agreement.feet import Feet
from torchid.agreement.finding import Finding
from torchid.conventions import GRAVITY, SAMPLE_LOADED_N
from torchid.io.mend import ForcesAs, PlateAs, number_of
from torchid.recording import Forces

PERSON_N = 700.0
"""A weight to which forces are brought for the comparison with feet, whatever their unit."""
LEAST = 1e-4
"""Readings below this in any unit are noise."""
NEAR, APART = math.log(2.5), math.log(1.25)
"""A unit is possible within this factor of the weight on record (partly measured steps and runs give 0.4 to 1.5), and
it is the one if the next is farther by that factor."""


def unit_findings(feet: Feet, forces: Forces, heights: list[float], mass_kg: float | None) -> tuple[Finding, ...]:
    """Plates that carry a foot, but less than anybody weighs.

    Args:
        feet: at the frames of the forces.
        forces: as read.
        heights: of the plates' surfaces in W [m].
        mass_kg: on record, or None.
    """
    peak = forces.wrench[..., :3].norm(dim=-1).amax(dim=0)
    silent = [k for k in range(len(peak)) if LEAST < float(peak[k]) < SAMPLE_LOADED_N]
    found = [k for k in silent if _carries(feet, forces.wrench[:, k] * (PERSON_N / peak[k]), heights[k])]
    if not found:
        return ()
    level = float(_level(forces.wrench[:, found, 2].sum(dim=1)))
    loud = forces.wrench[..., 2].amax(dim=0) > SAMPLE_LOADED_N
    if mass_kg is None and bool(loud.any()):
        mass_kg = float(_level(forces.wrench[:, loud, 2].sum(dim=1))) / GRAVITY
    numbers = {number_of(forces.plates[k], k): forces.plates[k].name for k in found}
    said = f"{', '.join(numbers.values())}: a foot stands on it, yet it reads {level:.3g} N"
    gains = _gains(level, mass_kg)
    whole = len(found) == len([k for k in range(len(peak)) if float(peak[k]) > LEAST])
    changes = tuple(
        Change(what, ForcesAs(gain=g)) if whole else Change(what, plates={n: PlateAs(gain=g) for n in numbers})
        for what, g in gains
    )
    instead = (
        "forces_as: {use: false}" if whole else f"plates: {{{', '.join(f'{n}: {{use: false}}' for n in numbers)}}}"
    )
    if not gains:
        said += ": volts, or counts that nobody has scaled"
    return (Finding(said, changes, instead),)


def _carries(feet: Feet, wrench: Tensor, height: float) -> bool:
    evidence = gather(feet, wrench[None], wrench.new_tensor([height]))
    return bool(agrees(evidence)[0])


def _level(vertical: Tensor) -> Tensor:
    """Median of what stands on the plates while somebody does."""
    return vertical[vertical > 0.5 * vertical.max()].median()


def _gains(level: float, mass_kg: float | None) -> list[tuple[str, float]]:
    """Units in which ``level`` is a person's weight, as factors to N, the likeliest first."""
    if mass_kg is None:
        return [("they are in kN", 1000.0)] if level > 0.05 else []
    weight = mass_kg * GRAVITY
    units = [("they are in kN", 1000.0), ("they are in body weights", round(weight, 1))]
    ranked = sorted((abs(math.log(level * gain / weight)), what, gain) for what, gain in units)
    ranked = [item for item in ranked if item[0] < NEAR]
    return [(what, gain) for off, what, gain in ranked if off < ranked[0][0] + APART]
