"""The kinds of faults that a battery on real recordings plants, with their places and sizes drawn by lot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from batteries import real_forces as forces
from batteries import real_markers as markers
from batteries import real_plates as plates
from batteries.real_files import Recorded
from batteries.real_forces import Draw
from batteries.real_sessions import RealSession
from batteries.real_truth import Answer, Inapplicable, Truth, plates_answer

Planted = tuple[Recorded, Truth]


@dataclass(frozen=True)
class Kind:
    """A kind of fault."""

    plant: Callable[[Recorded, RealSession, Sequence[slice], Draw], Planted]
    """From a session, the frames of each trial that are written, and a draw."""
    scored: bool
    """Whether a witness sees it in one session, so that the diagnosis is held to it; else it is only tabulated."""


def _clock(lag_s: float) -> Callable[..., Planted]:
    return lambda recorded, *_: forces.plant_clock(recorded, lag_s)


def _gain(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    return forces.plant_gain(recorded, [_plate(recorded, draw)], 1.0 + _signed(draw, 0.03, 0.05))


def _gains(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    every = plates.plates_of(recorded)
    if len(every) < 2:
        raise Inapplicable("the session has one plate")
    return forces.plant_gain(recorded, list(every), 1.0 + _signed(draw, 0.04, 0.04))


def _offset(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    force = draw.uniform(8.0, 15.0) * _direction(draw, 3)
    return forces.plant_offset(recorded, _plate(recorded, draw), force.tolist(), False)


def _offset_zeroed(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    plate, force = _plate(recorded, draw), draw.uniform(8.0, 15.0) * _direction(draw, 3)
    if not forces.zeros_written(recorded, plate):
        raise Inapplicable("unloaded samples of the plate are no exact zeros")
    return forces.plant_offset(recorded, plate, force.tolist(), True)


def _sideways(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    plate = _plate(recorded, draw)
    shift = _signed(draw, 0.04, 0.04) * plates.sideways(recorded, plate)
    return forces.plant_pose(recorded, plate, shift.tolist(), 0.0)


def _shift(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    return forces.plant_pose(recorded, _plate(recorded, draw), (0.015 * _direction(draw, 2)).tolist(), 0.0)


def _turn(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    turn = np.radians(_signed(draw, 2.0, 5.0))
    return forces.plant_pose(recorded, _plate(recorded, draw), (0.0, 0.0), float(turn))


def _crosstalk(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    plate = _plate(recorded, draw)
    return forces.plant_crosstalk(recorded, plate, int(draw.integers(2)), _signed(draw, 0.02, 0.05))


def _tilt(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    return forces.plant_tilt(recorded, float(draw.uniform(-np.pi, np.pi)), bool(draw.integers(2)))


def _marker(scored: bool) -> Callable[..., Planted]:
    def plant(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
        labels = markers.movable(recorded, scored)
        # What is moved in all trials is moved against the static one, or not at all.
        begins = [k for k in recorded.moving if k > 0 and any(j >= k for j in recorded.fitted)]
        if not labels or not begins:
            raise Inapplicable("no such marker" if begins else "nothing was recorded before the only trial")
        shift = draw.uniform(0.015, 0.025) * _direction(draw, 3)
        return markers.plant_shift(recorded, str(draw.choice(labels)), shift.tolist(), int(draw.choice(begins)))

    return plant


def _swap(throughout: bool) -> Callable[..., Planted]:
    def plant(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
        if throughout and len(recorded.trials) < 2:
            raise Inapplicable("no other trial shows how the markers sit")
        k = int(draw.choice(recorded.fitted))
        frames = kept[k] if throughout else markers.some_frames(recorded.trials[k], kept[k], draw)
        pairs = markers.exchangeable(recorded, k, frames)
        if not pairs:
            raise Inapplicable("no two markers are near each other")
        pair = pairs[int(draw.integers(len(pairs)))]
        return markers.plant_swap(recorded, k, pair, slice(None) if throughout else frames)

    return plant


def _scale(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    return markers.plant_scale(recorded, 1.0 + _signed(draw, 0.02, 0.02))


def _mass(recorded: Recorded, session: RealSession, kept: Sequence[slice], draw: Draw) -> Planted:
    if "mass_kg" not in recorded.subject:
        raise Inapplicable("no mass is on record")
    right = float(str(recorded.subject["mass_kg"]))
    excess = float(draw.choice([5.0, -4.0]))
    own = Answer("body_mass", ("session",), {"mass_kg": [session.weighs_kg or right], "recorded_kg": [right + excess]})
    alike = (plates_answer("plate_gain", [one.channels for one in plates.used_plates(recorded)]),)
    planted = replace(recorded, subject={**recorded.subject, "mass_kg": right + excess})
    return planted, Truth((own,), f"{excess:+.0f} kg on record", alike)


KINDS: dict[str, Kind] = {
    "clock12": Kind(_clock(-0.012), True),
    "clock20": Kind(_clock(0.020), True),
    "gain": Kind(_gain, True),
    "all_gains": Kind(_gains, True),
    "mass": Kind(_mass, True),
    "offset": Kind(_offset, True),
    "crosstalk": Kind(_crosstalk, True),
    "tilt": Kind(_tilt, True),
    "filter": Kind(lambda recorded, *_: markers.plant_filter(recorded), True),
    "swap_part": Kind(_swap(False), True),
    "swap_trial": Kind(_swap(True), True),
    "marker": Kind(_marker(True), True),
    "silent": Kind(lambda recorded, session, kept, draw: forces.plant_silence(recorded, draw), True),
    "sideways": Kind(_sideways, True),
    "clock8": Kind(_clock(0.008), False),
    "offset_zeroed": Kind(_offset_zeroed, False),
    "shift15": Kind(_shift, False),
    "turn": Kind(_turn, False),
    "scale": Kind(_scale, False),
    "marker_soft": Kind(_marker(False), False),
}
"""Those that are scored first; order and sizes of `docs/real_battery.md`."""
UNPLANTED = "none"


def plant(kind: str, recorded: Recorded, session: RealSession, kept: Sequence[slice], seed: int) -> Planted:
    """A session with a fault of a kind, at a place and of a size drawn by lot.

    Args:
        kind: of ``KINDS``, or ``none``.
        recorded: the session as recorded.
        session: what is known of it.
        kept: frames of every trial that will be written.
        seed: of the draw.

    Raises:
        Inapplicable: it has no place for such a fault.
    """
    if kind == UNPLANTED:
        return recorded, Truth(())
    return KINDS[kind].plant(recorded, session, kept, np.random.default_rng(seed))


def _plate(recorded: Recorded, draw: Draw) -> plates.RealPlate:
    some = plates.used_plates(recorded)
    return some[int(draw.integers(len(some)))]


def _signed(draw: Draw, least: float, most: float) -> float:
    return float(draw.choice([-1.0, 1.0]) * draw.uniform(least, most))


def _direction(draw: Draw, size: int) -> np.ndarray:
    v = draw.standard_normal(size)
    return v / np.linalg.norm(v)
