"""Effects on what cameras and plates make of a trial."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

from mujoco_laboratory.hidden_body import Entry
from mujoco_laboratory.hidden_forces import Scene
from mujoco_laboratory.laboratory import ANALOG_RATIO, Plate
from mujoco_laboratory.physics import GRAVITY, RATE, derivative

KNEE = 15.0
"""Over which a saturating plate bends [N]."""


def lag(effects: list[Entry], trial: str) -> float:
    """By how much forces come late in a trial [s]."""
    own = [e for e in effects if e["effect"] in ("time_offset", "body_lag") and {"session", trial} & set(e["where"])]
    return sum(e["parameters"]["lag_s"] for e in own)


def true_plates(effects: list[Entry], plates: tuple[Plate, ...]) -> tuple[Plate, ...]:
    """Where the plates are, for where the file has them: turned and shifted about their centres, in W."""
    found = list(plates)
    for e in (e for e in effects if e["effect"] == "plate_pose"):
        p = e["parameters"]
        for k in _plates(e):
            turn = Rotation.from_rotvec(p["rotation_rad"]).as_matrix()
            found[k] = replace(found[k], centre=found[k].centre + p["shift_m"], R=turn @ found[k].R)
    return tuple(found)


def misread(effects: list[Entry], clock: np.ndarray, own: np.ndarray, mass: float) -> np.ndarray:
    """What plates read of wrenches (samples, plates, 6) in their axes about their centres; ``mass`` [kg] is the body's.

    Each reads on its own first; swapped cables come last.
    """
    own = own.copy()
    for e in effects:
        for k in _plates(e):
            if e["effect"] in MAPS:
                own[:, k] = MAPS[e["effect"]](own[:, k], clock, e["parameters"], mass)
    for e in (e for e in effects if e["effect"] == "plate_assignment"):
        a, b = _plates(e)
        own[:, [a, b]] = own[:, [b, a]]
    return own


def _plates(entry: Entry) -> list[int]:
    return [int(name.removeprefix("plate_")) - 1 for name in entry["where"] if name.startswith("plate_")]


def _gain(own: np.ndarray, clock: np.ndarray, p: dict, mass: float) -> np.ndarray:
    return p["gain"] * own


def _offset(own: np.ndarray, clock: np.ndarray, p: dict, mass: float) -> np.ndarray:
    return own + np.concatenate([p["force_plate_N"], p["moment_plate_Nm"]])


def _drift(own: np.ndarray, clock: np.ndarray, p: dict, mass: float) -> np.ndarray:
    """Zeroed where the trial begins."""
    return own + (clock - clock[0])[:, None] * np.array(p["rate_plate"])


def _crosstalk(own: np.ndarray, clock: np.ndarray, p: dict, mass: float) -> np.ndarray:
    return own + own @ np.array(p["matrix_plate"]).T


def _hysteresis(own: np.ndarray, clock: np.ndarray, p: dict, mass: float) -> np.ndarray:
    """The vertical force follows one branch while it grows and another while it falls."""
    change = np.diff(own[:, 2], prepend=own[0, 2])
    left, sign = np.exp(-np.abs(change) / p["width_N"]), np.sign(change)
    branch, state = np.zeros(len(own)), 0.0
    for k in range(len(own)):
        state = sign[k] + (state - sign[k]) * left[k] if sign[k] else state
        branch[k] = state
    read = own.copy()
    read[:, 2] -= p["loop_N"] * branch
    return read


def _saturation(own: np.ndarray, clock: np.ndarray, p: dict, mass: float) -> np.ndarray:
    """The vertical force bends off at a part of the body's weight."""
    read = own.copy()
    read[:, 2] -= KNEE * np.logaddexp(0.0, (own[:, 2] - p["limit_part"] * mass * GRAVITY) / KNEE)
    return read


MAPS: dict[str, Callable[[np.ndarray, np.ndarray, dict, float], np.ndarray]] = {
    "plate_gain": _gain, "plate_offset": _offset, "plate_drift": _drift, "plate_crosstalk": _crosstalk,
    "offcat_hysteresis": _hysteresis, "offcat_saturation": _saturation,
}  # fmt: skip


def displaced(
    effects: list[Entry], scene: Scene, labels: tuple[str, ...], markers: np.ndarray, angle: Callable
) -> np.ndarray:
    """Markers (frames, markers, 3) that slide on their segments; ``angle`` gives a joint's coordinate (frames,)."""
    markers = markers.copy()
    for e in effects:
        p = e["parameters"]
        if e["effect"] == "marker_shift" and _in_trial(e, scene.trial) is not None:
            _slide(scene, labels, markers, e["where"][0], np.array(p["shift_seg_m"])[None])
        elif e["effect"] == "soft_tissue":
            for label, shift in p["shift_90_m"].items():
                _slide(scene, labels, markers, label, np.sin(angle(p["joint"]))[:, None] * np.array(shift))
        elif e["effect"] == "skin_lag":
            own = np.array([p["shift_1g_m"][scene.person.markers[label].segment] for label in labels])
            markers -= own[:, None] / GRAVITY * derivative(scene.moved.markers, 2)
    return markers


def _slide(scene: Scene, labels: tuple[str, ...], markers: np.ndarray, label: str, shift: np.ndarray) -> None:
    """Move a marker in place by a shift in its segment's axes (frames or 1, 3)."""
    R = scene.moved.R[:, scene.moved.names[scene.person.markers[label].segment]]
    markers[:, labels.index(label)] += np.einsum("tij,tj->ti", R, np.broadcast_to(shift, (len(R), 3)))


def processed(effects: list[Entry], trial: str, labels: tuple[str, ...], markers: np.ndarray) -> np.ndarray:
    """What the cameras' software makes of the markers of a trial: labels, smoothing, scale, in that order."""
    markers = markers.copy()
    for e in (e for e in effects if e["effect"] == "marker_swap"):
        interval = _in_trial(e, trial)
        if interval is not None:
            rows = slice(round(interval["t0"] * RATE), round(interval["t1"] * RATE) + 1)
            a, b = (labels.index(label) for label in e["where"])
            markers[rows, [a, b]] = markers[rows, [b, a]]
    for e in (e for e in effects if e["effect"] == "filter_lag"):
        markers = filtfilt(*butter(2, e["parameters"]["cutoff_hz"], fs=RATE), markers, axis=0)
    for e in (e for e in effects if e["effect"] == "marker_scale"):
        markers = e["parameters"]["scale"] * markers
    return markers


def _in_trial(entry: Entry, trial: str) -> dict | None:
    """The effect's interval in a trial; an effect without intervals is in every trial, the static one included."""
    if entry.get("when") is None:
        return {"trial": trial, "t0": 0.0, "t1": 1e9}
    return next((w for w in entry["when"] if w["trial"] == trial), None)


def clock_of(frames: int) -> np.ndarray:
    """Times of the plates' samples [s]."""
    return np.arange(frames * ANALOG_RATIO) / (RATE * ANALOG_RATIO)
