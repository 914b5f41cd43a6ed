"""Masses that a segment carries, rigidly, on a spring, or spinning.

Sources: Atkeson, An & Hollerbach, IJRR 5 (1986), on loads of known inertia; Pain & Challis, J Biomech 39 (2006), on
wobbling masses; Lemus, Berry, Jabeen et al., Sci Rep 10 (2020), on worn gyroscopes.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.signal
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect, Parameter, anchor, value_of
from torchid.effects.marker_scene import View
from torchid.effects.place import Place
from torchid.effects.scene import Scene, lift, passing
from torchid.kinematics.recursion import cross

FREQUENCIES = (2.5, 2.9, 3.3, 3.9, 4.5, 5.2, 6.0, 7.0)
"""Of wobbling masses [Hz]: soft tissue and viscera (Wakeling & Nigg, J Appl Physiol 90, 2001). Half as many took 2.2 kg
at 4.1 Hz for 5.0 +- 0.7 kg at 5 Hz, and lost 19 nats."""
DAMPING = (0.1, 0.17, 0.3)
SOFT = 0.25
"""Prior standard deviation of a mass that wobbles, as a part of its segment's: 2 kg of a pelvis, 0.5 of an upper arm.
With 2 kg everywhere, most of an upper arm stood for as much of a thorax."""


class BodyMass(Effect):
    """The recorded mass is not the person's: plates and record disagree everywhere alike.

    A common gain of all plates does the same to the plates; only a second scale tells which. Internal is what the
    body weighs beyond the record, spread over it as its mass is.
    """

    name = "body_mass"
    on_record = True
    follows_acceleration = True
    parameters = (Parameter("excess_kg", 4.0),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (Place(("session",), grid={"recorded_kg": views[0].scene.recorded_kg}),)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        return theta / scene.mass * scene.needed()

    def rigid(self, scene: Scene, place: Place) -> Float[Tensor, "bodies 10 params"]:
        return (scene.phi / scene.mass)[:, :, None]

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        recorded = theta.new_tensor(place.grid["recorded_kg"])
        return {"mass_kg": recorded + theta[0], "recorded_kg": recorded}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "mass_kg", 1) - value_of(values, self.name, "recorded_kg", 1)


class Payload(Effect):
    """A mass fixed to a segment: weight beyond the recorded mass, inertia beyond the segment's prior.

    Internal are the mass and its first moment about the place's point; the inertia about its own centre is left out.
    Absent, it has no place, and its columns lack what the square of its distance does: a load on a head, told to
    0.01 kg and a centimetre, was refuted by a quick held-out trial.
    """

    name = "payload"
    follows_acceleration = nonlinear = True
    parameters = (Parameter("mass_kg", 2.0, positive=True), Parameter("moment_seg_kgm", 0.3, 3))

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(Place((n,), point=_centre(views[0].scene, n)) for n in views[0].scene.tree.names)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        """A point mass needs m (a - g); the moment of m p is linear in the first moment but for its square over m."""
        (segment,) = place.where
        mass, moment = self.split(theta)
        k, motion = scene.at(segment), scene.state.motion
        carrier = scene.point(segment, anchor(scene, place))
        arm = scene.turned(segment, moment)
        needed = carrier.a + lift(theta)
        swing = cross(motion.alpha[k], arm) + cross(motion.w[k], cross(motion.w[k], arm))
        force = mass * needed + swing
        square = torch.where(mass > 0.0, cross(arm, swing) / mass, 0.0)
        total = torch.cat([force, cross(carrier.p, force) + cross(arm, needed) + square])
        return total * passing(scene, place)

    def rigid(self, scene: Scene, place: Place) -> Float[Tensor, "bodies 10 params"] | None:
        """Mass, first moment and inertia of a point mass m at p, and of a moment d of it: m p p' + p d' + d p'."""
        if place.when is not None:
            return None
        p, eye = anchor(scene, place), torch.eye(3).to(scene.phi)
        sides = torch.cat([0.5 * p[None], eye])
        second = p[:, None] * sides[:, None] + sides[:, :, None] * p
        about = second.diagonal(dim1=1, dim2=2).sum(1)[:, None, None] * eye - second
        row, column = torch.tril_indices(3, 3)
        first = torch.cat([eye.new_tensor([[1.0, 0.0, 0.0, 0.0]]), torch.cat([p[:, None], eye], 1)])
        found = scene.phi.new_zeros(len(scene.tree.bodies), 10, 4)
        found[scene.tree.index(place.where[0])] = torch.cat([first, about[:, row, column].T])
        return found

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        mass, moment = self.split(theta)
        return {"mass_kg": mass[0], "point_seg_m": theta.new_tensor(_point(place)) + moment / mass}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        mass = value_of(values, self.name, "mass_kg", 1)
        arm = value_of(values, self.name, "point_seg_m", 3) - torch.tensor(_point(place), dtype=torch.float64)
        return torch.cat([mass, mass * arm])


class GraspedObject(Payload):
    """A payload of a hand that comes and goes."""

    name = "grasped_object"
    intermittent = True
    nonlinear = False

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(place for place in super().places(views) if place.where[0].startswith("hand"))


def _centre(scene: Scene, segment: str) -> tuple[float, float, float]:
    x, y, z = scene.centre(segment).tolist()
    return x, y, z


def _point(place: Place) -> tuple[float, float, float]:
    assert place.point is not None, "a payload's place has a point"
    return place.point


class WobblingMass(Effect):
    """Part of a segment's mass on a damped spring: it lags after quick stops and overshoots.

    The mass is the segment's own. What its motion relative to the bone adds is m x'' at the centre of mass, and
    m x cross (a - g), with x'' + 2 z w x' + w^2 x = g - a: it also sags, always downwards, however the segment leans.
    """

    name = "wobbling_mass"
    follows_acceleration = True
    bodily = True
    parameters = (Parameter("mass_kg", 2.0, positive=True),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        scene = views[0].scene
        heavy = [n for n in scene.tree.names if not n.startswith(("hand", "foot", "forearm", "head"))]
        grids = [{"frequency_hz": f, "damping_ratio": z} for f in FREQUENCIES for z in DAMPING]
        own = {name: {"segment_kg": float(scene.phi[scene.tree.index(name), 0])} for name in heavy}
        return tuple(Place((name,), grid=grid | own[name]) for name in heavy for grid in grids)

    def scale(self, place: Place) -> tuple[float, ...]:
        return (SOFT * place.grid["segment_kg"],) if "segment_kg" in place.grid else super().scale(place)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        return theta * self.loads(scene, (place,))[0]

    def loads(self, scene: Scene, places: Sequence[Place]) -> Float[Tensor, "places 6 frames"]:
        """Springs of one point share its motion, and points on one spring its filters."""
        own = [(place.grid["frequency_hz"], place.grid["damping_ratio"]) for place in places]
        springs, points = list(dict.fromkeys(own)), {(place.where, place.point): place for place in places}
        at = [scene.point(place.where[0], anchor(scene, place)) for place in points.values()]
        p, a = torch.stack([one.p for one in at]), torch.stack([one.a for one in at])
        x, xdd = wobble(a, scene.rate, springs)
        w = 2.0 * math.pi * x.new_tensor([frequency for frequency, _ in springs])
        sag = -lift(x) / w.square()[:, None, None]
        moment = cross(p[:, None], xdd) + cross(x + sag, (a + lift(x))[:, None])
        found, point = torch.cat([xdd, moment], 2), {key: k for k, key in enumerate(points)}
        return found[[point[place.where, place.point] for place in places], [springs.index(spring) for spring in own]]

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        spring = {key: theta.new_tensor(place.grid[key]) for key in ("frequency_hz", "damping_ratio")}
        return super().named(place, theta) | spring

    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
        """Frequency and damping are known to a step of their grids; slowly shaken, a mass shows over that squared."""
        found, part = super().estimated(place, theta, covariance), _grain(FREQUENCIES)
        (mass, sd), (frequency, _), (damping, _) = (found[k] for k in ("mass_kg", "frequency_hz", "damping_ratio"))
        return found | {
            "mass_kg": (mass, torch.hypot(sd, 2.0 * part * mass)),
            "frequency_hz": (frequency, part * frequency),
            "damping_ratio": (damping, _grain(DAMPING) * damping),
        }


def _grain(grid: Sequence[float]) -> float:
    """Standard deviation of what is rounded to a geometric grid, over its value."""
    return math.log(grid[-1] / grid[0]) / (len(grid) - 1) / math.sqrt(12.0)


def wobble(
    a: Float[Tensor, "points 3 frames"], rate_hz: float, springs: Sequence[tuple[float, float]]
) -> tuple[Float[Tensor, "points springs 3 frames"], Float[Tensor, "points springs 3 frames"]]:
    """Place and acceleration of masses on springs relative to their accelerated carriers, at rest before the start.

    Args:
        a: acceleration of each carrier.
        rate_hz: of its samples.
        springs: frequency [Hz] and damping ratio of each.
    """
    force = a - a[..., :1]
    forced = _curved(force.detach().cpu().numpy())
    found = np.empty((2, len(a), len(springs), *a.shape[1:]))
    for k, own in enumerate(springs):
        found[:, :, k] = _on_spring(forced, rate_hz, *own)
    place, speed = torch.as_tensor(found, dtype=a.dtype, device=a.device)
    frequency, damping = place.new_tensor(springs).T[:, :, None, None]
    w = 2.0 * math.pi * frequency
    return place, speed.mul(-2.0 * damping * w).addcmul_(w.square(), place, value=-1.0).sub_(force[:, None])


def _curved(force: np.ndarray) -> np.ndarray:
    """Samples whose straight lines do what a smooth course through the given ones does.

    A line through it is h^2 / 12 f'' higher in the mean: at 50 frames/s, 7 Hz came out 6 % too weak.
    """
    bent = force.copy()
    bent[..., 1:-1] -= np.diff(force, 2) / 12.0
    return bent


def _on_spring(force: np.ndarray, rate_hz: float, frequency_hz: float, damping_ratio: float) -> np.ndarray:
    """Place and speed."""
    both, own = _spring(rate_hz, frequency_hz, damping_ratio)
    return np.stack([scipy.signal.lfilter(one, own, force) for one in both])


@lru_cache(maxsize=64)
def _spring(rate_hz: float, frequency_hz: float, damping_ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Filters that the spring is, for place and speed, forced along straight lines."""
    w = 2.0 * math.pi * frequency_hz
    system = [[0.0, -1.0], [-1.0, 0.0]], [1.0, 2.0 * damping_ratio * w, w * w]
    discrete: Any = scipy.signal.cont2discrete(system, 1.0 / rate_hz, "foh")
    return discrete[0], np.ravel(discrete[1])


class Flywheel(Effect):
    """A rotor of constant momentum in a segment: it resists turning across its axis (a gyroscope, a running motor)."""

    name = "flywheel"
    parameters = (Parameter("momentum_seg_Nms", 1.0, 3),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(Place((name,)) for name in views[0].scene.tree.names)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        (segment,) = place.where
        moment = cross(scene.state.motion.w[scene.at(segment)], scene.turned(segment, theta))
        return torch.cat([torch.zeros_like(moment), moment])
