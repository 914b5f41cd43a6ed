"""From what a file holds to a `Trial`: missing markers, units, axes, notes; the same for every format."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int

from torchid.conventions import SAMPLE_LOADED_N, ZERO_NOTED_N
from torchid.errors import InputError, Note
from torchid.io.computed import left_out_as_computed
from torchid.io.frame import SAMPLES, force_axis, refuse_axis, to_world, turn_to_world, vertical_axis
from torchid.io.frame_order import frames_out_of_order
from torchid.io.mend import ForcesAs, PlateAs, in_words, mend, turned_up
from torchid.io.missing import frame_repeats, held_samples, missing_samples
from torchid.io.options import ReadOptions
from torchid.io.plate_limits import within_limits
from torchid.io.plates import baseline
from torchid.io.spikes import marker_spikes, plate_spikes
from torchid.recording import Event, Forces, Markers, Trial

Measured = tuple[Forces | None, tuple[Note, ...], tuple[tuple[str, str], ...]]
"""Forces of a file of their own, its notes and facts."""


@dataclass(frozen=True)
class MarkerTable:
    """Markers over time as a file holds them, in its unit and axes."""

    labels: tuple[str, ...]
    time: Float[np.ndarray, " frames"]
    position: Float[np.ndarray, "frames markers 3"]
    """NaN where cells are blank and where rows are missing."""
    lines: Int[np.ndarray, " frames"] | None
    """Line of the file of every frame, from 1; 0 where the row is missing; None where the file has no lines."""
    units: str
    notes: tuple[Note, ...]
    facts: tuple[tuple[str, str], ...] = ()
    """What the file says beside, such as whom it shows."""
    up: str = ""
    """Vertical axis that the file states, empty where it does not."""
    customary: str = "y"
    """Vertical axis that files of this format usually have."""
    kind: str = "TRC"
    """Of the file."""


@dataclass(frozen=True)
class RawTrial:
    """One file's content in its own axes, lengths in m, forces in N and N m."""

    source: str
    labels: tuple[str, ...]
    time: Float[np.ndarray, " frames"]
    position: Float[np.ndarray, "frames markers 3"]
    forces: Forces | None
    up: str
    """Vertical axis that the file states, empty where it does not."""
    customary: str
    """Vertical axis that files of this format usually have."""
    notes: tuple[Note, ...] = ()
    parameters: tuple[tuple[str, str], ...] = ()
    events: tuple[Event, ...] = ()
    beside: Forces | None = None
    """Forces of another file, in its axes and on its clock, which stand for those of this one."""
    lines: Int[np.ndarray, " frames"] | None = None
    """Line of a text file of every frame, None for other formats."""

    @property
    def force_file(self) -> str:
        """The file in which the forces stand."""
        return dict(self.parameters).get("forces", self.source)


def assemble(raw: RawTrial, name: str, role: str, options: ReadOptions) -> Trial:
    """The trial in W, missing samples NaN, with a note for everything repaired or chosen.

    The arrays of ``raw`` become the trial's: they are changed in place.
    """
    position = np.require(raw.position, float, ["C", "W"])
    mask, missing = missing_samples(position, raw.source)
    position[mask] = np.nan
    computed, left_out = left_out_as_computed(raw.labels, position, options.wanted, raw.source)
    if computed:
        position = np.ascontiguousarray(position[:, [label not in computed for label in raw.labels]])
        raw = replace(raw, labels=tuple(label for label in raw.labels if label not in computed))
    same_axes = options.forces_as.up is None  # else the forces say nothing about the markers' vertical
    axis, said = vertical_axis(
        position, raw.forces if same_axes else None, raw.up, raw.customary, options, raw.source,
        raw.beside if same_axes else None,
    )  # fmt: skip
    odd = _doubted_markers(position, raw, role)
    world = turn_to_world(torch.from_numpy(position), axis)
    markers = Markers(raw.labels, torch.from_numpy(np.ascontiguousarray(raw.time, dtype=float)), world)
    forces, turned = raw.forces, []
    if raw.beside is not None:
        forces, turned = _other_forces(raw.beside, raw, axis, options)
    elif forces is not None:
        forces = _forces_in_world(turned_up(forces, options.forces_as, axis), axis)
    if forces is not None:
        forces = mend(forces, *_left_to_mend(options), raw.force_file)
    forces, doubted, overloaded = _doubted(forces, raw)
    said = [*said, *turned, *_as_asked(options, raw.source)]
    notes = (*raw.notes, *missing, *left_out, *said, *odd, *doubted)
    parameters = {**dict(raw.parameters), "file": raw.source, "up": axis}
    if overloaded:
        parameters["plates overloaded"] = " ".join(map(str, overloaded))
    return Trial(name, markers, forces, role, raw.events, notes, parameters, computed)


def _doubted_markers(position: np.ndarray, raw: RawTrial, role: str) -> list[Note]:
    """What is odd about the motion of the markers; samples that leap or are held become NaN in place."""
    if len(raw.time) < 2:
        return []
    rate = (len(raw.time) - 1) / (raw.time[-1] - raw.time[0])
    mask, leaping = marker_spikes(position, rate, raw.labels, raw.source, raw.lines)
    position[mask] = np.nan
    order = frames_out_of_order(position, raw.source)
    if role == "static":
        return [*leaping, *order]
    repeats = frame_repeats(position, raw.source)
    mask, held = held_samples(position, rate, raw.labels, raw.source)
    position[mask] = np.nan
    return [*leaping, *order, *repeats, *held]


def _left_to_mend(options: ReadOptions) -> tuple[ForcesAs, dict[int, PlateAs]]:
    """What the user said of file and plates, without what reading a file of forces has done already."""
    plates = dict(options.plates)
    if not options.moments_read:
        return options.forces_as, plates
    plates = {number: replace(change, moment_gain=1.0) for number, change in plates.items()}
    return replace(options.forces_as, moment_gain=1.0), plates


def _as_asked(options: ReadOptions, source: str) -> list[Note]:
    """What the user's word changed in the forces."""
    said = []
    if options.forces_as != ForcesAs():
        said.append(Note("forces.as_asked", f"forces read as asked: {in_words(options.forces_as)}", source))
    for number, change in sorted(options.plates.items()):
        if change != PlateAs():
            said.append(Note("plates.as_asked", f"plate {number} read as asked: {in_words(change)}", source))
    return said


def _other_forces(forces: Forces, raw: RawTrial, axis: str, options: ReadOptions) -> tuple[Forces, list[Note]]:
    """Forces of another file in W and on the clock of the markers, which count their frames from 1.

    Files of forces often count from the first frame stored; that is taken where more of the markers' time is covered.
    """
    notes, own = [], options.forces_as.up or force_axis(forces) or axis
    refuse_axis(own, "", "", raw.force_file)
    if own != axis:
        text = f"the forces are {own.upper()} up, the markers {axis.upper()} up; each is rotated to Z up by itself"
        notes.append(Note("axes.forces", text, raw.source))
    begin, end = (float(raw.time[0]), float(raw.time[-1])) if len(raw.time) else (0.0, 0.0)
    if begin > 0.0 and len(forces.time):
        first, last = float(forces.time[0]), float(forces.time[-1])
        same, later = (min(end, last + by) - max(begin, first + by) for by in (0.0, begin))
        frame = (end - begin) / max(1, len(raw.time) - 1)
        shifted = later > max(same, 0.0) + frame
        words = "taken to begin with the first stored frame" if shifted else "taken as the clock of the markers"
        text = f"markers begin at {begin:g} s; the clock of the forces, {first:g} to {last:g} s, is {words}"
        notes.append(Note("trial.clock", text, raw.source))
        forces = replace(forces, time=forces.time + begin) if shifted else forces
    return _forces_in_world(forces, own), notes


def _forces_in_world(forces: Forces, axis: str) -> Forces:
    plates = tuple(replace(p, corners=None if p.corners is None else to_world(p.corners, axis)) for p in forces.plates)
    return Forces(forces.time, turn_to_world(forces.wrench, axis), plates)


def _doubted(forces: Forces | None, raw: RawTrial) -> tuple[Forces | None, list[Note], list[int]]:
    """Forces without samples that leap away once (made NaN) and without plates that bear more than anybody can, whose
    numbers come last.

    What is odd about them is said: loads, sign and unloaded reading of every plate, and overlap of the clocks.
    """
    if forces is None:
        return None, [], []
    mask, leaping = plate_spikes(forces, raw.force_file)
    forces.wrench[torch.from_numpy(mask)] = torch.nan
    forces, said, left_out = within_limits(forces, raw.force_file)
    told = [] if forces is None else [*_levels(forces, raw.force_file), *_overlap(forces, raw)]
    return forces, [*leaping, *said, *told], left_out


def _levels(forces: Forces, source: str) -> list[Note]:
    """Plates that pull, and what they read with nobody on them."""
    notes = []
    for k, plate in enumerate(forces.plates):
        vertical = forces.wrench[:: max(1, len(forces.wrench) // SAMPLES), k, 2].numpy()
        loaded = vertical[np.abs(vertical) > SAMPLE_LOADED_N]
        if len(loaded) and loaded.mean() < 0:
            text = f"{plate.name} pulls the subject down ({loaded.mean():.0f} N while loaded): its sign is reversed"
            notes.append(Note("plates.sign", text, source))
        offset = baseline(vertical)
        if offset is not None and abs(offset) > ZERO_NOTED_N:
            text = f"{plate.name} reads {offset:.1f} N while nobody is on it; left as it is"
            notes.append(Note("plates.baseline", text, source))
    return notes


def _overlap(forces: Forces, raw: RawTrial) -> list[Note]:
    if len(raw.time) < 2 or len(forces.time) < 2:
        return []
    frame = (raw.time[-1] - raw.time[0]) / (len(raw.time) - 1)
    begin, end = float(forces.time[0]), float(forces.time[-1])
    if begin >= raw.time[-1] or end <= raw.time[0]:
        raise InputError(
            "trial.no_overlap", "markers and forces share no time", source=raw.source, place="time",
            found=f"markers {raw.time[0]:g} to {raw.time[-1]:g} s, forces {begin:g} to {end:g} s",
            remedy="Give the forces of the same trial, on the same clock",
        )  # fmt: skip
    if begin <= raw.time[0] + frame and end >= raw.time[-1] - frame:
        return []
    text = f"forces last from {begin:g} to {end:g} s, markers from {raw.time[0]:g} to {raw.time[-1]:g} s; overlap used"
    return [Note("trial.overlap", text, raw.source)]
