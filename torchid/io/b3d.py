"""One trial of a .b3d of AddBiomechanics, with markers and forces as they were measured.

Of the passes of processing only forces are read, and only where no plates are stored: solved markers and postures are
not what a laboratory measured. ``torchid.io.b3d_header`` has the layout.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8

from torchid.conventions import SAMPLE_LOADED_N
from torchid.errors import InputError, Note
from torchid.io.b3d_header import B3dHeader, B3dTrial, read_header
from torchid.io.clock import uniform_clock
from torchid.io.grf import forces_of_columns
from torchid.io.plate_setup import PlateProblem, plate_frame
from torchid.io.protobuf import BYTES, walk
from torchid.io.raw import MarkerTable, Measured
from torchid.io.storage import Storage
from torchid.recording import Forces
from torchid.wording import listing

MARKERS = 2
"""Field of the markers in a frame of sensors."""
PLATES = {"force": 9, "point": 7, "torque": 8}
"""Fields of what plates read, in a frame of sensors."""
CONTACTS = {"force": 8, "point": 6, "torque": 7}
"""Fields of the same by the bodies that touch the ground, in a frame of a pass."""
LETTERS = {"force": "v", "point": "p", "torque": "m"}
"""How columns of these are called in a MOT."""
REASONS = (
    "", "no force while the body accelerates", "an external force that no plate measured", "torques do not agree",
    "forces do not agree", "not over a plate", "a missing impact", "a missing blip", "shifted forces",
    "forces cut off and interpolated", "reviewed by hand", "a foot on the ground without force",
    "markers that fit badly", "outliers", "no force plates", "too fast after filtering",
    "a centre of pressure off the foot", "no force", "extended to the next peak",
)  # fmt: skip
"""Why forces of a frame are not known: what the numbers of ``MissingGRFReason`` mean, of which 0 is that they are."""


def read_b3d(container: Path, name: str, moment_gain: Callable[[int], float]) -> tuple[MarkerTable, Measured]:
    """Markers and forces of a trial, in m and N, Y up.

    Forces are what plates read; where none are stored, what the first pass says of the bodies that touch the ground,
    before it has changed them. Frames whose forces the file says are not known are gaps of all of them.

    Args:
        container: the file.
        name: of the trial; empty where the file holds just one.
        moment_gain: factor of the free moments of a plate, by its number.

    Raises:
        InputError: as ``read_header``; ``b3d.trial`` where the trial is not there; ``b3d.frames`` where its frames are
            not what the header says; as ``forces_of_columns``.
    """
    header = read_header(container)
    trial = _of_name(header, name)
    source, notes = str(container / trial.name), list[Note]()
    period, labels = float(next(iter(trial.said.doubles(4)), 0.0)), header.said.texts(17)
    if trial.frames == 0 or not 0.0 < period < np.inf:
        raise _frames(source, f"{trial.frames} frames, one every {period:g} s")
    raw = np.frombuffer(header.file[trial.start : trial.start + trial.frames * trial.stride], np.uint8)
    frames = raw.reshape(trial.frames, trial.stride)
    sensors = _columns(frames[:, : header.sensors], source)
    position = sensors.get(MARKERS, np.zeros((trial.frames, 0)))
    if position.shape[1] != 3 * len(labels):
        raise _frames(source, f"{position.shape[1]} coordinates of {len(labels)} markers")
    if trial.said.whole(9):
        notes.append(Note("b3d.labels", "the file says that the labels of its markers were guessed", source))
    rows = np.arange(trial.frames)
    time = uniform_clock(rows * period, rows + 1, source, notes).time
    position = position.reshape(trial.frames, len(labels), 3).copy()
    markers = MarkerTable(tuple(labels), time, position, None, "m", tuple(notes), header.facts, up="y", kind="B3D")
    return markers, _forces(header, trial, sensors, frames, time, moment_gain, source)


def _of_name(header: B3dHeader, name: str) -> B3dTrial:
    found = [trial for trial in header.trials if not name or trial.name == name]
    if len(found) == 1:
        return found[0]
    names = [trial.name for trial in header.trials]
    raise InputError(
        "b3d.trial", "the file holds no trial of this name" if name else "the file holds several trials",
        source=header.file.path, place=f"trial {name}" if name else "", found=listing(names, 12),
        remedy=f"Name one as if the file were a folder: file: {header.file.path.name}/{names[0]}",
    )  # fmt: skip


def _frames(source: str, found: str) -> InputError:
    return InputError(
        "b3d.frames", "the frames are not what the header says", source=source, found=found,
        remedy="Download or export the file again",
    )  # fmt: skip


def _columns(frames: UInt8[np.ndarray, "frames bytes"], source: str) -> dict[int, Float[np.ndarray, "frames values"]]:
    """Lists of numbers in messages of one size by field, which stand at the same places in each of them."""
    fields = list(walk(frames[0].tobytes(), source))
    between = np.ones(frames.shape[1], bool)
    for field in fields:
        between[field.start : field.stop] = False
    other = np.flatnonzero((frames[:, between] != frames[0, between]).any(axis=1))
    if len(other) or any(field.wire != BYTES or (field.stop - field.start) % 8 for field in fields):
        raise _frames(source, f"frame {other[0] + 1 if len(other) else 1} has another form")
    return {one.number: np.ascontiguousarray(frames[:, one.start : one.stop]).view("<f8") for one in fields}


def _forces(
    header: B3dHeader, trial: B3dTrial, sensors: dict[int, np.ndarray], frames: np.ndarray, time: np.ndarray,
    moment_gain: Callable[[int], float], source: str,
) -> Measured:  # fmt: skip
    """What plates read, or what the first pass says of bodies; gaps where the file says that it is not known."""
    there = sensors.get(PLATES["force"], np.zeros((0, 0))).shape[1] // 3
    names = [f"plate {k + 1}" for k in range(min(trial.said.whole(7), there))]
    values, notes = _stored(sensors, PLATES, names), list[Note]()
    if not values and trial.stride > header.sensors:
        passed = _columns(frames[:, header.sensors : header.sensors + header.passes], source)
        values = _stored(passed, CONTACTS, header.said.texts(6))
        values = values if any(part["force"].any() for part in values.values()) else {}
        text = "no plates are stored; forces are those that the first pass has given to bodies"
        notes += [Note("b3d.by_body", text, source)] if values else []
    if not values:
        return None, tuple(notes), ()
    unknown = np.array((trial.said.wholes(2) + [0] * trial.frames)[: trial.frames])
    if unknown.any():
        each = Counter(REASONS[k] if k < len(REASONS) else f"reason {k}" for k in unknown[unknown > 0].tolist())
        why = listing([f"{reason} in {count}" for reason, count in each.most_common()], 6)
        text = f"forces of {(unknown > 0).sum()} of {trial.frames} frames are not known, as the file says ({why})"
        notes.append(Note("b3d.forces_unknown", f"{text}; left as gaps", source))
    if unknown.all():
        return None, tuple(notes), ()
    with np.errstate(over="ignore", invalid="ignore"):
        forces, said = _wrenches(values, time, moment_gain, source)
    forces.wrench[torch.from_numpy(unknown > 0)] = torch.nan
    plates = tuple(replace(plate, corners=_corners(trial, plate.name)) for plate in forces.plates)
    rate = f"{1.0 / (time[1] - time[0]):.10g}" if len(time) > 1 else "0"
    return replace(forces, plates=plates), (*notes, *said), (("analog_rate_hz", rate),)


def _stored(columns: dict[int, np.ndarray], fields: dict[str, int], names: list[str]) -> dict[str, dict]:
    """Force, point and torque (frames, 3) by the name of the plate or body; without those that have no number."""
    found = {}
    for k, name in enumerate(names):
        part = {kind: columns.get(number, np.zeros((0, 0)))[:, 3 * k : 3 * k + 3] for kind, number in fields.items()}
        if all(values.shape[1] == 3 and np.isfinite(values).any() for values in part.values()):
            found[name] = part
    return found


def _wrenches(
    values: dict[str, dict], time: np.ndarray, moment_gain: Callable[[int], float], source: str
) -> tuple[Forces, tuple[Note, ...]]:
    """Forces as of a MOT with these columns, moments about the origin made free ones."""
    names, columns, sets, notes = [], [], {}, []
    for name, part in values.items():
        free = part["torque"] - np.cross(part["point"], part["force"])
        if _size(free, part["force"]) < _size(part["torque"], part["force"]):
            part = part | {"torque": free}
            notes.append(Note("b3d.moments", f"moments of {name} are about the origin; free ones are made", source))
        sets[name] = {
            kind: {axis: len(columns) + 3 * k + j for j, axis in enumerate("xyz")} for k, kind in enumerate(part)
        }
        names += [f"{name} {LETTERS[kind]}{axis}" for kind in part for axis in "xyz"]
        columns += [column for rows in part.values() for column in rows.T]
    table = Storage(tuple(names), time, np.stack(columns, axis=1), notes=tuple(notes))
    return forces_of_columns(table, sets, source, moment_gain)


def _size(moment: Float[np.ndarray, "frames 3"], force: Float[np.ndarray, "frames 3"]) -> float:
    """Median size of a moment under load [N m]: feet twist little, so the smaller of two readings is the free one."""
    size = np.linalg.norm(moment, axis=1)[np.linalg.norm(force, axis=1) > SAMPLE_LOADED_N]
    size = size[np.isfinite(size)]
    return float(np.median(size)) if len(size) else 0.0


def _corners(trial: B3dTrial, name: str) -> torch.Tensor | None:
    """Corners of a plate, None where the file has none, or none of a plate."""
    stored = trial.said.doubles(8)
    corners = {f"plate {k + 1}": part for k, part in enumerate(stored[: len(stored) // 12 * 12].reshape(-1, 4, 3))}
    try:
        if name in corners and np.isfinite(corners[name]).all():
            plate_frame(corners[name])
            return torch.from_numpy(corners[name])
    except PlateProblem:
        pass
    return None
