"""Real sessions as recordings in memory: read from the shared files, cropped, and written anew with what was planted.

What is written has the format that was read: C3D with its plates, or TRC beside MOT. The unplanted session of a battery
is written in the same way, so that nothing but the fault tells the two apart.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from trc_files import write_trc

from planted_faults.real_sessions import RealSession
from torchid.conventions import LOADED_N, y_up_to_z_up
from torchid.io import ReadOptions, read_trial
from torchid.io.c3d_write import write_c3d
from torchid.io.storage import write_storage
from torchid.model.marker_set import load_marker_set
from torchid.recording import Forces, Markers, Trial

MOVING_S, STATIC_S = 5.0, 2.0
"""Choice. Length to which trials are cropped at most [s]: a walk over plates lasts 1 to 4 s, and fits grow with it."""
AROUND_S = 0.7
"""Choice. Time kept before the first and behind the last load [s]: what a filter of 3 Hz reaches, twice."""
MARGIN_S = 0.05
"""Choice. Time beyond the markers at both ends for which forces of a MOT are kept [s]: more than any planted lag."""


@dataclass(frozen=True)
class Recorded:
    """A session's recordings, before any is synchronised or written."""

    subject: dict[str, object]
    trials: tuple[Trial, ...]
    """The static trial first, where there is one; all others in the order in which they were recorded."""
    segments: dict[str, str]
    """Segment of every marker that the marker set lists, by label."""

    @property
    def moving(self) -> tuple[int, ...]:
        """Numbers of the trials that move."""
        return tuple(k for k, trial in enumerate(self.trials) if trial.role != "static")

    @property
    def fitted(self) -> tuple[int, ...]:
        """Numbers of the fit trials."""
        return tuple(k for k, trial in enumerate(self.trials) if trial.role == "fit")

    def with_trial(self, k: int, trial: Trial) -> "Recorded":
        """The same session with another recording of one trial."""
        return replace(self, trials=(*self.trials[:k], trial, *self.trials[k + 1 :]))


def read_recorded(session: RealSession, way: str, root: Path) -> Recorded:
    """The session as recorded, with a trial left out, or ``none``."""
    markers = load_marker_set(session.markers)
    options, trials = ReadOptions(wanted=markers.wanted), []
    for file, role in session.roles(way):
        forces = None if file.forces is None else root / file.forces
        trials.append(read_trial(file.name, root / file.markers, forces, role, options))
    labels = dict.fromkeys(label for trial in trials for label in trial.markers.labels)
    segments = {label: spec.segment for label, spec in markers.match(labels).assigned.items()}
    return Recorded(dict(session.subject), tuple(trials), segments)


def frames_kept(trial: Trial) -> slice:
    """The frames that a battery runs: those around what plates bear, at most the longest part that counts."""
    count, seconds = len(trial.markers.time), STATIC_S if trial.role == "static" else MOVING_S
    if count < 2:
        return slice(0, count)
    rate = trial.markers.rate
    length = min(count, round(seconds * rate) + 1)
    if trial.forces is None:
        return slice(0, length)
    loaded = (trial.forces.total[:, 2].nan_to_num() > LOADED_N).double().numpy()
    on_frames = np.interp(trial.markers.time.numpy(), trial.forces.time.numpy(), loaded, 0.0, 0.0)
    sums = np.convolve(on_frames, np.ones(length), "valid")
    best = np.flatnonzero(sums > sums.max() - 0.5)
    begin = int(best[len(best) // 2])  # as much before the contact as behind it
    there = begin + np.flatnonzero(on_frames[begin : begin + length] > 0.5)
    around = round(AROUND_S * rate)
    return slice(max(begin, int(there[0]) - around), min(begin + length, int(there[-1]) + 1 + around))


def cropped(trial: Trial, frames: slice) -> Trial:
    """Some frames of a trial, and the samples of the plates that belong to them."""
    if trial.forces is None or len(trial.markers.time) < 2:
        return replace(trial, markers=trial.markers.frames(frames))
    frames = _covered(trial, frames)
    time = trial.markers.time[frames]
    period = 1.0 / trial.markers.rate
    before, behind = (0.0, period) if _is_c3d(trial) else (MARGIN_S, MARGIN_S)
    half = 0.5 / trial.forces.rate
    inside = (trial.forces.time > time[0] - before - half) & (trial.forces.time < time[-1] + behind - half)
    forces = Forces(trial.forces.time[inside], trial.forces.wrench[inside], trial.forces.plates)
    return replace(trial, markers=trial.markers.frames(frames), forces=forces)


def _covered(trial: Trial, frames: slice) -> slice:
    """The frames without those at the ends for which a planted lag has left no sample."""
    assert trial.forces is not None
    known = trial.forces.wrench.isfinite().flatten(1).all(1).nonzero()[:, 0]
    time, rate = trial.markers.time, trial.markers.rate
    first, last = frames.start, frames.stop
    if int(known[0]) > 0:
        first = max(first, int((time < trial.forces.time[known[0]] - 1e-9).sum()))
    if int(known[-1]) + 1 < len(trial.forces.time):
        end = trial.forces.time[known[-1]] - (1.0 / rate if _is_c3d(trial) else 0.0)
        last = min(last, int((time <= end + 1e-9).sum()))
    return slice(first, last)


def write_session(recorded: Recorded, session: RealSession, folder: Path, kept: Sequence[slice]) -> Path:
    """Write some frames of every trial (``frames_kept``), and the config that runs them; its path."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = [_write_trial(cropped(t, k), folder) for t, k in zip(recorded.trials, kept, strict=True)]
    content = {"subject": recorded.subject, "markers": session.markers, "trials": entries, "out": "out", "seed": 0}
    path = folder / "config.json"
    path.write_text(json.dumps(content | session.sections, indent=1))
    return path


def _write_trial(trial: Trial, folder: Path) -> dict[str, str]:
    """Write a trial in the format that it was read from; its entry in a config."""
    entry = {"name": trial.name, "role": trial.role}
    if _is_c3d(trial):
        write_c3d(folder / f"{trial.name}.c3d", replace(trial, forces=_whole(trial.forces), parameters={}))
        return entry | {"file": f"{trial.name}.c3d"}
    write_trc(folder / f"{trial.name}.trc", trial.markers)
    if trial.forces is None:
        return entry | {"file": f"{trial.name}.trc"}
    write_mot(folder / f"{trial.name}.mot", trial.forces)
    return entry | {"file": f"{trial.name}.trc", "forces": f"{trial.name}.mot"}


def _is_c3d(trial: Trial) -> bool:
    return trial.parameters.get("file", "").lower().endswith(".c3d")


def _whole(forces: Forces | None) -> Forces | None:
    """The forces without the single samples that reading took for spikes, which a C3D cannot leave open."""
    if forces is None or bool(forces.wrench.isfinite().all()):
        return forces
    flat, at = forces.wrench.flatten(1).numpy().copy(), np.arange(len(forces.time))
    for column in flat.T:
        known = np.isfinite(column)
        column[~known] = np.interp(at[~known], at[known], column[known])
    return replace(forces, wrench=torch.from_numpy(flat).reshape(forces.wrench.shape))


def write_mot(path: Path, forces: Forces) -> None:
    """Write wrenches in W as a MOT with Y up: force, centre of pressure and free moment of every plate.

    Where a plate bears little, its centre of pressure is taken from the loaded samples beside, and the free moment has
    what remains: the wrench is the same, and no column leaps.
    """
    columns, values = [], []
    for k, plate in enumerate(forces.plates):
        force, moment = forces.wrench[:, k, :3], forces.wrench[:, k, 3:]
        point = _points(force, moment)
        free = moment - torch.linalg.cross(point, force)
        for kind, vector in (("v", force), ("p", point), ("m", free)):
            columns += [f"{plate.name}_{kind}{axis}" for axis in "xyz"]
            values.append(_y_up(vector))
    write_storage(path, tuple(columns), forces.time.numpy(), torch.cat(values, 1).numpy(), title=path.stem)


def _points(force: torch.Tensor, moment: torch.Tensor) -> torch.Tensor:
    """Points of the floor about which a plate's moment is upright, held where it bears little [m]."""
    loaded, at = (force[:, 2] > LOADED_N).numpy(), np.arange(len(force))
    found = np.zeros((len(force), 3))
    if loaded.any():
        upright = force[:, 2].numpy()[loaded]
        for axis, lever in ((0, -moment[:, 1]), (1, moment[:, 0])):
            found[:, axis] = np.interp(at, at[loaded], lever.numpy()[loaded] / upright)
    return torch.from_numpy(found)


def _y_up(vector: torch.Tensor) -> torch.Tensor:
    """The inverse of ``y_up_to_z_up``: three more quarter turns."""
    return y_up_to_z_up(y_up_to_z_up(y_up_to_z_up(vector)))


def with_markers(trial: Trial, position: torch.Tensor, labels: Sequence[str] | None = None) -> Trial:
    """The trial with other marker positions [m]."""
    known = trial.markers.labels if labels is None else tuple(labels)
    return replace(trial, markers=Markers(known, trial.markers.time, position))


def with_wrench(trial: Trial, wrench: torch.Tensor) -> Trial:
    """The trial with other wrenches of its plates [N, N m]."""
    assert trial.forces is not None
    return replace(trial, forces=replace(trial.forces, wrench=wrench))
