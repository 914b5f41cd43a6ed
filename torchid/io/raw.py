"""From what a file holds to a `Trial`: missing markers, units, axes, notes; the same for every format."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int

from torchid.conventions import SAMPLE_LOADED_N
from torchid.errors import InputError, Note
from torchid.io.frame import SAMPLES, to_world, turn_to_world, vertical_axis
from torchid.io.missing import held_samples, missing_samples
from torchid.io.options import ReadOptions
from torchid.io.plates import baseline
from torchid.io.spikes import marker_spikes, plate_spikes
from torchid.recording import Event, Forces, Markers, Trial

SMALL_BASELINE = 1.0
"""An unloaded reading [N] below this is not worth a note."""


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
    lines: Int[np.ndarray, " frames"] | None = None
    """Line of a text file of every frame, None for other formats."""


def assemble(raw: RawTrial, name: str, role: str, options: ReadOptions) -> Trial:
    """The trial in W, missing samples NaN, with a note for everything repaired or chosen.

    The arrays of ``raw`` become the trial's: they are changed in place.
    """
    position = np.require(raw.position, float, ["C", "W"])
    mask, missing = missing_samples(position, raw.source)
    position[mask] = np.nan
    axis, said = vertical_axis(position, raw.forces, raw.up, raw.customary, options, raw.source)
    held: list[Note] = []
    leaping: list[Note] = []
    if len(raw.time) > 1:
        rate = (len(raw.time) - 1) / (raw.time[-1] - raw.time[0])
        mask, leaping = marker_spikes(position, rate, raw.labels, raw.source, raw.lines)
        position[mask] = np.nan
        if role != "static":
            mask, held = held_samples(position, rate, raw.labels, raw.source)
            position[mask] = np.nan
    world = turn_to_world(torch.from_numpy(position), axis)
    markers = Markers(raw.labels, torch.from_numpy(np.ascontiguousarray(raw.time, dtype=float)), world)
    forces = None if raw.forces is None else _forces_in_world(raw.forces, axis)
    notes = (*raw.notes, *missing, *said, *leaping, *held, *_force_notes(forces, raw))
    parameters = {**dict(raw.parameters), "file": raw.source, "up": axis}
    return Trial(name, markers, forces, role, raw.events, notes, parameters)


def _forces_in_world(forces: Forces, axis: str) -> Forces:
    plates = tuple(replace(p, corners=None if p.corners is None else to_world(p.corners, axis)) for p in forces.plates)
    return Forces(forces.time, turn_to_world(forces.wrench, axis), plates)


def _force_notes(forces: Forces | None, raw: RawTrial) -> list[Note]:
    """Samples that leap away once (made NaN), sign of every plate, its unloaded reading, and overlap of the clocks."""
    if forces is None:
        return []
    mask, notes = plate_spikes(forces, raw.source)
    forces.wrench[torch.from_numpy(mask)] = torch.nan
    for k, plate in enumerate(forces.plates):
        vertical = forces.wrench[:: max(1, len(forces.wrench) // SAMPLES), k, 2].numpy()
        loaded = vertical[np.abs(vertical) > SAMPLE_LOADED_N]
        if len(loaded) and loaded.mean() < 0:
            text = f"{plate.name} pulls the subject down ({loaded.mean():.0f} N while loaded): its sign is reversed"
            notes.append(Note("plates.sign", text, raw.source))
        offset = baseline(vertical)
        if offset is not None and abs(offset) > SMALL_BASELINE:
            text = f"{plate.name} reads {offset:.1f} N with nobody on it; left as it is"
            notes.append(Note("plates.baseline", text, raw.source))
    return notes + _overlap(forces, raw)


def _overlap(forces: Forces, raw: RawTrial) -> list[Note]:
    if len(raw.time) < 2 or len(forces.time) < 2:
        return []
    frame = (raw.time[-1] - raw.time[0]) / (len(raw.time) - 1)
    begin, end = float(forces.time[0]), float(forces.time[-1])
    if begin >= raw.time[-1] or end <= raw.time[0]:
        raise InputError(
            "trial.no_overlap",
            "markers and forces share no time",
            source=raw.source,
            place="time",
            found=f"markers {raw.time[0]:g} to {raw.time[-1]:g} s, forces {begin:g} to {end:g} s",
            remedy="Give the forces of the same trial, on the same clock",
        )
    if begin <= raw.time[0] + frame and end >= raw.time[-1] - frame:
        return []
    text = f"forces last from {begin:g} to {end:g} s, markers from {raw.time[0]:g} to {raw.time[-1]:g} s; overlap used"
    return [Note("trial.overlap", text, raw.source)]
