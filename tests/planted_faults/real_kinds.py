"""The kinds of faults that a battery on real recordings plants, with their places and sizes drawn by lot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planted_faults import real_forces as forces
from planted_faults import real_markers as markers
from planted_faults import real_plates as plates
from planted_faults.real_files import Recorded
from planted_faults.real_forces import Draw
from planted_faults.real_sessions import RealSession
from planted_faults.real_truth import Answer, Inapplicable, Truth, plates_answer

Planted = tuple[Recorded, Truth]


@dataclass(frozen=True)
class Given:
    """Where a fault is planted."""

    recorded: Recorded
    session: RealSession
    kept: Sequence[slice]
    """Frames of each trial that are written."""
    draw: Draw

    def plate(self) -> plates.RealPlate:
        """One that bears something, by lot."""
        some = plates.used_plates(self.recorded)
        return some[int(self.draw.integers(len(some)))]

    def signed(self, least: float, most: float) -> float:
        """A size by lot."""
        return float(self.draw.choice([-1.0, 1.0]) * self.draw.uniform(least, most))

    def direction(self, size: int) -> np.ndarray:
        """By lot."""
        v = self.draw.standard_normal(size)
        return v / np.linalg.norm(v)


@dataclass(frozen=True)
class Kind:
    """A kind of fault."""

    plant: Callable[["Given"], Planted]
    scored: bool
    """Whether a witness sees it in one session, so that the diagnosis is held to it; else it is only tabulated."""


def _gains(on: Given) -> Planted:
    every = plates.plates_of(on.recorded)
    if len(every) < 2:
        raise Inapplicable("the session has one plate")
    return forces.plant_gain(on.recorded, list(every), 1.0 + on.signed(0.04, 0.04))


def _offset(on: Given) -> Planted:
    force = on.draw.uniform(8.0, 15.0) * on.direction(3)
    return forces.plant_offset(on.recorded, on.plate(), force.tolist(), False)


def _offset_zeroed(on: Given) -> Planted:
    plate, force = on.plate(), on.draw.uniform(8.0, 15.0) * on.direction(3)
    if not forces.zeros_written(on.recorded, plate):
        raise Inapplicable("unloaded samples of the plate are no exact zeros")
    return forces.plant_offset(on.recorded, plate, force.tolist(), True)


def _sideways(on: Given) -> Planted:
    plate = on.plate()
    shift = on.signed(0.04, 0.04) * plates.sideways(on.recorded, plate)
    return forces.plant_pose(on.recorded, plate, shift.tolist(), 0.0)


def _turn(on: Given) -> Planted:
    turn = np.radians(on.signed(2.0, 5.0))
    return forces.plant_pose(on.recorded, on.plate(), (0.0, 0.0), float(turn))


def _marker(on: Given, scored: bool) -> Planted:
    labels = markers.movable(on.recorded, scored)
    # What is moved in all trials is moved against the static one, or not at all.
    begins = [k for k in on.recorded.moving if k > 0 and any(j >= k for j in on.recorded.fitted)]
    if not labels or not begins:
        raise Inapplicable("no such marker" if begins else "nothing was recorded before the only trial")
    shift = on.draw.uniform(0.015, 0.025) * on.direction(3)
    return markers.plant_shift(on.recorded, str(on.draw.choice(labels)), shift.tolist(), int(on.draw.choice(begins)))


def _swap(on: Given, throughout: bool) -> Planted:
    if throughout and len(on.recorded.trials) < 2:
        raise Inapplicable("no other trial shows how the markers sit")
    k = int(on.draw.choice(on.recorded.fitted))
    frames = on.kept[k] if throughout else markers.some_frames(on.recorded.trials[k], on.kept[k], on.draw)
    pairs = markers.exchangeable(on.recorded, k, frames)
    if not pairs:
        raise Inapplicable("no two markers are near each other")
    pair = pairs[int(on.draw.integers(len(pairs)))]
    return markers.plant_swap(on.recorded, k, pair, slice(None) if throughout else frames)


def _mass(on: Given) -> Planted:
    if "mass_kg" not in on.recorded.subject:
        raise Inapplicable("no mass is on record")
    right = float(str(on.recorded.subject["mass_kg"]))
    excess = float(on.draw.choice([5.0, -4.0]))
    true = {"mass_kg": [on.session.weighs_kg or right], "recorded_kg": [right + excess]}
    alike = (plates_answer("plate_gain", [one.channels for one in plates.used_plates(on.recorded)]),)
    planted = replace(on.recorded, subject={**on.recorded.subject, "mass_kg": right + excess})
    return planted, Truth((Answer("body_mass", ("session",), true),), f"{excess:+.0f} kg on record", alike)


KINDS: dict[str, Kind] = {
    "clock12": Kind(lambda on: forces.plant_clock(on.recorded, -0.012), True),
    "clock20": Kind(lambda on: forces.plant_clock(on.recorded, 0.020), True),
    "gain": Kind(lambda on: forces.plant_gain(on.recorded, [on.plate()], 1.0 + on.signed(0.03, 0.05)), True),
    "all_gains": Kind(_gains, True),
    "mass": Kind(_mass, True),
    "offset": Kind(_offset, True),
    "crosstalk": Kind(
        lambda on: forces.plant_crosstalk(on.recorded, on.plate(), int(on.draw.integers(2)), on.signed(0.02, 0.05)),
        True,
    ),
    "tilt": Kind(
        lambda on: forces.plant_tilt(on.recorded, float(on.draw.uniform(-np.pi, np.pi)), bool(on.draw.integers(2))),
        True,
    ),
    "filter": Kind(lambda on: markers.plant_filter(on.recorded), True),
    "swap_part": Kind(lambda on: _swap(on, False), True),
    "swap_trial": Kind(lambda on: _swap(on, True), True),
    "marker": Kind(lambda on: _marker(on, True), True),
    "silent": Kind(lambda on: forces.plant_silence(on.recorded, on.draw), True),
    "sideways": Kind(_sideways, True),
    "clock8": Kind(lambda on: forces.plant_clock(on.recorded, 0.008), False),
    "offset_zeroed": Kind(_offset_zeroed, False),
    "shift15": Kind(
        lambda on: forces.plant_pose(on.recorded, on.plate(), (0.015 * on.direction(2)).tolist(), 0.0), False
    ),
    "turn": Kind(_turn, False),
    "scale": Kind(lambda on: markers.plant_scale(on.recorded, 1.0 + on.signed(0.02, 0.02)), False),
    "marker_soft": Kind(lambda on: _marker(on, False), False),
}
"""Those that are scored first; order and sizes of `docs/real_battery.md`."""
UNPLANTED = "none"


def plant(kind: str, recorded: Recorded, session: RealSession, kept: Sequence[slice], seed: int) -> Planted:
    """A session with a fault of a kind, or with ``none``, at a place and of a size drawn by lot.

    Raises:
        Inapplicable: it has no place for such a fault.
    """
    if kind == UNPLANTED:
        return recorded, Truth(())
    return KINDS[kind].plant(Given(recorded, session, kept, np.random.default_rng(seed)))
