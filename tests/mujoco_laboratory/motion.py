"""From intention to motion: feet planted, and the pelvis where the centre of pressure comes out as intended."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.linalg import solve_banded
from scipy.spatial.transform import Rotation

from mujoco_laboratory.body import SIDES
from mujoco_laboratory.intent import Script
from mujoco_laboratory.legs import Glide, chain, plant
from mujoco_laboratory.physics import GRAVITY, RATE, Moved, inverse

ROUNDS = 5
CLOSE = 0.004
"""Miss of the centre of pressure that is good enough [m]."""
PENDULUM = 0.95
"""Height of the centre of mass for the search of balance [m]."""
SOFT, SOFT_STEPS = 0.004, 0.035
"""Over which the higher leg gives way to the lower one as the one that limits the pelvis, and with steps [m]."""
TOLERANCE = 5e-4
"""Largest part of the weight, and that times a metre, by which wrench and momentum may disagree in a trial."""
STILL = 1e-6
"""By which a planted foot may miss its place in MuJoCo [m]."""
Load = Callable[[Moved], np.ndarray]
"""Wrench (frames, 6) about the origin of W that the ground must supply besides what the motion needs."""


@dataclass(frozen=True)
class Balanced:
    """A motion in balance."""

    moved: Moved
    wrench: np.ndarray
    """From the ground, all loads included, about the origin of W (frames, 6)."""
    q: np.ndarray
    miss: float
    """Largest distance of the centre of pressure from the one intended [m]."""


def balance(model: mujoco.MjModel, script: Script, gravity: np.ndarray, glide: Glide, load: Load) -> Balanced:
    """Move the pelvis until the centre of pressure is about where the script wants it.

    Raises:
        RuntimeError: a foot is out of reach, or wrench and momentum disagree, as where a motion is too sudden.
    """
    place = lag_behind(script.pressure)
    place -= [0.02, 0.0]
    q = None
    for _ in range(ROUNDS):
        q = _positions(model, script, place, glide, q)
        moved = inverse(model, script.time, q, gravity)
        _assert_planted(moved, script)
        wrench = moved.wrench + load(moved)
        miss = pressure(wrench) - script.pressure
        if np.abs(miss).max() < CLOSE:
            break
        # Where a part of the weight is carried elsewhere, the same shift of the body moves the pressure further.
        carried = np.clip(wrench[:, 2:3] / (moved.mass * GRAVITY), 0.2, 1.0)
        place = place - lag_behind(miss * carried)
    assert q is not None
    if moved.miss > TOLERANCE:
        raise RuntimeError(f"wrench and momentum disagree by {moved.miss:.2g} of the weight")
    return Balanced(moved, wrench, q, float(np.linalg.norm(miss, axis=1).max()))


def pressure(wrench: np.ndarray) -> np.ndarray:
    """Centre of pressure on the floor (frames, 2) [m]."""
    return np.stack([-wrench[:, 4], wrench[:, 3]], 1) / wrench[:, 2:3]


def lag_behind(path: np.ndarray) -> np.ndarray:
    """Centre of mass whose centre of pressure is ``path``: an inverted pendulum, x - (h / g) x'' = path."""
    k = PENDULUM / GRAVITY * RATE**2
    band = np.tile([[-k], [1.0 + 2.0 * k], [-k]], len(path))
    band[1, [0, -1]] = 1.0 + k
    return solve_banded((1, 1), band, path)


def _positions(
    model: mujoco.MjModel, script: Script, place: np.ndarray, glide: Glide, warm: np.ndarray | None
) -> np.ndarray:
    """MuJoCo positions for the pelvis at ``place`` (frames, 2)."""
    q = np.tile(model.qpos0, (len(place), 1)) if warm is None else warm.copy()
    turn = Rotation.from_rotvec(script.pelvis)
    q[:, 3:7] = turn.as_quat()[:, [3, 0, 1, 2]]
    q[:, :2] = place
    q[:, 2] = _height(model, script, place, turn)
    for joint, values in script.angles.items():
        q[:, model.joint(joint).qposadr[0]] = values
    for k, side in enumerate(SIDES):
        solved = {f"hip_{side}_{t}" for t in ("flexion", "abduction", "rotation")}
        solved |= {f"knee_{side}_flexion", f"ankle_{side}_flexion", f"ankle_{side}_inversion"}
        if warm is None:
            for joint, guess in (("hip", 0.4), ("knee", 0.8), ("ankle", 0.4)):
                q[:, model.joint(f"{joint}_{side}_flexion").qposadr[0]] = guess
        q = plant(chain(model, side, solved), q, script.ankles[k], script.soles[k], glide)
    return q


def _height(model: mujoco.MjModel, script: Script, place: np.ndarray, turn: Rotation) -> np.ndarray:
    """Of the pelvis: below the highest that both legs allow by the script's drop [m]."""
    highest = []
    for k, side in enumerate(SIDES):
        length = script.reach * sum(np.linalg.norm(model.body(f"{part}_{side}").pos) for part in ("shank", "foot"))
        hip = turn.apply(model.body(f"thigh_{side}").pos)
        away = ((place + hip[:, :2] - script.ankles[k][:, :2]) ** 2).sum(1)
        highest.append(script.ankles[k][:, 2] + np.sqrt(np.maximum(length**2 - away, 0.01)) - hip[:, 2])
    left, right = highest
    soft = SOFT_STEPS if script.airborne.any() else SOFT
    return -soft * np.logaddexp(-left / soft, -right / soft) - script.drop


def _assert_planted(moved: Moved, script: Script) -> None:
    for k, side in enumerate(SIDES):
        off = np.abs(moved.p[:, moved.names[f"foot_{side}"]] - script.ankles[k]).max()
        assert off < STILL, f"foot {side} is {1e3 * off:.3g} mm off in MuJoCo"
