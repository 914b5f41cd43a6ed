"""Faults of force plates that files can carry, planted into a session's recordings.

Nothing here uses the effects of ``torchid.effects`` to plant: tests undo with these what is planted here.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.interpolate
import torch
from torch import Tensor

from planted_faults.real_files import Recorded, with_markers, with_wrench
from planted_faults.real_plates import RealPlate, channel, mapped, plates_of, to_plate, to_world, used_plates
from planted_faults.real_truth import Answer, Inapplicable, Truth, plates_answer
from torchid.conventions import LOADED_N
from torchid.effects.scene import PlateFrame
from torchid.recording import Trial
from torchid.runs import runs

Draw = np.random.Generator
STANCE_S = (0.25, 2.5)
"""Choice. Shortest and longest contact that a plate may keep silent about [s]."""
TILT_DEG = 1.0
"""The contract."""


def _answer(effect: str, plates: Sequence[RealPlate], parameters: dict[str, list[float]] | None = None) -> Answer:
    return plates_answer(effect, [plate.channels for plate in plates], parameters)


def plant_clock(recorded: Recorded, lag_s: float) -> tuple[Recorded, Truth]:
    """Forces that come late by a lag in every trial; NaN at the ends for which there is no sample."""
    for k, trial in enumerate(recorded.trials):
        if trial.forces is not None and len(trial.forces.time) > 3:
            recorded = recorded.with_trial(k, _late(trial, lag_s))
    return recorded, Truth((Answer("time_offset", ("session",), {"lag_s": [lag_s]}),), f"{1e3 * lag_s:+.0f} ms")


def _late(trial: Trial, lag_s: float) -> Trial:
    assert trial.forces is not None
    time, flat = trial.forces.time.numpy(), trial.forces.wrench.flatten(1).numpy()
    known, at = np.isfinite(flat).all(1), time - lag_s
    late = scipy.interpolate.make_interp_spline(time[known], flat[known], k=3)(np.clip(at, time[0], time[-1]))
    unknown = (at < time[0] - 1e-9) | (at > time[-1] + 1e-9) | (np.interp(at, time, ~known) > 0.0)
    late[unknown] = np.nan
    return with_wrench(trial, torch.from_numpy(late).reshape(trial.forces.wrench.shape))


def plant_gain(recorded: Recorded, plates: Sequence[RealPlate], gain: float) -> tuple[Recorded, Truth]:
    """All channels of some plates times a factor."""
    used = used_plates(recorded)
    everything = len(plates) > 1
    right = [_answer("plate_gain", used if everything else plates, {"gain": [gain]})]
    # Where one plate bears all, no other tells its gain from the body's mass.
    mass = everything or len(used) == 1
    alike = (Answer("body_mass", ("session",)), _answer("plate_gain", used)) if mass else ()
    changed = mapped(recorded, plates, lambda wrench, frame: gain * wrench)
    return changed, Truth(tuple(right), f"{100 * (gain - 1):+.1f} %", alike)


def plant_offset(recorded: Recorded, plate: RealPlate, force: Sequence[float], zeroed: bool) -> tuple[Recorded, Truth]:
    """A constant force on every sample of a plate; ``zeroed``: on loaded ones alone, as a program leaves it that sets
    what is below its threshold to zero."""
    constant = torch.tensor([*force, 0.0, 0.0, 0.0], dtype=torch.float64)

    def read(wrench: Tensor, frame: PlateFrame) -> Tensor:
        added = to_world(frame, constant.expand(len(wrench), 6))
        return wrench + (added * (wrench != 0.0).any(1, keepdim=True) if zeroed else added)

    silent = _silent_share(recorded, plate)
    told = f"{np.linalg.norm(force):.1f} N; {100 * silent:.0f} % of the samples were exact zeros"
    own = _answer("plate_offset", [plate], {"force_plate_N": list(force)})
    return mapped(recorded, [plate], read), Truth((own,), told, (_answer("plate_drift", [plate]),))


def _silent_share(recorded: Recorded, plate: RealPlate) -> float:
    """Part of a plate's samples in fit trials that are exactly zero."""
    zeros = []
    for k in recorded.fitted:
        at = channel(recorded.trials[k], plate)
        forces = recorded.trials[k].forces
        if at is not None and forces is not None:
            zeros.append((forces.wrench[:, at] == 0.0).all(1))
    return float(torch.cat(zeros).double().mean())


def zeros_written(recorded: Recorded, plate: RealPlate) -> bool:
    """Whether a program has set the plate's unloaded samples to zero."""
    return _silent_share(recorded, plate) > 0.0


def plant_pose(recorded: Recorded, plate: RealPlate, shift: Sequence[float], turn_rad: float) -> tuple[Recorded, Truth]:
    """A plate that lies elsewhere than the file has it: by a shift in W [m], level without a third number, and turned
    about its upright axis."""
    d, back = torch.tensor([*shift, 0.0][:3], dtype=torch.float64), _about_z(-turn_rad)
    filed = PlateFrame(plate.frame.name, plate.frame.p_WF - d, back @ plate.frame.R_WF)
    moved = mapped(recorded, [plate], lambda wrench, frame: to_world(filed, to_plate(frame, wrench)))
    for k, trial in enumerate(moved.trials):
        moved = moved.with_trial(k, _corners_moved(trial, channel(trial, plate), plate.frame.p_WF, d, back))
    parameters = {"shift_m": d.tolist()} if turn_rad == 0.0 else {"rotation_rad": [0.0, 0.0, turn_rad]}
    told = f"{1e3 * float(d.norm()):.0f} mm" if turn_rad == 0.0 else f"{np.degrees(turn_rad):+.1f} degrees"
    own = _answer("plate_pose", [plate], parameters)
    return moved, Truth((own,), told, (_answer("plate_crosstalk", [plate]),))


def _corners_moved(trial: Trial, at: int | None, centre: Tensor, d: Tensor, back: Tensor) -> Trial:
    """The trial with the corners of a plate where the wrong file has them."""
    if trial.forces is None or at is None or trial.forces.plates[at].corners is None:
        return trial
    plates = list(trial.forces.plates)
    corners = plates[at].corners
    assert corners is not None
    plates[at] = replace(plates[at], corners=(corners - centre) @ back.T + centre - d)
    return replace(trial, forces=replace(trial.forces, plates=tuple(plates)))


def plant_crosstalk(recorded: Recorded, plate: RealPlate, axis: int, part: float) -> tuple[Recorded, Truth]:
    """A part of a plate's vertical force leaks into one of its horizontal channels."""

    def read(wrench: Tensor, frame: PlateFrame) -> Tensor:
        leak = torch.zeros(6, 6, dtype=torch.float64)
        leak[axis, 2] = part
        return wrench + to_world(frame, to_plate(frame, wrench) @ leak.T)

    matrix = np.zeros((6, 6))
    matrix[axis, 2] = part
    own = _answer("plate_crosstalk", [plate], {"matrix_plate": matrix.ravel().tolist()})
    told = f"{100 * part:+.1f} % of Fz in F{'xy'[axis]}"
    return mapped(recorded, [plate], read), Truth((own,), told, (_answer("plate_pose", [plate]),))


def plant_tilt(
    recorded: Recorded, direction_rad: float, room: bool, degrees: float = TILT_DEG
) -> tuple[Recorded, Truth]:
    """The cameras' vertical leans against gravity.

    Args:
        recorded: the session.
        direction_rad: in which the true vertical leans, from x of W.
        room: markers, plates and their readings all stand in the leaning frame; else the readings alone, about the
            middle of the plates, as where corners were written down for a level floor.
        degrees: by how much.
    """
    angle = np.radians(degrees)
    up = np.array([np.sin(angle) * np.cos(direction_rad), np.sin(angle) * np.sin(direction_rad), np.cos(angle)])
    R = _leaning(direction_rad, angle)
    pitch = float(np.arcsin(up[0]))
    roll = float(np.arcsin(-up[1] / np.cos(pitch)))
    middle = torch.stack([p.frame.p_WF for p in plates_of(recorded)]).mean(0)
    for k, trial in enumerate(recorded.trials):
        recorded = recorded.with_trial(k, _leant(trial, R, torch.zeros(3).double() if room else middle, room))
    own = Answer("gravity_tilt", ("session",), {"roll_rad": [roll], "pitch_rad": [pitch]})
    alike = () if room else (Answer("plate_pose", ("*",)),)
    return recorded, Truth((own,), f"{degrees:.3g} degree of {'the room' if room else 'the plates'}", alike)


def _leant(trial: Trial, R: Tensor, about: Tensor, room: bool) -> Trial:
    if room:
        trial = with_markers(trial, trial.markers.position @ R.T)
    if trial.forces is None:
        return trial
    force, moment = trial.forces.wrench[..., :3], trial.forces.wrench[..., 3:]
    own = moment - torch.linalg.cross(about.expand_as(force), force)
    force, own = force @ R.T, own @ R.T
    leant = with_wrench(trial, torch.cat([force, own + torch.linalg.cross(about.expand_as(force), force)], -1))
    if not room or leant.forces is None:
        return leant
    plates = tuple(replace(p, corners=None if p.corners is None else p.corners @ R.T) for p in leant.forces.plates)
    return replace(leant, forces=replace(leant.forces, plates=plates))


def plant_silence(recorded: Recorded, draw: Draw) -> tuple[Recorded, Truth]:
    """A plate that reads nothing during one contact of a fit trial."""
    some = [(k, j, a, b) for k in recorded.fitted for j, a, b in _stances(recorded.trials[k])]
    if not some:
        raise Inapplicable("no contact begins and ends within a fit trial")
    k, plate, a, b = some[int(draw.integers(len(some)))]
    trial = recorded.trials[k]
    assert trial.forces is not None
    wrench, time = trial.forces.wrench.clone(), trial.forces.time
    impulse = wrench[a:b, plate, :3].nan_to_num().sum(0) / trial.forces.rate
    foot = _foot(recorded, trial, plate, a, b)
    wrench[a:b, plate] = 0.0
    own = Answer("unmeasured_contact", (foot,), {"impulse_Ns": impulse.tolist()})
    alike = (Answer("unmeasured_contact", (foot.replace("foot", "shank"),)), Answer("external_force", (foot,)))
    told = f"{trial.forces.plates[plate].name} of {trial.name}, {float(time[a]):.2f} to {float(time[b - 1]):.2f} s"
    return recorded.with_trial(k, with_wrench(trial, wrench)), Truth((own,), told, alike)


def _stances(trial: Trial) -> list[tuple[int, int, int]]:
    """Plate, first sample and end of each contact that begins and ends while the trial lasts."""
    if trial.forces is None:
        return []
    found = []
    for plate in range(len(trial.forces.plates)):
        load = trial.forces.wrench[:, plate, 2].nan_to_num()
        # A contact reaches from where the plate begins to read to where it ends, be it less than a load.
        for a, b in runs(load > LOADED_N):
            lasts = (b - a) / trial.forces.rate
            if a > 0 and b < len(load) and STANCE_S[0] < lasts < STANCE_S[1]:
                found.append((plate, *_widened(load, a, b)))
    return found


def _widened(load: Tensor, a: int, b: int) -> tuple[int, int]:
    while a > 0 and 0.0 < float(load[a - 1]) < float(load[a]):
        a -= 1
    while b < len(load) and 0.0 < float(load[b]) < float(load[b - 1]):
        b += 1
    return a, b


def _foot(recorded: Recorded, trial: Trial, plate: int, a: int, b: int) -> str:
    """The foot that stands where a plate is pressed meanwhile."""
    assert trial.forces is not None
    time = trial.forces.time
    pressed = trial.forces.centre_of_pressure(LOADED_N)[a:b, plate, :2].nanmedian(0).values
    inside = (trial.markers.time >= time[a]) & (trial.markers.time <= time[b - 1])
    apart = {}
    for foot in ("foot_l", "foot_r"):
        own = [k for k, label in enumerate(trial.markers.labels) if recorded.segments.get(label) == foot]
        place = trial.markers.position[inside][:, own, :2].flatten(0, 1).nanmedian(0).values if own else pressed + 9.0
        apart[foot] = float((place - pressed).norm())
    return min(apart, key=lambda foot: apart[foot])


def _about_z(angle: float) -> Tensor:
    c, s = np.cos(angle), np.sin(angle)
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def _leaning(direction: float, angle: float) -> Tensor:
    """The turn about a horizontal axis that takes z to a direction ``angle`` away from it."""
    turn = _about_z(direction)
    c, s = np.cos(angle), np.sin(angle)
    pitch = torch.tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]], dtype=torch.float64)
    return turn @ pitch @ turn.T
