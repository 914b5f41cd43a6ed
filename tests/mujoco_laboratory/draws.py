"""Random effects of a size: place, sign and direction."""

import math
from collections.abc import Callable

import numpy as np

from mujoco_laboratory.body import MARKERS, sided
from mujoco_laboratory.sizes import FIT, HELDOUT, LEVELS, SIZES

Draw = np.random.Generator
Drawn = tuple[list[str], list[dict] | None, dict]
PLATES = tuple(f"plate_{k}" for k in (1, 2, 3, 4))
CARRIERS = ("pelvis", "abdomen", "thorax", "head", "upper_arm_l", "upper_arm_r", "forearm_l", "forearm_r", "thigh_l",
            "thigh_r", "shank_l", "shank_r")  # fmt: skip
SKIN = {"thigh": ("hip", ("?THI", "?THF", "?KNE", "?KNM")), "shank": ("knee", ("?TIB", "?TIF")),
        "upper_arm": ("shoulder", ("?UPA", "?ELB", "?ELM"))}  # fmt: skip
"""Joint whose flexion moves the skin, and the markers on it."""
CABLES = (("plate_1", "plate_2"), ("plate_1", "plate_3"), ("plate_2", "plate_4"), ("plate_2", "plate_3"))
LABELS = (("LASI", "LPSI"), ("RWRA", "RWRB"), ("LKNE", "LKNM"), ("LHAR", "LHAU"), ("RMT1", "RMT5"), ("LANK", "RANM"))
ONE_TRIAL_S = 0.004
"""Lag of a single trial that is just detectable."""


def draw_effect(name: str, level: str, rng: Draw) -> dict:
    """An effect of the size ``small``, ``medium`` (the geometric mean) or ``large`` at a random place.

    ``body_mass`` is drawn as ``excess_kg``, true less recorded, since the person is not known yet.
    """
    size = {key: float(a * (b / a) ** LEVELS[level]) for key, (a, b) in SIZES[name].items()}
    where, when, parameters = DRAWS[name](rng, size)
    return {"effect": name, "where": where, "when": when, "parameters": parameters}


def _direction(rng: Draw) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def _sign(rng: Draw) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _pick(rng: Draw, *names: str) -> str:
    return str(rng.choice(names))


def _loaded(rng: Draw) -> list[str]:
    """One of the plates on which the person mostly stands."""
    return [_pick(rng, *PLATES[:2])]


def _interval(rng: Draw, seconds: float) -> list[dict]:
    t0 = float(rng.uniform(1.5, 9.0 - seconds))
    return [{"trial": _pick(rng, *FIT), "t0": round(t0, 2), "t1": round(t0 + seconds, 2)}]


def _vector(*keys: str, at: Callable[[Draw], list[str]]) -> Callable[..., Drawn]:
    """Vectors of their sizes, each in its own direction."""
    return lambda rng, size: (at(rng), None, {key: (size[key] * _direction(rng)).tolist() for key in keys})


def _scalar(key: str, at: Callable[[Draw], list[str]]) -> Callable[..., Drawn]:
    return lambda rng, size: (at(rng), None, {key: size[key]})


def _near_one(key: str, at: Callable[[Draw], list[str]]) -> Callable[..., Drawn]:
    return lambda rng, size: (at(rng), None, {key: 1.0 + _sign(rng) * size[key]})


def _one_of(*names: str) -> Callable[[Draw], list[str]]:
    return lambda rng: [_pick(rng, *names)]


def _time_offset(rng: Draw, size: dict) -> Drawn:
    """Of one trial, just detectable is larger: of 10 s of slow motion, the lag has a standard deviation of 1-2 ms."""
    if rng.random() < 0.7:
        return ["session"], None, {"lag_s": _sign(rng) * size["lag_s"]}
    small, large = SIZES["time_offset"]["lag_s"]
    level = math.log(size["lag_s"] / small) / math.log(large / small)
    return [_pick(rng, *FIT)], None, {"lag_s": _sign(rng) * ONE_TRIAL_S * (large / ONE_TRIAL_S) ** level}


def _plate_drift(rng: Draw, size: dict) -> Drawn:
    rate = size["rate_plate"] * np.concatenate([_direction(rng), 0.2 * _direction(rng)])
    return _loaded(rng), None, {"rate_plate": rate.tolist()}


def _plate_crosstalk(rng: Draw, size: dict) -> Drawn:
    """Some channels leak; moments are of the order of 0.2 m times forces."""
    unit = np.diag([1.0] * 3 + [0.2] * 3)
    matrix = size["matrix_plate"] * rng.uniform(-1.0, 1.0, (6, 6)) * (rng.random((6, 6)) < 0.4)
    matrix[int(rng.integers(2)), 2] = _sign(rng) * size["matrix_plate"]
    np.fill_diagonal(matrix, 0.0)
    return _loaded(rng), None, {"matrix_plate": (unit @ matrix @ np.linalg.inv(unit)).tolist()}


def _gravity_tilt(rng: Draw, size: dict) -> Drawn:
    turn = rng.uniform(0.0, 2.0 * np.pi)
    tilt = size["tilt_rad"] * np.array([np.cos(turn), np.sin(turn)])
    return ["session"], None, {"roll_rad": float(tilt[0]), "pitch_rad": float(tilt[1])}


def _payload(rng: Draw, size: dict) -> Drawn:
    light = size["mass_kg"] <= 4.0
    segment = _pick(rng, *(CARRIERS if light else ("pelvis", "thorax")))
    high = {"pelvis": 0.05, "abdomen": 0.05, "thorax": 0.16, "head": 0.12}.get(segment, -0.13)
    point = np.array([rng.choice([-1.0, 1.0]) * 0.09, rng.uniform(-0.06, 0.06), high + rng.uniform(-0.04, 0.04)])
    return [segment], None, {"mass_kg": size["mass_kg"], "point_seg_m": point.tolist()}


def _grasped_object(rng: Draw, size: dict) -> Drawn:
    parameters = {"mass_kg": size["mass_kg"], "point_seg_m": [float(rng.uniform(-0.02, 0.02)), 0.0, -0.08]}
    return [_pick(rng, "hand_l", "hand_r")], _interval(rng, rng.uniform(2.0, 5.0)), parameters


def _unmeasured_contact(rng: Draw, size: dict) -> Drawn:
    segment = _pick(rng, "hand_l", "hand_r", "pelvis", "thorax", "thigh_l")
    when = _interval(rng, rng.uniform(0.6, 2.5))
    force = size["force_N"] * _direction(rng)
    force[2] = abs(force[2])
    impulse = force * (when[0]["t1"] - when[0]["t0"])
    return [segment], when, {"force_N": force.tolist(), "impulse_Ns": impulse.tolist()}


def _tether(rng: Draw, size: dict) -> Drawn:
    turn, away = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(1.0, 2.0)
    anchor = [away * np.cos(turn), away * np.sin(turn), rng.uniform(0.6, 1.6)]
    rest = 0.0 if rng.random() < 0.5 else rng.uniform(0.3, 0.7) * away
    parameters = {"stiffness_N_m": size["stiffness_N_m"], "anchor_m": anchor, "rest_m": float(rest)}
    return [_pick(rng, "pelvis", "thorax")], None, parameters


def _wobbling_mass(rng: Draw, size: dict) -> Drawn:
    segment = _pick(rng, "thorax", "abdomen", "thigh_l", "thigh_r")
    mass = size["mass_kg"] if segment == "thorax" else min(size["mass_kg"], 2.5)
    own = {"frequency_hz": float(rng.uniform(2.5, 6.0)), "damping_ratio": float(rng.uniform(0.1, 0.3))}
    return [segment], None, {"mass_kg": mass} | own


def _moving_ground(rng: Draw, size: dict) -> Drawn:
    frequency = float(np.exp(rng.uniform(np.log(0.6), np.log(5.0))))
    own = {"frequency_hz": frequency, "direction": _direction(rng).tolist()}
    return ["session"], None, {"rms_m_s2": size["rms_m_s2"]} | own


def _marker_shift(rng: Draw, size: dict) -> Drawn:
    """From some trial of the fit on, as if a marker had fallen off and been put back."""
    first = int(rng.integers(1, len(FIT)))
    when = [{"trial": trial, "t0": 0.0, "t1": 10.0} for trial in (FIT + HELDOUT)[first:]]
    labels = (p.replace("?", s) for p in MARKERS for s in (("L", "R") if "?" in p else ("",)))
    return [_pick(rng, *labels)], when, {"shift_seg_m": (size["shift_seg_m"] * _direction(rng)).tolist()}


def _skin_lag(rng: Draw, size: dict) -> Drawn:
    """Flesh under all markers, softer here and stiffer there."""
    segments = list(dict.fromkeys(sided(part, side) for part, *_ in MARKERS.values() for side in ("_l", "_r")))
    shifts = size["shift_1g_m"] * np.exp(0.3 * rng.normal(size=len(segments)))
    return segments, None, {"shift_1g_m": dict(zip(segments, shifts.tolist(), strict=True))}


def _marker_swap(rng: Draw, size: dict) -> Drawn:
    when = _interval(rng, size["duration_s"])
    return list(LABELS[int(rng.integers(len(LABELS)))]), when, {}


def _soft_tissue(rng: Draw, size: dict) -> Drawn:
    """Markers of a segment slide mostly together."""
    part, side = _pick(rng, *SKIN), _pick(rng, "l", "r")
    joint, patterns = SKIN[part]
    common = _direction(rng)
    shifts = {p.replace("?", side.upper()): 0.8 * common + 0.6 * _direction(rng) for p in patterns}
    found = {label: (size["shift_90_m"] * v).tolist() for label, v in shifts.items()}
    return [f"{part}_{side}"], None, {"shift_90_m": found, "joint": f"{joint}_{side}_flexion"}


def _missing_dof(rng: Draw, size: dict) -> Drawn:
    joint = _pick(rng, "knee_l", "knee_r", "elbow_l", "elbow_r")
    if rng.random() < 0.6:
        return [joint], None, {"axis_seg": [1.0, 0.0, 0.0], "range_rad": size["range_rad"]}
    return [joint], None, {"direction_seg": _direction(rng).tolist(), "range_m": size["range_m"]}


def _inner_motion(rng: Draw, size: dict) -> Drawn:
    own = {"mass_kg": 4.0, "frequency_hz": float(rng.uniform(0.5, 1.8)), "direction_seg": _direction(rng).tolist()}
    return [_pick(rng, "head", "thorax", "abdomen")], None, {"amplitude_m": size["amplitude_m"]} | own


def _magnet(rng: Draw, size: dict) -> Drawn:
    centre = [float(rng.uniform(0.4, 0.7)), float(rng.uniform(-0.4, 0.4)), float(rng.uniform(0.8, 1.4))]
    return [_pick(rng, "hand_l", "hand_r", "thorax")], None, {"force_N": size["force_N"], "centre_m": centre}


def _motor(rng: Draw, size: dict) -> Drawn:
    own = {"frequency_hz": float(rng.uniform(4.0, 9.0))}
    return [_pick(rng, "pelvis", "thorax", "thigh_r")], None, {"force_N": size["force_N"]} | own


SESSION, TRUNK = _one_of("session"), _one_of("pelvis", "thorax")
DRAWS: dict[str, Callable[..., Drawn]] = {
    "time_offset": _time_offset,
    "body_lag": _scalar("lag_s", SESSION),
    "filter_lag": _scalar("cutoff_hz", SESSION),
    "plate_gain": _near_one("gain", lambda rng: list(PLATES) if rng.random() < 0.25 else _loaded(rng)),
    "plate_offset": _vector("force_plate_N", "moment_plate_Nm", at=_loaded),
    "plate_drift": _plate_drift,
    "plate_pose": _vector("shift_m", "rotation_rad", at=_loaded),
    "plate_crosstalk": _plate_crosstalk,
    "plate_assignment": lambda rng, size: (list(CABLES[int(rng.integers(len(CABLES)))]), None, {}),
    "gravity_tilt": _gravity_tilt,
    "body_mass": lambda rng, size: (["session"], None, {"excess_kg": _sign(rng) * size["excess_kg"]}),
    "payload": _payload,
    "grasped_object": _grasped_object,
    "unmeasured_contact": _unmeasured_contact,
    "external_force": _vector("force_N", at=TRUNK),
    "body_weight_support": _scalar("force_N", TRUNK),
    "tether": _tether,
    "drag": _scalar("coefficient_Ns_m", TRUNK),
    "wobbling_mass": _wobbling_mass,
    "flywheel": _vector("momentum_seg_Nms", at=_one_of("pelvis", "thorax", "head")),
    "moving_ground": _moving_ground,
    "marker_shift": _marker_shift,
    "marker_swap": _marker_swap,
    "marker_scale": _near_one("scale", SESSION),
    "soft_tissue": _soft_tissue,
    "skin_lag": _skin_lag,
    "missing_dof": _missing_dof,
    "joint_centre_shift": _vector("shift_90_seg_m", at=_one_of("knee_l", "knee_r", "elbow_l", "hip_r", "shoulder_l")),
    "offcat_water": _scalar("coefficient_Ns2_m2", _one_of("hand_l", "hand_r")),
    "offcat_magnet": _magnet,
    "offcat_inner_motion": _inner_motion,
    "offcat_motor": _motor,
    "offcat_hysteresis": lambda rng, size: (_loaded(rng), None, {"loop_N": size["loop_N"], "width_N": 60.0}),
    "offcat_saturation": _scalar("limit_part", _loaded),
}
