"""Writing a trial as C3D: markers in mm, force plates of type 2 as analog channels, events, subject."""

import errno
import os
from pathlib import Path

import ezc3d
import numpy as np
from torch import Tensor

from torchid.errors import InputError
from torchid.io.c3d_header import BLOCK
from torchid.io.plates import plate_frame
from torchid.recording import Event, Forces, Plate, Trial
from torchid.storage.files import atomic_path

MILLI = 1000.0
DEPTH = 0.04
"""How far the transducers of a written plate lie below its surface [m], as in plates that are sold."""
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
UNITS = ("N", "N", "N", "Nmm", "Nmm", "Nmm")


def write_c3d(path: str | Path, trial: Trial) -> None:
    """Write a trial as C3D with 4-byte reals, whole or not at all.

    Markers become mm with residual -1 where they are NaN; the wrench of every plate becomes the six channels of a
    type 2 plate about its own transducer. The subject's name, mass and height are taken from ``trial.parameters``
    (``subject``, ``mass_kg``, ``height_m``).

    Raises:
        InputError: ``write.forces`` where the forces cannot be stored beside the markers (rate not a whole multiple,
            another start, too few samples, NaN), ``write.corners`` where a plate has none, ``results.unwritable``
            where the disk is full or the like.
    """
    file = ezc3d.c3d()
    time = trial.markers.time
    rate = trial.markers.rate if len(time) > 1 else 100.0
    first = int(round(float(time[0]) * rate)) if len(time) else 0
    if len(time) and abs(float(time[0]) * rate - first) > 1e-3:
        raise InputError(
            "write.time", "time does not start on a frame", found=f"{float(time[0]):g} s", remedy="Shift it"
        )
    file["header"]["points"]["first_frame"] = first
    _put_points(file, trial, rate)
    _put_forces(file, trial.forces, trial, rate)
    _put_events(file, trial.events)
    _put_subject(file, trial.parameters)
    with atomic_path(path) as temporary:
        file.write(str(temporary))
        _check_whole(temporary, file["data"]["points"].size + file["data"]["analogs"].size)


def _check_whole(path: Path, values: int) -> None:
    """OSError where fewer than ``values`` reals follow the parameters: ezc3d does not tell of a full disk."""
    with path.open("rb") as file:
        start = int.from_bytes(file.read(18)[16:], "little")  # word 9: the block where the data begin, from one
    # Header and parameters take a block each at least; ezc3d puts the word right when all else is written.
    if start < 3 or path.stat().st_size < (start - 1) * BLOCK + 4 * values:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _put_points(file: ezc3d.c3d, trial: Trial, rate: float) -> None:
    position = trial.markers.position.detach().cpu().numpy() * MILLI
    frames, markers = position.shape[:2]
    points = np.ones((4, markers, frames))
    points[:3] = position.transpose(2, 1, 0)
    missing = np.isnan(points[:3]).any(axis=0)
    points[:3, missing] = 0.0
    file["data"]["points"] = points
    residuals = np.where(missing, -1.0, 0.0)[None]
    file["data"]["meta_points"] = {"residuals": residuals, "camera_masks": np.zeros((7, markers, frames), dtype=bool)}
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [rate], ["mm"]
    point["LABELS"]["value"] = list(trial.markers.labels)
    for name, value in (("X_SCREEN", "+X"), ("Y_SCREEN", "+Z")):
        file.add_parameter("POINT", name, [value])


def _put_forces(file: ezc3d.c3d, forces: Forces | None, trial: Trial, rate: float) -> None:
    if forces is None or not forces.plates:
        return
    frames = len(trial.markers.time)
    ratio = max(1, round(forces.rate / rate)) if len(forces.time) > 1 else 1
    wrench = forces.wrench[: frames * ratio].detach().cpu().numpy()
    late = abs(float(forces.time[0] - trial.markers.time[0])) * rate * ratio if frames else 0.0
    uneven = abs(forces.rate / (rate * ratio) - 1.0) > 1e-6 if len(forces.time) > 1 else False
    if len(wrench) < frames * ratio or late > 1e-3 or uneven or not np.isfinite(wrench).all():
        raise InputError(
            "write.forces", "the forces do not fit beside the markers", place=f"trial {trial.name}",
            found=f"{len(forces.time)} samples at {forces.rate:g} Hz for {frames} frames at {rate:g} Hz",
            remedy="Give finite forces from the first frame on, a whole number of samples per frame",
        )  # fmt: skip
    setups = [_place(plate) for plate in forces.plates]
    channels = [_channels(wrench[:, k], *setup[:2]) for k, setup in enumerate(setups)]
    file["data"]["analogs"] = np.concatenate(channels, axis=1).T[None]
    count = len(forces.plates)
    analog = file["parameters"]["ANALOG"]
    analog["LABELS"]["value"] = [f"{name}{k + 1}" for k in range(count) for name in CHANNELS]
    analog["UNITS"]["value"] = list(UNITS) * count
    analog["RATE"]["value"] = [rate * ratio]
    _put_setup(file, [corners for *_, corners in setups])


def _place(plate: Plate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes, centre and corners of a plate; corners that would put Z up are taken in the other sense of rotation."""
    if plate.corners is None:
        raise InputError("write.corners", "a plate has no corners", place=plate.name, remedy="Give its four corners")
    corners = _numpy(plate.corners)
    R_WF, p_WF = plate_frame(corners)
    if R_WF[2, 2] > 0:
        corners = corners[[0, 3, 2, 1]]
        R_WF, p_WF = plate_frame(corners)
    return R_WF, p_WF, corners


def _channels(wrench: np.ndarray, R_WF: np.ndarray, p_WF: np.ndarray) -> np.ndarray:
    """Channels (samples, 6) [N, N mm] of a type 2 plate for a wrench on the subject about the origin of W."""
    force, origin = wrench[:, :3] @ R_WF, np.array([0.0, 0.0, -DEPTH])
    at_surface = (wrench[:, 3:] - np.cross(p_WF, wrench[:, :3])) @ R_WF
    return np.concatenate([force, (at_surface + np.cross(origin, force)) * MILLI], axis=1)


def _put_setup(file: ezc3d.c3d, corners: list[np.ndarray]) -> None:
    count = len(corners)
    group = file["parameters"]["FORCE_PLATFORM"]
    values = {
        "USED": (2, np.array([count])),
        "TYPE": (2, np.full(count, 2)),
        "CHANNEL": (2, np.arange(1, 6 * count + 1).reshape(count, 6).T),
        "ZERO": (2, np.array([1, 0])),
        "CORNERS": (4, np.stack([c.T for c in corners], axis=2) * MILLI),
        "ORIGIN": (4, np.tile([[0.0], [0.0], [-DEPTH * MILLI]], (1, count))),
    }
    for name, (kind, value) in values.items():
        # Without the type, integers would be written as reals, which readers of plates do not accept.
        group[name] = {"type": kind, "description": "", "is_locked": False, "value": value}


def _put_events(file: ezc3d.c3d, events: tuple[Event, ...]) -> None:
    if not events:
        return
    file.add_parameter("EVENT", "USED", [len(events)])
    file.add_parameter("EVENT", "CONTEXTS", [event.side for event in events])
    file.add_parameter("EVENT", "LABELS", [event.label for event in events])
    minutes = np.array([[event.time // 60.0, event.time % 60.0] for event in events]).T
    file.add_parameter("EVENT", "TIMES", minutes)


def _put_subject(file: ezc3d.c3d, parameters: dict[str, str]) -> None:
    if "subject" in parameters:
        file.add_parameter("SUBJECTS", "USED", [1])
        file.add_parameter("SUBJECTS", "NAMES", [parameters["subject"]])
    for key, name, factor in (("mass_kg", "Bodymass", 1.0), ("height_m", "Height", MILLI)):
        if key in parameters:
            file.add_parameter("PROCESSING", name, [float(parameters[key]) * factor])


def _numpy(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy().astype(float)
