"""Effects that change what the ground must supply: forces that no plate measures, masses that move on their own."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import cont2discrete, lfilter

from mujoco_laboratory.body import Person
from mujoco_laboratory.hidden_body import Entry
from mujoco_laboratory.intent import smooth, wander
from mujoco_laboratory.physics import GRAVITY, RATE, Moved, derivative

FINE = 1000.0
"""Rate at which a mass on a spring is integrated [Hz]."""
EDGE = 0.15
"""Over which an effect with an interval comes and goes, about each end [s]."""


@dataclass(frozen=True)
class Scene:
    """A trial for the effects in it."""

    trial: str
    person: Person
    moved: Moved
    seed: tuple[int, ...]
    """Of what effects draw in this trial."""

    def point(self, segment: str, place: np.ndarray) -> np.ndarray:
        """Way of a point of a segment (frames, 3) [m]; ``place`` (3,) or (frames, 3) in its axes."""
        k = self.moved.names[segment]
        own = np.broadcast_to(place, (len(self.moved.time), 3))
        return self.moved.p[:, k] + np.einsum("tij,tj->ti", self.moved.R[:, k], own)

    def anchor(self, entry: Entry) -> np.ndarray:
        """Way of the point where an effect acts: the one it names, else the segment's centre of mass."""
        segment = entry["where"][0]
        place = entry["parameters"].get("point_seg_m", self.person.segments[segment].com)
        return self.point(segment, np.array(place))


def load(scene: Scene, effects: list[Entry]) -> np.ndarray:
    """Wrench about the origin of W (frames, 6) that the ground must supply because of effects."""
    total = np.zeros((len(scene.moved.time), 6))
    for k, e in enumerate(effects):
        if e["effect"] in LOADS:
            total += LOADS[e["effect"]](scene, e, np.random.default_rng((*scene.seed, k, 5)))
    return total


def within(entry: Entry, scene: Scene) -> np.ndarray:
    """1 inside the intervals, 0 outside, half at the ends."""
    time = scene.moved.time
    if entry.get("when") is None:
        return np.ones(len(time))
    own = [w for w in entry["when"] if w["trial"] == scene.trial]
    parts = [smooth((time - w["t0"]) / EDGE + 0.5) * smooth((w["t1"] - time) / EDGE + 0.5) for w in own]
    return np.max([np.zeros(len(time)), *parts], axis=0)


def _pushed(p: np.ndarray, force: np.ndarray) -> np.ndarray:
    """What the ground is spared by a force on the subject at ``p``."""
    return -np.concatenate([force, np.cross(p, force)], 1)


def _carried(mass: float, p: np.ndarray) -> np.ndarray:
    """What a point mass that moves along ``p`` needs."""
    force = mass * (derivative(p, 2) + [0.0, 0.0, GRAVITY])
    return np.concatenate([force, np.cross(p, force)], 1)


def _grasped_object(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    return within(e, scene)[:, None] * _carried(e["parameters"]["mass_kg"], scene.anchor(e))


def _unmeasured_contact(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """Rises over the first quarter, falls over the last; ``force_N`` is its mean over the interval."""
    total = np.zeros((len(scene.moved.time), 6))
    for w in (w for w in e["when"] if w["trial"] == scene.trial):
        s = (scene.moved.time - w["t0"]) / (w["t1"] - w["t0"])
        shape = smooth(4.0 * s) * smooth(4.0 * (1.0 - s)) / 0.75
        total += _pushed(scene.anchor(e), shape[:, None] * np.array(e["parameters"]["force_N"]))
    return total


def _external_force(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    at = scene.anchor(e)
    return _pushed(at, np.broadcast_to(np.array(e["parameters"]["force_N"]), at.shape))


def _body_weight_support(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    at = scene.anchor(e)
    return _pushed(at, np.broadcast_to([0.0, 0.0, e["parameters"]["force_N"]], at.shape))


def _tether(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """A spring that pulls where it is longer than ``rest_m``."""
    at, p = scene.anchor(e), e["parameters"]
    way = np.array(p["anchor_m"]) - at
    far = np.linalg.norm(way, axis=1, keepdims=True)
    return _pushed(at, p["stiffness_N_m"] * np.maximum(far - p.get("rest_m", 0.0), 0.0) * way / far)


def _drag(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    at = scene.anchor(e)
    return _pushed(at, -e["parameters"]["coefficient_Ns_m"] * derivative(at))


def _wobbling_mass(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """A part of the segment's own mass on a damped spring, which sags; upright, it sags to the centre of mass."""
    p = e["parameters"]
    w = 2.0 * np.pi * p["frequency_hz"]
    sag = np.array([0.0, 0.0, -GRAVITY / w**2])
    segment = e["where"][0]
    at = scene.point(segment, scene.person.segments[segment].com - sag)
    relative = _on_spring(-derivative(at, 2) + [0.0, 0.0, -GRAVITY], w, p["damping_ratio"], sag)
    return _carried(p["mass_kg"], at + relative)


def _on_spring(push: np.ndarray, w: float, damping: float, rest: np.ndarray) -> np.ndarray:
    """x'' + 2 z w x' + w^2 x = push, from rest at ``rest`` (frames, 3)."""
    clock = np.arange(len(push)) / RATE
    fine = np.arange(0.0, clock[-1] + 0.5 / FINE, 1.0 / FINE)
    forced = make_interp_spline(clock, push - w * w * rest, k=3)(fine)
    ahead, back, _ = cont2discrete(([1.0], [1.0, 2.0 * damping * w, w * w]), 1.0 / FINE, "foh")
    return rest + lfilter(np.ravel(ahead), np.ravel(back), forced, axis=0)[:: round(FINE / RATE)][: len(push)]


def _flywheel(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """Angular momentum that turns with the segment."""
    k = scene.moved.names[e["where"][0]]
    spin = scene.moved.R[:, k] @ np.array(e["parameters"]["momentum_seg_Nms"])
    return np.concatenate([np.zeros_like(spin), derivative(spin)], 1)


def _water(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """Resistance with the square of the velocity."""
    at = scene.anchor(e)
    v = derivative(at)
    return _pushed(at, -e["parameters"]["coefficient_Ns2_m2"] * np.linalg.norm(v, axis=1, keepdims=True) * v)


def _magnet(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """Pull with the inverse square of the distance, ``force_N`` at half a metre."""
    at, p = scene.anchor(e), e["parameters"]
    way = np.array(p["centre_m"]) - at
    far = np.linalg.norm(way, axis=1, keepdims=True)
    return _pushed(at, 0.25 * p["force_N"] / (far**2 + 0.04) * way / far)


def _inner_motion(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """A part of the segment's own mass that moves to and fro in it, unseen, at a pace that varies."""
    p, time = e["parameters"], scene.moved.time
    segment = e["where"][0]
    com = scene.person.segments[segment].com
    phase = 2.0 * np.pi * p["frequency_hz"] * time + wander(rng, time, -1.0, 1.0, (0.05, 0.15))
    way = p["amplitude_m"] * np.sin(phase)[:, None] * np.array(p["direction_seg"])
    still, moved = scene.point(segment, com), scene.point(segment, com + way)
    return _carried(p["mass_kg"], moved) - _carried(p["mass_kg"], still)


def _motor(scene: Scene, e: Entry, rng: np.random.Generator) -> np.ndarray:
    """An eccentric motor: a force that turns in the segment's x-z plane."""
    p, time = e["parameters"], scene.moved.time
    phase = 2.0 * np.pi * p["frequency_hz"] * time + rng.uniform(0.0, 2.0 * np.pi)
    own = p["force_N"] * np.stack([np.cos(phase), np.zeros(len(time)), np.sin(phase)], 1)
    force = np.einsum("tij,tj->ti", scene.moved.R[:, scene.moved.names[e["where"][0]]], own)
    return _pushed(scene.anchor(e), force)


LOADS: dict[str, Callable[[Scene, Entry, np.random.Generator], np.ndarray]] = {
    "grasped_object": _grasped_object, "unmeasured_contact": _unmeasured_contact, "external_force": _external_force,
    "body_weight_support": _body_weight_support, "tether": _tether, "drag": _drag, "wobbling_mass": _wobbling_mass,
    "flywheel": _flywheel, "offcat_water": _water, "offcat_magnet": _magnet, "offcat_inner_motion": _inner_motion,
    "offcat_motor": _motor,
}  # fmt: skip
