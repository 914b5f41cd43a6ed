"""Forces in another unit than N: they agree with the feet once they are as large as a person's."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.evidence import carries_foot
from torchid.checks.plates_against_feet.feet import Feet
from torchid.checks.plates_against_feet.finding import ForceFinding, without
from torchid.checks.plates_against_feet.readings import FeetScene, scene_of
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
ASIDE = 0.1
"""Choice. Share of a plate's reading, or of the weight, below which what others read is no second foot."""
ONE_GAIN = 0.1
"""Choice. Silent plates whose gains differ by less have one gain: a stance tells a weight to a few per cent."""
TO_SD = 1.4826
"""Derived. Standard deviation over median deviation of Gaussian errors."""
STEP_S = 0.04
"""Time on either side from which an acceleration is taken."""


def unit_findings(trial: Trial, mass_kg: float | None) -> tuple[ForceFinding, ...]:
    """Plates that carry a foot, but less than anybody weighs.

    Args:
        trial: forces on the clock of its markers, which tell how the body is accelerated.
        mass_kg: on record, or None.
    """
    assert trial.forces is not None
    peak = trial.forces.wrench[..., :3].nan_to_num().norm(dim=-1).amax(dim=0)
    silent = [k for k in range(len(peak)) if LEAST < float(peak[k]) < SAMPLE_LOADED_N]
    scene = _louder(trial, silent, peak) if silent else None
    if scene is None:
        return ()
    feet, forces = scene.feet, scene.forces
    found = [k for k in silent if carries_foot(feet, forces.wrench[:, k] * (PERSON_N / peak[k]), scene.heights[k])]
    loud = forces.wrench[..., 2].amax(dim=0) > SAMPLE_LOADED_N
    found = [k for k in found if not _touched(forces.wrench[..., 2], k, loud)]
    if not found:
        return ()
    lift = _lift(trial, feet)
    level = _level(forces.wrench[:, found, 2].sum(dim=1), lift)
    known = mass_kg
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
        changes = (
            () if mass_kg is None else _by_weight(forces, found, mass_kg * GRAVITY * lift, known is not None, whole)
        )
    return (ForceFinding(said, changes, without() if whole else without(*numbers)),)


def _louder(trial: Trial, silent: list[int], peak: Tensor) -> FeetScene | None:
    """The trial at frames that bear load, silent plates counting as if they were as loud as a person; as it is read."""
    assert trial.forces is not None
    gain = torch.ones_like(peak)
    gain[silent] = PERSON_N / peak[silent]
    louder = replace(trial.forces, wrench=trial.forces.wrench * gain[:, None])
    scene = scene_of(replace(trial, forces=louder))
    if scene is None:
        return None
    return replace(scene, forces=replace(scene.forces, wrench=scene.forces.wrench / gain[:, None]))


def _by_weight(forces: Forces, silent: list[int], weight: Tensor, recorded: bool, whole: bool) -> tuple[Change, ...]:
    """The gains that make a person's weight of what silent plates read, while one of them bears it.

    Args:
        forces: as read.
        silent: plates that read too little.
        weight: of the subject with its acceleration, at the frames [N].
        recorded: whether the weight is on record; else other plates tell it.
        whole: whether all plates are silent.
    """
    vertical = forces.wrench[..., 2]
    loud = [k for k in range(vertical.shape[1]) if k not in silent]
    beside, gains, spreads = vertical[:, loud].sum(dim=1), {}, []
    for k in silent:
        others = vertical[:, [j for j in silent if j != k]].sum(dim=1)
        alone = (vertical[:, k] > 0.5 * vertical[:, k].max()) & (others < ASIDE * vertical[:, k])
        alone &= beside < ASIDE * weight
        ratio = (weight / vertical[:, k])[alone]
        if not len(ratio):
            return ()
        gains[k] = float(ratio.median())
        spreads.append(float((ratio / gains[k] - 1.0).abs().median()))
    source = "the weight on record" if recorded else "the weight that the other plates read"
    told = f"gain found from {source}, to {100 * TO_SD * max(spreads):.1g} %; moments may have gains of their own"
    mean = sum(gains.values()) / len(gains)
    if whole and all(abs(gain / mean - 1.0) < ONE_GAIN for gain in gains.values()):
        return (Change(f"they are in volts or counts ({told})", ForcesAs(gain=_rounded(mean))),)
    plates = {number_of(forces.plates[k], k): PlateAs(gain=_rounded(gain)) for k, gain in gains.items()}
    return (Change(f"its channels are in volts or counts ({told})", plates=plates),)


def _rounded(gain: float) -> float:
    """A gain with four digits."""
    return float(f"{gain:.4g}")


def _touched(vertical: Tensor, k: int, loud: Tensor) -> bool:
    """Whether the louder plates bear the weight while this one is pressed most: a foot that only touches it."""
    if not bool(loud.any()):
        return False
    total = vertical[:, loud].sum(dim=1)
    pressed = vertical[:, k] > 0.5 * vertical[:, k].max()
    return float(total[pressed].median()) > 0.5 * float(total.max())


def _lift(trial: Trial, feet: Feet) -> Tensor:
    """1 + a / g (n) at the frames of the feet, a being the vertical acceleration of most markers: a leg that swings has
    another one than the body."""
    height = trial.markers.position[..., 2]
    step = max(1, round(STEP_S * trial.markers.rate))
    before, after = (feet.frames - step).clamp_min(0), (feet.frames + step).clamp_max(len(height) - 1)
    each = (height[after] - 2 * height[feet.frames] + height[before]) * (trial.markers.rate / step) ** 2
    inside = (feet.frames >= step) & (feet.frames < len(height) - step)
    return 1.0 + torch.where(inside, each.nanmedian(dim=1).values, 0.0).nan_to_num() / GRAVITY


def _level(vertical: Tensor, lift: Tensor) -> float:
    """Weight that what stands on the plates moves while somebody does: the median of their reading over 1 + a / g."""
    loaded = vertical > 0.5 * vertical.max()
    return float((vertical[loaded] / lift[loaded]).median())


def _gains(level: float, mass_kg: float | None) -> list[tuple[str, float]]:
    """Units in which ``level`` is a person's weight, as factors to N, the likeliest first."""
    if mass_kg is None:
        return [("they are in kN", 1000.0)] if KN[0] < level < KN[1] else []
    weight = mass_kg * GRAVITY
    units = [("they are in kN", 1000.0), ("they are in body weights", round(weight, 1))]
    ranked = sorted((abs(math.log(level * gain / weight)), what, gain) for what, gain in units)
    ranked = [item for item in ranked if item[0] < NEAR]
    return [(what, gain) for off, what, gain in ranked if off < ranked[0][0] + APART]
