"""Motions by name: each turns a seed into a script."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import ConfigError
from torchid.model.skeleton import SIDES
from torchid.simulate.flight import COUNTERMOVEMENT, leap_height
from torchid.simulate.script import TRANSFER, FootStep, Script, foot_path, passages, random_stance, wander, weight_share
from torchid.simulate.subject import LEFT, RIGHT, SimulatedSubject, Stance

Range = tuple[int | float, int | float]
"""Smallest and largest value of an angle [deg]."""
QUIET: dict[str, Range] = {
    "lower_spine_flexion": (-2, 3), "upper_spine_flexion": (-2, 3), "neck_flexion": (-4, 6), "neck_rotation": (-6, 6),
    "shoulder_flexion": (-4, 6), "shoulder_adduction": (-22, -14), "elbow_flexion": (8, 18),
    "elbow_pronation": (-5, 10), "wrist_flexion": (-5, 8),
}  # fmt: skip
"""Standing at ease, arms slightly off the body; sided names hold for both sides."""
ARMS: dict[str, Range] = {
    "shoulder_flexion": (-35, 125), "shoulder_rotation": (-50, 50), "shoulder_adduction": (-85, -2),
    "elbow_flexion": (8, 125), "elbow_pronation": (-65, 65), "wrist_flexion": (-50, 50), "wrist_deviation": (-20, 30),
    "neck_flexion": (-25, 30), "neck_rotation": (-45, 45), "neck_bending": (-20, 20),
}  # fmt: skip
TRUNK: dict[str, Range] = {
    "lower_spine_flexion": (-14, 38), "lower_spine_bending": (-18, 18), "lower_spine_rotation": (-14, 14),
    "upper_spine_flexion": (-14, 34), "upper_spine_bending": (-20, 20), "upper_spine_rotation": (-24, 24),
    "neck_flexion": (-30, 30), "neck_rotation": (-35, 35), "neck_bending": (-22, 22),
    "shoulder_flexion": (-5, 45), "shoulder_adduction": (-45, -15), "elbow_flexion": (10, 60),
}  # fmt: skip
SWING: dict[str, Range] = {
    "shoulder_flexion": (-25, 40), "shoulder_adduction": (-28, -12), "elbow_flexion": (15, 70),
    "lower_spine_rotation": (-6, 6), "upper_spine_rotation": (-10, 10), "upper_spine_flexion": (-2, 10),
    "neck_rotation": (-20, 20), "neck_flexion": (-10, 12),
}  # fmt: skip
FREE_LEG: dict[str, Range] = {
    "hip_flexion": (0, 68), "hip_adduction": (-36, -2), "hip_rotation": (-22, 22), "knee_flexion": (42, 95),
    "ankle_flexion": (-12, 14), "ankle_inversion": (-12, 14),
}  # fmt: skip
SHORT = 0.7
"""Effort below which walks take short steps."""
TIMID = 0.55
"""Effort below which jumps get no lower: legs that hardly bend reach their ends before they leave the floor."""
Maker = Callable[[np.random.Generator, SimulatedSubject, Tensor, float, float], Script]


def make_script(
    name: str,
    rng: np.random.Generator,
    subject: SimulatedSubject,
    time: Float[Tensor, " frames"],
    duration: float,
    effort: float = 1.0,
) -> Script:
    """Script of the motion ``name`` from time 0 to ``duration`` (``time`` may begin earlier and end later).

    ``effort`` below one makes squats shallower, folds a lifted leg more and (below ``SHORT``) shortens the steps of the
    walk so that they stay on the first plates, for bodies that cannot do the full motion.

    Raises:
        ConfigError: no such motion.
    """
    if name not in MOTIONS:
        raise ConfigError(
            "simulate.motion", "no such motion", place="simulate.motions", found=name,
            remedy=f"motions: {', '.join(MOTIONS)}",
        )  # fmt: skip
    return MOTIONS[name](rng, subject, time, duration, effort)


def static(rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float) -> Script:
    """Quiet stance with sway, knees as straight as people stand."""
    del duration, effort
    small = {name: (0.5 * (a + b) - 0.2, 0.5 * (a + b) + 0.2) for name, (a, b) in QUIET.items()}
    script = _script(rng, subject, time, small, drop=wander(rng, time, 0.0, 0.001), tilt=0.004, shift=0.02)
    return replace(script, reach=float(rng.uniform(0.997, 0.9995)))


def squats(rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float) -> Script:
    """Squats of random depth and pace, arms rising in front as counterweight."""
    leg = _leg_length(subject)
    keys, t = [(-1e3, 0.03 * leg)], float(rng.uniform(0.0, 0.4))
    while t < duration:
        down, hold, up = rng.uniform(0.7, 1.3), rng.uniform(0.0, 0.3), rng.uniform(0.6, 1.1)
        depth, rest = float(rng.uniform(0.13, 0.28)) * effort * leg, float(rng.uniform(0.02, 0.05)) * leg
        keys += [(t, keys[-1][1]), (t + down, depth), (t + down + hold, depth), (t + down + hold + up, rest)]
        t += float(down + hold + up + rng.uniform(0.05, 0.5))
    drop = passages(time, keys)
    deep = drop / (0.28 * leg)
    script = _script(
        rng, subject, time, _join(QUIET, {"upper_spine_flexion": (-4, 12)}), drop, tilt=0.05, lean=0.55 * deep
    )
    _add(script, subject, {"shoulder_flexion": (85.0 * deep, 85.0 * deep), "neck_flexion": (-15.0 * deep, None)})
    return script


def arms(rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float) -> Script:
    """Swings of shoulders, elbows and wrists while standing, each arm its own way."""
    del duration, effort
    ranges = _join(QUIET, ARMS, {"upper_spine_rotation": (-12, 12), "upper_spine_bending": (-8, 8)})
    return _script(rng, subject, time, ranges, drop=wander(rng, time, 0.004, 0.03), tilt=0.04, band=(0.2, 1.1))


def trunk(rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float) -> Script:
    """Bending, twisting and circling of pelvis and spine."""
    del duration, effort
    lean = wander(rng, time, -0.1, 0.5, (0.1, 0.4))
    drop = wander(rng, time, 0.01, 0.06)
    return _script(rng, subject, time, _join(QUIET, TRUNK), drop, tilt=0.12, band=(0.15, 0.7), lean=lean)


def hip_rom(
    rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float
) -> Script:
    """Standing on one leg, the other one in stars and circles; then the other side."""
    stance = random_stance(rng, subject)
    first = int(rng.integers(2))
    steps = [
        FootStep(side, (0.06 + 0.48 * k) * duration, 0.40 * duration, stance.place(side), lift=0.10, free=True)
        for k, side in enumerate((first, 1 - first))
    ]
    ranges = _join(QUIET, {"shoulder_adduction": (-65, -20), "lower_spine_bending": (-8, 8)}, FREE_LEG)
    ranges["knee_flexion"] = (42 + 50 * (1.0 - effort), 95)
    drop = wander(rng, time, 0.002, 0.015)
    return _script(rng, subject, time, ranges, drop, tilt=0.04, band=(0.15, 0.8), steps=steps, stance=stance)


def sway_steps(
    rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float
) -> Script:
    """Steps on the spot with pauses in which weight is shifted, arms swinging."""
    del effort
    stance, steps = random_stance(rng, subject), []
    t, side = float(rng.uniform(0.5, 0.9)), int(rng.integers(2))
    while t < duration - 0.9:
        T = float(rng.uniform(0.55, 0.8))
        x, y = stance.place(side)
        beside = (x + float(rng.uniform(-0.03, 0.03)), y + float(rng.uniform(-0.01, 0.01)))
        to = (x, y) if subject.stance is not None else beside
        steps.append(FootStep(side, t, T, to, lift=float(rng.uniform(0.08, 0.20)), leave=0.45, land=0.15))
        t += T + float(rng.choice([rng.uniform(0.3, 0.45), rng.uniform(0.9, 1.6)], p=[0.7, 0.3]))
        side = 1 - side
    drop = wander(rng, time, 0.01, 0.05)
    return _script(rng, subject, time, _join(QUIET, SWING), drop, tilt=0.06, steps=steps, stance=stance, shift=0.3)


def walk(rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float) -> Script:
    """To and fro over the plates: forward over the heel, backward over the ball; the front foot once beside them."""
    long_steps = {LEFT: (-0.02, 0.42, 1.00), RIGHT: (-0.15, 0.12, 0.68)}
    short_steps = {LEFT: (-0.08, 0.04, 0.13), RIGHT: (-0.13, -0.02, 0.09)}
    places = long_steps if effort > SHORT else short_steps
    half = float(rng.uniform(0.085, 0.115))
    stance = Stance((places[LEFT][0], half), (places[RIGHT][0], -half), float(rng.uniform(0.03, 0.15)))
    cycle = [(RIGHT, 1), (LEFT, 1), (RIGHT, 2), (LEFT, 2), (LEFT, 1), (RIGHT, 1), (LEFT, 0), (RIGHT, 0)]
    steps: list[FootStep] = []
    t, k = 0.5, 0
    while t < duration - 0.8:
        side, place = cycle[k % len(cycle)]
        forward, long = k % len(cycle) < 4, k % len(cycle) > 0
        T = float(rng.uniform(0.58, 0.72)) * (1.0 if forward else 1.15)
        to = (places[side][place] + float(rng.uniform(-0.015, 0.015)), half if side == LEFT else -half)
        lift = float(rng.uniform(0.06, 0.09))
        if forward:
            leave, land = (0.60, -0.25) if long else (0.4, -0.05)
            steps.append(FootStep(side, t, T, to, lift, leave=leave, land=land, leave_s=0.38, land_s=0.15))
        else:
            steps.append(FootStep(side, t, T, to, lift, leave=0.35, land=0.45, leave_s=0.25, land_s=0.40))
        # One foot that moves twice in turn stands still in between for as long as the weight needs to come back.
        again = cycle[(k + 1) % len(cycle)][0] == side
        t += T + (2.0 * TRANSFER + 0.45 if again else float(rng.uniform(0.24, 0.34)))
        k += 1
    drop = wander(rng, time, 0.01, 0.025)
    return _script(rng, subject, time, _join(QUIET, SWING), drop, tilt=0.04, steps=steps, stance=stance)


def jump(rng: np.random.Generator, subject: SimulatedSubject, time: Tensor, duration: float, effort: float) -> Script:
    """Countermovement jumps on the spot, arms swinging along, landings on the balls of the feet."""
    stance, steps, height = random_stance(rng, subject), [], torch.zeros_like(time)
    leans, swings, t = [(-1e3, 0.0)], [(-1e3, 0.0)], float(rng.uniform(0.1, 0.4))
    effort = max(effort, TIMID)
    long, _, deep, _ = moments = [(0.5 + 0.5 * effort) * x for x in COUNTERMOVEMENT]
    while not steps or t + 2.0 * long + 0.3 < duration:
        t0, T = t + long, float(rng.uniform(0.23, 0.28)) * (0.4 + 0.6 * effort)
        t1 = t0 + T
        steps += [
            FootStep(k, t0, T, stance.place(k), lift=0.3 * T, leave=0.45, land=0.4, leave_s=0.16, land_s=0.16, roll=0.0)
            for k in (LEFT, RIGHT)
        ]
        height = height + leap_height(time, t0, t1, moments)
        # Shanks that cannot tilt far over their feet need a trunk that leans further.
        lean = float(rng.uniform(0.38, 0.50)) + 0.4 * (1.0 - effort)
        leans += [(t, 0.0), (t0 - deep - 0.04, lean), (t0, 0.0), (t1, 0.0), (t1 + deep, 0.8 * lean), (t1 + long, 0.0)]
        swings += [(t, 0.0), (t0 - 0.32, -30.0), (t0, 60.0), (t1 + 0.1, 30.0), (t1 + long, 0.0)]
        t = t1 + long + float(rng.uniform(0.05, 0.5))
    lean, swing = passages(time, leans), passages(time, swings)
    drop = torch.full_like(time, 0.02 * _leg_length(subject))
    script = _script(rng, subject, time, QUIET, drop, tilt=0.02, lean=lean, steps=steps, stance=stance)
    _add(script, subject, {"shoulder_flexion": (swing, swing)})
    return replace(script, share=wander(rng, time, 0.46, 0.54, (0.1, 0.4)), rise=height)


MOTIONS: Mapping[str, Maker] = {
    "static": static,
    "squats": squats,
    "arms": arms,
    "trunk": trunk,
    "hip_rom": hip_rom,
    "sway_steps": sway_steps,
    "walk": walk,
    "jump": jump,
}


def _script(
    rng: np.random.Generator,
    subject: SimulatedSubject,
    time: Tensor,
    ranges: Mapping[str, Range],
    drop: Tensor,
    tilt: float,
    band: tuple[float, float] = (0.15, 0.9),
    lean: Tensor | None = None,
    steps: Sequence[FootStep] = (),
    stance: Stance | None = None,
    shift: float = 0.1,
) -> Script:
    """Angles wander in their ranges [deg], the pelvis about upright by ``tilt`` [rad] besides leaning forward."""
    stance = stance or random_stance(rng, subject)
    names = subject.model.tree.dof_names
    angles = time.new_zeros(len(time), len(names))
    for row, name in enumerate(names):
        stem = name.replace("_l_", "_").replace("_r_", "_")
        if stem in ranges:
            low, high = ranges[stem]
            angles[:, row] = torch.deg2rad(wander(rng, time, float(low), float(high), band))
    turn = torch.stack([wander(rng, time, -tilt, tilt, band) for _ in range(3)], 1)
    if lean is not None:
        turn[:, 1] = turn[:, 1] + lean
    feet = tuple(foot_path(rng, time, subject.sole, stance, side, steps) for side in (LEFT, RIGHT))
    share = weight_share(rng, time, steps, shift)
    squeeze = wander(rng, time, -0.01, 0.05, (0.1, 0.4))
    return Script(time, angles, turn, drop, (feet[0], feet[1]), share, squeeze)


def _join(*tables: Mapping[str, Range]) -> dict[str, Range]:
    out: dict[str, Range] = {}
    for table in tables:
        out |= table
    return out


def _add(script: Script, subject: SimulatedSubject, more: Mapping[str, tuple[Tensor, Tensor | None]]) -> None:
    """Add degrees to angles of a script under construction, left and right for sided ones, that the body has."""
    rows = {name: row for row, name in enumerate(subject.model.tree.dof_names)}
    for stem, values in more.items():
        joint, _, tail = stem.partition("_")
        for side, value in zip(SIDES, values, strict=True):
            row = rows.get(stem, rows.get(f"{joint}_{side}_{tail}"))
            if value is not None and row is not None:
                script.angles[:, row] += torch.deg2rad(value)


def _leg_length(subject: SimulatedSubject) -> float:
    tree, offset = subject.model.tree, subject.geometry.offset
    return float(sum(offset[tree.index(f"{part}_{s}")].norm() for part in ("shank", "foot") for s in SIDES)) / 2.0
