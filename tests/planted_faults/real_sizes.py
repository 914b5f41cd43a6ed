"""Faults of a laboratory of a given size, for any recording: what a verdict says it would have shown."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from planted_faults import real_forces as forces
from planted_faults.real_kinds import Given, Planted
from planted_faults.real_plates import RealPlate, used_plates
from planted_faults.real_truth import Answer, Inapplicable, Truth

Plant = Callable[[Given, RealPlate | None, float], Planted]


def _one(plate: RealPlate | None) -> RealPlate:
    if plate is None:
        raise Inapplicable("not of one plate")
    return plate


def _gain(on: Given, plate: RealPlate | None, size: float) -> Planted:
    return forces.plant_gain(on.recorded, [_one(plate)], 1.0 + on.signed(size, size))


def _offset(on: Given, plate: RealPlate | None, size: float) -> Planted:
    return forces.plant_offset(on.recorded, _one(plate), (size * on.direction(3)).tolist(), False)


def _shift(on: Given, plate: RealPlate | None, size: float) -> Planted:
    return forces.plant_pose(on.recorded, _one(plate), (size * on.direction(3)).tolist(), 0.0)


def _tilt(on: Given, plate: RealPlate | None, size: float, away_rad: float) -> Planted:
    return forces.plant_tilt(on.recorded, away_rad + on.draw.integers(2) * np.pi, True, float(np.degrees(size)))


def _excess(on: Given, plate: RealPlate | None, size: float) -> Planted:
    if "mass_kg" not in on.recorded.subject:
        raise Inapplicable("no mass is on record")
    right, excess = float(str(on.recorded.subject["mass_kg"])), on.signed(size, size)
    subject = {**on.recorded.subject, "mass_kg": right + excess}
    return replace(on.recorded, subject=subject), Truth((Answer("body_mass", ("session",)),), f"{excess:+.1f} kg")


SIZED: Mapping[tuple[str, str], Plant] = {
    ("time_offset", "lag_s"): lambda on, plate, size: forces.plant_clock(on.recorded, on.signed(size, size)),
    ("plate_gain", "gain"): _gain,
    ("plate_offset", "force_plate_N"): _offset,
    ("plate_pose", "shift_m"): _shift,
    ("gravity_tilt", "roll_rad"): lambda on, plate, size: _tilt(on, plate, size, 0.5 * np.pi),
    ("gravity_tilt", "pitch_rad"): lambda on, plate, size: _tilt(on, plate, size, 0.0),
    ("body_mass", "excess_kg"): _excess,
}
"""By effect and parameter; signs and directions by lot."""


def plant_sized(effect: str, key: str, size: float, channels: Mapping[str, str] | None, on: Given) -> Planted:
    """A session with a fault of a given size.

    Args:
        effect: its name in the catalogue.
        key: parameter that has the size.
        size: in the parameter's unit; of a factor, its distance from one.
        channels: name of the plate in each trial's file; None: it is not of a plate.
        on: where it is planted.

    Raises:
        Inapplicable: nothing is on the plate, or the session lacks what the fault is of.
    """
    if channels is None:
        return SIZED[effect, key](on, None, size)
    own = [one for one in used_plates(on.recorded) if one.channels.items() & channels.items()]
    if not own:
        raise Inapplicable("a fit trial hardly loads the plate")
    return SIZED[effect, key](on, own[0], size)
