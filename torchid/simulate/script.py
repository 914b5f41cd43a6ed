"""What a person intends to do: where the feet stand, how weight is shared, how pelvis and upper body move.

A script leaves out what physics decides: where the pelvis has to be to keep balance (``balance``), and the angles of
legs that stand (``legs``).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.simulate.subject import LEFT, SimulatedSubject, Sole, Stance


def smooth_step(x: Tensor) -> Tensor:
    """From 0 at x <= 0 to 1 at x >= 1 with three continuous derivatives (polynomial of degree seven)."""
    x = x.clamp(0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


def passages(time: Float[Tensor, " frames"], keys: Sequence[tuple[float, float]]) -> Float[Tensor, " frames"]:
    """Through (time, value) keys, at rest at each of them; constant before the first and behind the last."""
    out = torch.full_like(time, keys[0][1])
    for (t0, y0), (t1, y1) in zip(keys, keys[1:], strict=False):
        if y1 != y0:
            out = out + (y1 - y0) * smooth_step((time - t0) / max(t1 - t0, 1e-9))
    return out


def wander(
    rng: np.random.Generator,
    time: Float[Tensor, " frames"],
    low: float,
    high: float,
    band: tuple[float, float] = (0.15, 0.9),
) -> Float[Tensor, " frames"]:
    """Random sum of four sines between ``low`` and ``high`` with frequencies in ``band`` [Hz]; slow ones are larger."""
    frequency = np.exp(rng.uniform(np.log(band[0]), np.log(band[1]), 4))
    weight = rng.uniform(0.3, 1.0, 4) / frequency**0.5
    phase = rng.uniform(0.0, 2.0 * np.pi, 4)
    angle = 2.0 * torch.pi * time[:, None] * time.new_tensor(frequency) + time.new_tensor(phase)
    unit = (torch.sin(angle) * time.new_tensor(weight / weight.sum())).sum(1)
    return 0.5 * (low + high) + 0.5 * (high - low) * unit


TRANSFER = 0.30
"""Time over which weight passes from one foot to the other [s]."""
PASS = 0.20
"""Time over which the bearing point moves along the sole [s]."""


@dataclass(frozen=True)
class FootStep:
    """One foot leaves the floor at ``start`` and is back ``duration`` later."""

    side: int
    start: float
    duration: float
    to: tuple[float, float]
    """Where the ankle is above then [m]."""
    lift: float = 0.10
    """Height reached [m]."""
    free: bool = False
    """In the air the leg follows the script's angles instead of a path of the foot."""
    leave: float = 0.0
    """Pitch after leaving over the ball, toes down [rad]."""
    land: float = 0.0
    """Pitch before landing: on the ball if positive, on the heel if negative [rad]."""
    leave_s: float = 0.22
    """Time for which the foot pivots on its ball before it leaves the floor [s]."""
    land_s: float = 0.22
    """Time for which it pivots on ball or heel after landing [s]."""
    roll: float = 0.22
    """A swinging foot follows its leg, which leans outwards from a pelvis above the other foot [rad]."""


@dataclass(frozen=True)
class FootPath:
    """One foot over time."""

    base: Float[Tensor, "frames 3"]
    """Ankle if the foot were flat [m]."""
    yaw: float
    pitch: Float[Tensor, " frames"]
    """Toes down [rad]."""
    roll: Float[Tensor, " frames"]
    """About the foot's long axis, in the air only [rad]."""
    bearing: Float[Tensor, "frames 2"]
    """Point of the sole (x forward, y left of the ankle) where it bears, about which it pitches [m]."""
    free: Float[Tensor, " frames"]
    """1 where the leg follows the script's angles."""
    airborne: Float[Tensor, " frames"]
    """1 while the foot is off the floor."""


@dataclass(frozen=True)
class Script:
    """A motion before physics."""

    time: Float[Tensor, " frames"]
    angles: Float[Tensor, "frames dofs"]
    """All joint angles; those of standing legs and the pelvis' place are not read."""
    pelvis_turn: Float[Tensor, "frames 3"]
    """Rotation vector of the pelvis in W [rad]."""
    drop: Float[Tensor, " frames"]
    """Pelvis below its highest place for the feet [m]."""
    feet: tuple[FootPath, FootPath]
    share: Float[Tensor, " frames"]
    """Part of the force that the left foot carries."""
    squeeze: Float[Tensor, " frames"]
    """Feet pressing apart along the line between them while both stand, part of the weight."""
    rise: Float[Tensor, " frames"] | None = None
    """Height of the centre of mass over where it starts [m], in motions that leave the floor: it overrules ``drop``."""
    reach: float = 0.990
    """How far the longer-stretched leg may be straightened, part of its length."""


def random_stance(rng: np.random.Generator, subject: SimulatedSubject) -> Stance:
    """The subject's own stance, else feet side by side about the origin, hips' width apart or somewhat more."""
    if subject.stance is not None:
        return subject.stance
    half = 0.5 * float(subject.geometry.offset[:, 1].abs()[list(_hips(subject))].sum()) + rng.uniform(0.02, 0.05)
    x = rng.uniform(-0.10, -0.02)
    return Stance((x + rng.uniform(-0.02, 0.02), half), (x, -half), float(rng.uniform(0.02, 0.18)))


def _hips(subject: SimulatedSubject) -> tuple[int, int]:
    return subject.model.tree.index("thigh_l"), subject.model.tree.index("thigh_r")


def foot_path(
    rng: np.random.Generator, time: Tensor, sole: Sole, stance: Stance, side: int, steps: Sequence[FootStep]
) -> FootPath:
    """The foot's own steps, at rest on the floor in between."""
    x, y = stance.place(side)
    keys: dict[str, list[tuple[float, float]]] = {
        "x": [(-1e3, x)], "y": [(-1e3, y)], "z": [(-1e3, 0.0)], "pitch": [(-1e3, 0.0)], "roll": [(-1e3, 0.0)],
        "free": [(-1e3, 0.0)],
        "bearing": [(-1e3, _middle(sole))],
    }  # fmt: skip
    airborne = torch.zeros_like(time)
    for step in (s for s in steps if s.side == side):
        _add_step(keys, step, sole)
        airborne[(time > step.start) & (time < step.start + step.duration)] = 1.0
    path = {name: passages(time, list_) for name, list_ in keys.items()}
    wobble = torch.stack(
        [wander(rng, time, -0.008, 0.008, (0.1, 0.5)), wander(rng, time, -0.008, 0.008, (0.1, 0.5))], 1
    )
    # On heel and ball the bearing point is where the foot pivots and must not wander.
    calm = passages(time, _calm_keys([s for s in steps if s.side == side and (s.leave or s.land)]))
    bearing = torch.stack([path["bearing"], torch.zeros_like(time)], 1) + wobble * calm[:, None]
    base = torch.stack([path["x"], path["y"], sole.height + path["z"]], 1)
    yaw = stance.toe_out if side == LEFT else -stance.toe_out
    return FootPath(base, yaw, path["pitch"], path["roll"], bearing, path["free"], airborne)


def _middle(sole: Sole) -> float:
    return 0.42 * sole.ball


def _add_step(keys: dict[str, list[tuple[float, float]]], step: FootStep, sole: Sole) -> None:
    t0, t1, T = step.start, step.start + step.duration, step.duration
    rise = 0.5 * T if not step.free else min(0.5, 0.2 * T)
    for axis, value in zip("xy", step.to, strict=True):
        last = keys[axis][-1][1]
        keys[axis] += [(t0 + 0.08 * T, last), (t1 - 0.08 * T, value)]
    keys["z"] += [(t0, 0.0), (t0 + rise, step.lift), (t1 - rise, step.lift), (t1, 0.0)]
    if step.free:
        keys["free"] += [(t0 + 0.6 * rise, 0.0), (t0 + 2.0 * rise, 1.0), (t1 - 2.0 * rise, 1.0), (t1 - 0.6 * rise, 0.0)]
    tilt = step.roll if step.side == LEFT else -step.roll
    ease = min(0.4 * T, 0.5)
    keys["roll"] += [(t0, 0.0), (t0 + ease, tilt), (t1 - ease, tilt), (t1, 0.0)]
    if step.leave or step.land:
        _add_pitch(keys, step, sole)


def _add_pitch(keys: dict[str, list[tuple[float, float]]], step: FootStep, sole: Sole) -> None:
    T, off, flat = step.duration, step.start - step.leave_s, step.start + step.duration + step.land_s
    t0, t1 = step.start, step.start + T
    keys["pitch"] += [(off, 0.0), (t0 + 0.3 * T, step.leave), (t1 - 0.3 * T, step.land), (flat, 0.0)]
    middle = _middle(sole)
    start = sole.ball if step.leave else middle
    end = sole.ball if step.land > 0.0 else sole.heel if step.land < 0.0 else middle
    if keys["bearing"][-1][0] > off - PASS:
        keys["bearing"].pop()  # no time for the middle of the foot between two steps
    else:
        keys["bearing"].append((off - PASS, middle))
    keys["bearing"] += [(off, start), (t0 + 0.2 * T, start), (t1 - 0.2 * T, end), (flat, end), (flat + PASS, middle)]


def _calm_keys(steps: Sequence[FootStep]) -> list[tuple[float, float]]:
    keys = [(-1e3, 1.0)]
    for s in steps:
        t0, t1 = s.start - s.leave_s, s.start + s.duration + s.land_s
        if t0 - PASS < keys[-1][0]:
            keys = keys[:-1]
        else:
            keys.append((t0 - PASS, 1.0))
        keys += [(t0, 0.0), (t1, 0.0), (t1 + PASS, 1.0)]
    return keys


def weight_share(
    rng: np.random.Generator, time: Tensor, steps: Sequence[FootStep], shift: float = 0.1
) -> Float[Tensor, " frames"]:
    """Part of the force on the left foot: none while it steps, all while the other one does, shared at rest."""
    if not steps:
        return wander(rng, time, 0.5 - shift, 0.5 + shift, (0.1, 0.5))
    keys = [(-1e3, 0.5)]
    ordered = sorted(steps, key=lambda s: s.start)
    for k, step in enumerate(ordered):
        value = 0.0 if step.side == LEFT else 1.0
        before = ordered[k - 1].start + ordered[k - 1].duration if k else -1e3
        if step.start - before > 2.5 * TRANSFER:
            rest = 0.5 + float(rng.uniform(-shift, shift))
            if k:
                keys.append((before + TRANSFER, rest))
            keys.append((step.start - TRANSFER, rest if k else 0.5))
        keys += [(step.start, value), (step.start + step.duration, value)]
    last = keys[-1][0]
    keys.append((last + TRANSFER, 0.5))
    return passages(time, keys)
