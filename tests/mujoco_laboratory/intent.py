"""What the person means to do in a trial: angles, feet and how weight is shared, all smooth functions of time."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from mujoco_laboratory.body import MIDFOOT, SIDES, Person

Range = tuple[float, float]
QUIET: dict[str, Range] = {
    "lower_spine_flexion": (-2, 3), "upper_spine_flexion": (-2, 4), "neck_flexion": (-5, 6), "neck_rotation": (-6, 6),
    "shoulder_flexion": (-5, 6), "shoulder_abduction": (10, 16), "elbow_flexion": (9, 18), "elbow_pronation": (-6, 8),
    "wrist_flexion": (-5, 8),
}  # fmt: skip
"""Smallest and largest angles [deg]; sided names hold for both sides."""
ARMS: dict[str, Range] = {
    "shoulder_flexion": (-28, 105), "shoulder_abduction": (5, 70), "shoulder_rotation": (-40, 35),
    "elbow_flexion": (10, 118), "elbow_pronation": (-60, 60), "wrist_flexion": (-42, 45), "wrist_deviation": (-16, 22),
    "neck_flexion": (-22, 28), "neck_rotation": (-40, 40), "neck_bending": (-18, 18), "upper_spine_rotation": (-10, 10),
}  # fmt: skip
TRUNK: dict[str, Range] = {
    "lower_spine_flexion": (-10, 34), "lower_spine_bending": (-16, 16), "lower_spine_rotation": (-12, 12),
    "upper_spine_flexion": (-10, 30), "upper_spine_bending": (-18, 18), "upper_spine_rotation": (-22, 22),
    "neck_flexion": (-25, 28), "neck_rotation": (-30, 30), "neck_bending": (-20, 20), "shoulder_flexion": (-5, 45),
    "shoulder_abduction": (12, 45), "elbow_flexion": (10, 60),
}  # fmt: skip
LIVELY: dict[str, Range] = {
    "shoulder_flexion": (-22, 38), "shoulder_abduction": (8, 40), "elbow_flexion": (20, 70), "wrist_flexion": (-15, 20),
    "elbow_pronation": (-25, 25), "lower_spine_bending": (-5, 5), "upper_spine_rotation": (-12, 12),
    "lower_spine_flexion": (-3, 9), "upper_spine_bending": (-6, 6), "neck_rotation": (-14, 14), "neck_flexion": (-8, 8),
}  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """A sort of trial."""

    ranges: dict[str, Range]
    band: Range
    """Frequencies of the angles in ``ranges`` [Hz]."""
    drop: Range
    """How far the pelvis is below its highest place, part of the leg's length."""
    drop_band: Range = (0.15, 0.5)
    tilt: float = 0.04
    """How far the pelvis turns [rad]."""
    lean: float = 0.0
    """How far it leans forward at the deepest [rad]."""
    share: Range = (0.42, 0.58)
    """Part of the weight on the left foot."""
    share_band: Range = (0.1, 0.5)
    """How quickly it goes over, and along the soles [Hz]."""
    wide: float = 0.0
    """How much further out than at ease each foot stands [m]."""
    bear: float = 0.015
    """How far the weight shifts along the soles, to and fro [m]."""
    press: Range = (0.2, 0.6)
    """How far the force on each foot leans to the centre of mass between them, part of the way."""
    press_band: Range = (0.05, 0.2)
    """How quickly that goes to and fro [Hz]."""
    steps: str = ""
    """``walk``: over to the plates in front and back; ``swing``: one leg after the other in the air."""
    reach: float = 0.985
    """How far a leg may be straightened."""


KINDS: dict[str, Kind] = {
    "static": Kind({}, (0.1, 0.4), (0.0, 0.001), tilt=0.004, share=(0.48, 0.52), reach=0.993),
    "squats": Kind({"upper_spine_flexion": (-3, 14)}, (0.2, 0.7), (0.02, 0.30), (0.25, 0.7), lean=0.5),
    "arms": Kind(ARMS, (0.2, 1.0), (0.005, 0.03)),
    "trunk": Kind(TRUNK, (0.15, 0.7), (0.01, 0.05), tilt=0.12, lean=0.25, steps="swing"),
    "sway": Kind(
        {"shoulder_flexion": (-20, 35)}, (0.2, 0.8), (0.0, 0.03), share=(0.15, 0.85), steps="walk", reach=0.99
    ),
    "pushes": Kind(
        {"shoulder_flexion": (-20, 35)},
        (0.2, 0.8),
        (0.03, 0.12),
        share=(0.08, 0.92),
        share_band=(0.5, 1.2),
        wide=0.14,
        bear=0.055,
        press=(-0.2, 1.1),
        press_band=(0.3, 0.9),
    ),
    "mix": Kind(TRUNK | ARMS, (0.15, 0.8), (0.02, 0.16), tilt=0.07, lean=0.2, share=(0.3, 0.7)),
    "lively": Kind(LIVELY, (0.6, 2.6), (0.02, 0.09), (0.6, 1.6), tilt=0.05, lean=0.1, share=(0.3, 0.7)),
}


@dataclass(frozen=True)
class Step:
    """A foot in the air."""

    side: int
    start: float
    duration: float
    to: float
    """Ankle's place along x then [m]."""
    lift: float
    """Height reached [m]."""
    aside: float = 0.0
    """Way outward in between [m]."""


@dataclass(frozen=True)
class Script:
    """An intended motion, frames along the first axis."""

    time: np.ndarray
    angles: dict[str, np.ndarray]
    """By MuJoCo joint [rad]; those of the legs follow from the feet."""
    pelvis: np.ndarray
    """Rotation vector (frames, 3) [rad]."""
    drop: np.ndarray
    ankles: tuple[np.ndarray, np.ndarray]
    """Left and right (frames, 3) [m]."""
    soles: tuple[np.ndarray, np.ndarray]
    """Axes of the feet (frames, 3, 3)."""
    share: np.ndarray
    """Part of the force on the left foot (frames,)."""
    bearing: np.ndarray
    """Where each foot would bear on the floor (frames, 2, 2) [m]."""
    press: np.ndarray
    """How far the force on each foot leans to the centre of mass, part of the way (frames,)."""
    reach: float
    airborne: np.ndarray
    """(frames, 2)"""

    @property
    def pressure(self) -> np.ndarray:
        """Intended centre of pressure (frames, 2) [m]."""
        share = np.stack([self.share, 1.0 - self.share], 1)
        return (share[:, :, None] * self.bearing).sum(1)


def make_script(
    rng: np.random.Generator, person: Person, kind: str, time: np.ndarray, duration: float, short: bool
) -> Script:
    """A trial of a kind: random within its ranges, at rest before time zero; ``short`` steps stay on their plates."""
    what = KINDS[kind]
    calm = 0.05 if kind == "static" else 1.0
    start = smooth(time / 1.2)
    deep = wander(rng, time, 0.0, 1.0, what.drop_band) * start
    hips = abs(person.segments["thigh_l"].centre[1])
    near = 0.70 if what.steps == "walk" else 1.0
    half, behind = near * hips + what.wide + rng.uniform(0.0, 0.02), rng.uniform(-0.13, -0.11)
    steps = _steps(rng, what.steps, duration, behind, short)
    feet = [_foot(rng, person, time, side, (behind, half), steps) for side in (0, 1)]
    pelvis = np.stack([wander(rng, time, -what.tilt, what.tilt, (0.1, 0.6)) for _ in range(3)], 1) * start[:, None]
    pelvis[:, 1] += what.lean * deep
    length = np.linalg.norm(person.segments["shank_l"].centre) + np.linalg.norm(person.segments["foot_l"].centre)
    low, high = what.drop
    airborne = np.stack([_airborne(time, steps, side) for side in (0, 1)], 1)
    bearing = np.stack([f[2] for f in feet], 1)
    bearing[:, :, 0] += calm * wander(rng, time, -what.bear, what.bear, what.share_band)[:, None]
    return Script(
        time, _angles(rng, what, time, start, calm), pelvis, length * (low + (high - low) * deep),
        (feet[0][0], feet[1][0]), (feet[0][1], feet[1][1]), _share(rng, what, time, steps, duration), bearing,
        wander(rng, time, *what.press, what.press_band), what.reach, airborne,
    )  # fmt: skip


def with_angle(script: Script, joint: str, values: np.ndarray) -> Script:
    """The script with one more joint moving."""
    return replace(script, angles=script.angles | {joint: values})


def wander(rng: np.random.Generator, time: np.ndarray, low: float, high: float, band: Range) -> np.ndarray:
    """A sum of five sines with frequencies in the band [Hz] that reaches from ``low`` to ``high``."""
    f = np.exp(rng.uniform(np.log(band[0]), np.log(band[1]), 5))
    phase, size = rng.uniform(0.0, 2.0 * np.pi, 5), rng.uniform(0.5, 1.0, 5)
    wave = (size * np.sin(2.0 * np.pi * f * time[:, None] + phase)).sum(1)
    wave = (wave - wave.min()) / (wave.max() - wave.min())
    return low + (high - low) * wave


def smooth(s: np.ndarray) -> np.ndarray:
    """From 0 to 1 along a polynomial with three continuous derivatives."""
    s = np.clip(s, 0.0, 1.0)
    return s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)


def _passages(time: np.ndarray, keys: list[tuple[float, float]]) -> np.ndarray:
    """Through (time, value) keys, at rest in each."""
    value = np.full(len(time), keys[0][1])
    for (t0, a), (t1, b) in zip(keys[:-1], keys[1:], strict=True):
        value += (b - a) * smooth((time - t0) / (t1 - t0))
    return value


def _angles(
    rng: np.random.Generator, what: Kind, time: np.ndarray, start: np.ndarray, calm: float
) -> dict[str, np.ndarray]:
    found = {}
    for name, (low, high) in (QUIET | what.ranges).items():
        rest = sum(QUIET.get(name, (0.0, 0.0))) / 2.0
        band = what.band if name in what.ranges else (0.1, 0.5)
        joint, _, turn = name.rpartition("_")
        for side in SIDES if joint in ("shoulder", "elbow", "wrist") else ("",):
            free = wander(rng, time, low, high, band)
            path = rest + calm * start * (free - rest)
            found[f"{joint}_{side}_{turn}" if side else name] = np.radians(path)
    return found


def _steps(rng: np.random.Generator, plan: str, duration: float, behind: float, short: bool) -> list[Step]:
    if not plan or duration < 9.5:
        return []
    first = int(rng.integers(2))
    if plan == "swing":
        lifts, sides = rng.uniform(0.10, 0.18, 2), rng.uniform(0.14, 0.24, 2)
        starts, length = (1.5, 4.6), 1.9
        return [Step((first + k) % 2, starts[k], length, behind, lifts[k], sides[k]) for k in (0, 1)]
    front = behind - 0.12 if short else rng.uniform(0.19, 0.20)
    found = []
    for start, place in ((1.4, front), (5.9, behind)):
        for k in (0, 1):
            found.append(Step((first + k) % 2, start + 1.6 * k, 0.8, place, rng.uniform(0.05, 0.09)))
    return found


def _airborne(time: np.ndarray, steps: list[Step], side: int) -> np.ndarray:
    air = np.zeros(len(time), bool)
    for step in steps:
        air |= (step.side == side) & (time > step.start) & (time < step.start + step.duration)
    return air


def _share(rng: np.random.Generator, what: Kind, time: np.ndarray, steps: list[Step], duration: float) -> np.ndarray:
    """All on one foot while the other is in the air; in between, what the kind of trial wants."""
    free = wander(rng, time, *what.share, what.share_band)
    if not steps:
        return 0.5 + smooth(time / 1.2) * (free - 0.5)
    keys, mix = [(-9.0, 0.5)], [(-9.0, 0.0)]
    for k, step in enumerate(steps):
        end, on = step.start + step.duration, float(step.side)
        after = steps[k + 1].start if k + 1 < len(steps) else duration + 9.0
        if k == 0 or keys[-1][0] < step.start - 0.7:
            keys.append((step.start - 0.7, 0.5))
            mix += [(step.start - 0.7 - 0.1, mix[-1][1]), (step.start - 0.05, 0.0)] if mix[-1][1] else []
        keys += [(step.start, on), (end, on)]
        if after - end > 1.5:
            keys.append((end + 0.7, 0.5))
            mix += [(end + 0.7, 0.0), (end + 1.2, 1.0)]
    weight = _passages(time, mix) if len(mix) > 1 else np.zeros(len(time))
    return np.clip(_passages(time, keys), 0.0, 1.0) * (1.0 - weight) + free * weight


def _foot(
    rng: np.random.Generator, person: Person, time: np.ndarray, side: int, place: tuple[float, float], steps: list[Step]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ankle, axes and point of bearing of a foot that is flat on the floor but for its steps."""
    out = 1.0 if side == 0 else -1.0
    yaw = out * rng.uniform(0.03, 0.15)
    ankle = np.tile([place[0], out * place[1], person.ankle_height], (len(time), 1))
    turn = np.zeros((len(time), 3))
    at = place[0]
    for step in (s for s in steps if s.side == side):
        s = np.clip((time - step.start) / step.duration, 0.0, 1.0)
        bump = np.sin(np.pi * s) ** 4
        ankle[:, 0] += (step.to - at) * smooth(s)
        ankle[:, 1] += out * step.aside * bump
        ankle[:, 2] += step.lift * bump
        # Like its leg, which leans outwards from a pelvis over the other foot, the sole turns in the air.
        turn += bump[:, None] * [out * rng.uniform(0.0, 0.2), rng.uniform(0.0, 0.25), out * (0.2 + step.aside)]
        at = step.to
    R = Rotation.from_euler("ZYX", turn + [yaw, 0.0, 0.0]).as_matrix()
    flat = Rotation.from_euler("z", yaw).apply([MIDFOOT * person.scale, 0.0, 0.0])
    return ankle, R, ankle[:, :2] + flat[:2]
