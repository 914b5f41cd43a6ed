"""Effects on the body and on gravity: masses that it carries, freedoms of joints, ground that moves.

An effect is a dict with ``effect``, ``where`` (list), ``when`` (None or a list of {trial, t0, t1}) and ``parameters``.
Vectors are in W, ``_seg`` in the axes of the segment (of slides and gliding centres: of the joint's parent).
"""

from collections.abc import Callable

import mujoco
import numpy as np

from mujoco_laboratory.body import JOINTS, Person
from mujoco_laboratory.intent import Script, smooth, wander, with_angle
from mujoco_laboratory.physics import GRAVITY, Extra

Entry = dict
"""An effect."""
MINUTE = 60.0
"""Between the starts of trials [s]."""


def segment_of(joint: str) -> str:
    """The segment that a joint carries."""
    stem, side = (joint[:-2], joint[-2:]) if joint[-2:] in ("_l", "_r") else (joint, "")
    return next(part for part, name in JOINTS.items() if name == stem) + side


def extra(person: Person, effects: list[Entry]) -> Extra:
    """What effects add to the body."""
    payloads, lighter, joints = [], {}, []
    for e in effects:
        p = e["parameters"]
        if e["effect"] == "payload":
            payloads.append((e["where"][0], p["mass_kg"], np.array(p["point_seg_m"])))
        elif e["effect"] == "wobbling_mass":
            lighter[e["where"][0]] = lighter.get(e["where"][0], 0.0) + p["mass_kg"]
        elif e["effect"] == "missing_dof":
            kind, key = ("slide", "direction_seg") if "direction_seg" in p else ("hinge", "axis_seg")
            joints.append((segment_of(e["where"][0]), _name(e), kind, np.array(p[key])))
        elif e["effect"] == "joint_centre_shift":
            own = segment_of(e["where"][0])
            joints += [(own, f"{_name(e)}_{c}", "slide", axis) for c, axis in zip("xyz", np.eye(3), strict=True)]
    for name, mass in lighter.items():
        assert mass < 0.8 * person.segments[name].mass, f"{name} has only {person.segments[name].mass:.2f} kg"
    return Extra(tuple(payloads), lighter, tuple(joints))


def _name(entry: Entry) -> str:
    return f"{entry['effect']}_{entry['where'][0]}"


def moving(script: Script, effects: list[Entry], seed: tuple[int, ...]) -> Script:
    """The script with the courses of freedoms that no model has; ``range`` is from the least to the largest value."""
    for k, e in enumerate(effects):
        if e["effect"] == "missing_dof":
            size = e["parameters"].get("range_m", e["parameters"].get("range_rad"))
            course = wander(np.random.default_rng((*seed, k)), script.time, -size / 2, size / 2, (0.25, 1.2))
            script = with_angle(script, _name(e), course * smooth(script.time / 1.2))
    return script


def gliding(model: mujoco.MjModel, effects: list[Entry]) -> Callable[[np.ndarray], np.ndarray]:
    """Moves joint centres that glide with flexion: by ``shift_90_seg_m`` times (1 - cos) of the angle."""
    rows = []
    for e in (e for e in effects if e["effect"] == "joint_centre_shift"):
        at = [model.joint(f"{_name(e)}_{c}").qposadr[0] for c in "xyz"]
        angle = model.joint(f"{e['where'][0]}_flexion").qposadr[0]
        rows.append((at, angle, np.array(e["parameters"]["shift_90_seg_m"])))

    def glide(q: np.ndarray) -> np.ndarray:
        for at, angle, shift in rows:
            q[:, at] = (1.0 - np.cos(q[:, angle]))[:, None] * shift
        return q

    return glide


def gravity(effects: list[Entry], time: np.ndarray, trial: int, seed: int) -> np.ndarray:
    """Gravity less the acceleration of the ground (frames, 3) [m/s^2].

    The vertical is the z axis of W pitched about y, then rolled about x; the ground shakes on through the session.
    """
    pull = np.tile([0.0, 0.0, -GRAVITY], (len(time), 1))
    for e in effects:
        p = e["parameters"]
        if e["effect"] == "gravity_tilt":
            roll, pitch = p["roll_rad"], p["pitch_rad"]
            up = [np.sin(pitch), -np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
            pull += GRAVITY * (np.array([0.0, 0.0, 1.0]) - up)
        elif e["effect"] == "moving_ground":
            clock = time + MINUTE * trial + np.random.default_rng((seed, trial, 77)).uniform(0.0, MINUTE)
            wave = np.sqrt(2.0) * p["rms_m_s2"] * np.sin(2.0 * np.pi * p["frequency_hz"] * clock)
            pull -= wave[:, None] * np.array(p.get("direction", [0.0, 0.0, 1.0]))
    return pull
