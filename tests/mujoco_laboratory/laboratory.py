"""What the laboratory does: plates that bear the feet, cameras, noise, gaps, and a C3D file of all that."""

from dataclasses import dataclass, replace
from pathlib import Path

import ezc3d
import numpy as np
from scipy.interpolate import make_interp_spline

from mujoco_laboratory.intent import Script
from mujoco_laboratory.motion import PENDULUM, pressure
from mujoco_laboratory.physics import RATE

ANALOG_RATIO = 10
"""Samples of the plates per frame."""
MARKER_NOISE, FORCE_NOISE, MOMENT_NOISE = 1e-3, 2.0, 0.4
"""Of a coordinate [m], and of a plate's force [N] and moment about its centre [N m] averaged over a frame."""
GAPS = 0.02
"""Share of the samples of markers that is lost."""
BURST = (5, 40)
"""Length of a gap [frames]."""
LENGTH, WIDTH, SLIT, BORDER = 0.60, 0.46, 0.005, 0.10
"""Of the plates along x and y, between them, and x of the border between the plates behind and in front [m]."""
DEPTH = 0.043
"""Of the transducers below the surface [m]."""
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True)
class Plate:
    """A force plate as the file describes it: x along its first edge (second to first corner), z up."""

    centre: np.ndarray
    """(3,) [m]"""
    R: np.ndarray
    """Its axes in W (3, 3)."""
    half: tuple[float, float]
    """Half its lengths along its own x and y [m]."""

    def corners(self) -> np.ndarray:
        """In the order of C3D, whose plate has its z down (4, 3) [m]."""
        a, b = self.half
        return self.centre + np.array([[a, -b, 0], [-a, -b, 0], [-a, b, 0], [a, b, 0]]) @ self.R.T


@dataclass(frozen=True)
class Recording:
    """A trial as it is measured."""

    labels: tuple[str, ...]
    markers: np.ndarray
    """(frames, markers, 3), NaN where lost [m]."""
    clock: np.ndarray
    """Of the plates [s]."""
    own: np.ndarray
    """What each plate reads, in its axes about its centre (samples, plates, 6) [N, N m]."""


def lay_plates(rng: np.random.Generator) -> tuple[Plate, ...]:
    """Left and right behind the border, then left and right in front of it; each is turned about z at random."""
    plates = []
    for k in range(4):
        x = BORDER + (-0.5 if k < 2 else 0.5) * (LENGTH + SLIT)
        y = (0.5 if k % 2 == 0 else -0.5) * (WIDTH + SLIT)
        quarter = int(rng.integers(4))
        c, s = np.round([np.cos(quarter * np.pi / 2), np.sin(quarter * np.pi / 2)])
        half = (LENGTH / 2, WIDTH / 2) if quarter % 2 == 0 else (WIDTH / 2, LENGTH / 2)
        plates.append(Plate(np.array([x, y, 0.0]), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), half))
    return tuple(plates)


def share_load(script: Script, wrench: np.ndarray) -> np.ndarray:
    """Wrench on each foot about the origin of W (frames, 2, 6); their sum is exact.

    The feet share force and free moment as intended; by what the centre of pressure misses, both bear elsewhere. Part
    of the way, each foot's force leans to the centre of mass between them, as in a wide stance: sideways pushes that
    cancel in the sum.
    """
    share = np.stack([script.share, 1.0 - script.share], 1)[:, :, None]
    point = np.zeros((len(wrench), 2, 3))
    point[:, :, :2] = script.bearing + (pressure(wrench) - script.pressure)[:, None]
    apart = point[:, 0] - point[:, 1]
    press = script.press[:, None] * share[:, 0] * share[:, 1] * wrench[:, 2:3] * apart / PENDULUM
    force = share * wrench[:, None, :3] + np.stack([-press, press], 1)
    free = wrench[:, 3:] - np.cross(point, force).sum(1)
    return np.concatenate([force, np.cross(point, force) + share * free[:, None]], 2)


def stand_on(feet: np.ndarray, script: Script) -> np.ndarray:
    """Wrench on each of four plates about the origin of W (frames, 4, 6)."""
    out = np.zeros((len(feet), 4, 6))
    for side in (0, 1):
        front = script.ankles[side][:, 0] > BORDER
        for row, here in ((side, ~front), (2 + side, front)):
            out[:, row] += feet[:, side] * here[:, None]
    return out


def resample(time: np.ndarray, wrench: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """Wrenches (frames, plates, 6) at other times, by a cubic spline."""
    return make_interp_spline(time, wrench, k=3)(clock)


def to_plate(plate: Plate, wrench: np.ndarray) -> np.ndarray:
    """A wrench (samples, 6) about the origin of W, about the plate's centre and in its axes."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    return np.concatenate([force @ plate.R, (moment - np.cross(plate.centre, force)) @ plate.R], 1)


def with_noise(rng: np.random.Generator, recording: Recording) -> Recording:
    """White noise on every coordinate and channel."""
    sd = np.array([FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3) * np.sqrt(ANALOG_RATIO)
    markers = recording.markers + MARKER_NOISE * rng.normal(size=recording.markers.shape)
    return replace(recording, markers=markers, own=recording.own + sd * rng.normal(size=recording.own.shape))


def with_gaps(rng: np.random.Generator, markers: np.ndarray) -> np.ndarray:
    """Markers lost in bursts, NaN."""
    lost = np.zeros(markers.shape[:2], bool)
    while lost.mean() < GAPS:
        start = int(rng.integers(-BURST[0], len(lost)))
        lost[max(start, 0) : max(start + int(rng.integers(*BURST)), 0), int(rng.integers(lost.shape[1]))] = True
    return np.where(lost[:, :, None], np.nan, markers)


def write_c3d(path: Path, recording: Recording, plates: tuple[Plate, ...]) -> None:
    """Markers in mm, plates of type 2."""
    file = ezc3d.c3d()
    markers = 1e3 * recording.markers.transpose(2, 1, 0)
    lost = np.isnan(markers).any(0)
    points = np.ones((4, *lost.shape))
    points[:3] = np.where(lost, 0.0, markers)
    file["data"]["points"] = points
    masks = np.zeros((7, *lost.shape), bool)
    file["data"]["meta_points"] = {"residuals": np.where(lost, -1.0, 0.0)[None], "camera_masks": masks}
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [RATE], ["mm"]
    point["LABELS"]["value"] = list(recording.labels)
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    _put_plates(file, recording, plates)
    file.write(str(path))


def _put_plates(file: ezc3d.c3d, recording: Recording, plates: tuple[Plate, ...]) -> None:
    count = len(plates)
    file["data"]["analogs"] = np.concatenate([_channels(recording.own[:, k]) for k in range(count)], 1).T[None]
    analog = file["parameters"]["ANALOG"]
    analog["LABELS"]["value"] = [f"{name}{k + 1}" for k in range(count) for name in CHANNELS]
    analog["UNITS"]["value"] = ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * count
    analog["RATE"]["value"] = [RATE * ANALOG_RATIO]
    values = {
        "USED": (2, np.array([count])),
        "TYPE": (2, np.full(count, 2)),
        "CHANNEL": (2, np.arange(1, 6 * count + 1).reshape(count, 6).T),
        "ZERO": (2, np.array([1, 0])),
        "CORNERS": (4, 1e3 * np.stack([plate.corners().T for plate in plates], 2)),
        "ORIGIN": (4, np.tile([[0.0], [0.0], [-1e3 * DEPTH]], (1, count))),
    }
    for name, (kind, value) in values.items():
        file["parameters"]["FORCE_PLATFORM"][name] = {
            "type": kind, "description": "", "is_locked": False, "value": value,
        }  # fmt: skip


def _channels(own: np.ndarray) -> np.ndarray:
    """Channels [N, N mm] about the transducer: the file's plate has its y and z the other way round."""
    turned = own * [1.0, -1.0, -1.0, 1.0, -1.0, -1.0]
    below = np.array([0.0, 0.0, -DEPTH])
    moment = turned[:, 3:] + np.cross(below, turned[:, :3])
    return np.concatenate([turned[:, :3], 1e3 * moment], 1)
