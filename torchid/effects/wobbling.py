"""Soft mass on springs.

Sources: Pain & Challis, J Biomech 39 (2006), on wobbling masses; Wakeling & Nigg, J Appl Physiol 90 (2001), on
frequencies and damping of soft tissue.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, final

import numpy as np
import scipy.signal
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Estimates
from torchid.effects.kinds import AttachedLoad
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter, by_key, propagated
from torchid.effects.place import Place
from torchid.effects.quantities import NamedEffect, of, size
from torchid.effects.scene import Scene, anchor, lift
from torchid.effects.traits import ColumnNoise, Origin, Site
from torchid.kinematics.recursion import cross
from torchid.wording import number, percent

FREQUENCIES = (2.5, 2.9, 3.3, 3.9, 4.5, 5.2, 6.0, 7.0)
"""Estimator. Frequencies of wobbling masses [Hz], a choice for viscera and large soft tissue: below those of impacts in
running, at which Wakeling & Nigg (2001) found that soft tissue of the leg rings."""
DAMPING = (0.1, 0.17, 0.3)
"""Estimator. Damping ratios of wobbling masses, a choice."""
SOFT = 0.25
"""Estimator. Prior standard deviation of a wobbling mass, as a part of its segment's: 2 kg of a pelvis, 0.5 of an upper
arm."""


@final
class WobblingMass(AttachedLoad):
    """Part of a segment's mass on a damped spring: it lags after quick stops and overshoots.

    The mass is the segment's own. What its motion relative to the bone adds is m x'' at the centre of mass, and
    m x cross (a - g), with x'' + 2 z w x' + w^2 x = g - a: it also sags, always downwards, however the segment leans.
    """

    name = "wobbling_mass"
    origin = Origin.BODY
    site = Site.SEGMENT
    column_noise = ColumnNoise.CORRECTED
    grid_keys = ("frequency_hz", "damping_ratio")
    parameters = (
        Parameter("mass_kg", 2.0, positive=True, source="a choice: a quarter of a pelvis; where a place says how heavy "
                  "its segment is, a quarter of that, about what is soft of a segment and loose"),
    )  # fmt: skip
    noun = "a wobbling mass"
    link = "of"
    advice = "quick stops and heel drops, which let soft mass ring on"
    apart = {"wobbling_mass": "heel drops with the trunk upright and bent"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Heavy segments, with every frequency and damping ratio of the grids."""
        scene = views[0].scene
        heavy = [n for n in scene.tree.names if not n.startswith(("hand", "foot", "forearm", "head"))]
        grids = [{"frequency_hz": f, "damping_ratio": z} for f in FREQUENCIES for z in DAMPING]
        own = {name: {"segment_kg": float(scene.phi[scene.tree.index(name), 0])} for name in heavy}
        return tuple(Place((name,), grid=grid | own[name]) for name in heavy for grid in grids)

    def scale(self, place: Place) -> tuple[float, ...]:
        """A part of the segment's mass, where the place says how heavy that is."""
        (mass,) = self.parameters
        return (SOFT * place.grid["segment_kg"] if "segment_kg" in place.grid else mass.scale,)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        return theta * self.loads(scene, (place,))[0]

    def loads(self, scene: Scene, places: Sequence[Place]) -> Float[Tensor, "places 6 frames"]:
        """Unit loads: springs of one point share its motion, and points on one spring its filters."""
        own = [(place.grid["frequency_hz"], place.grid["damping_ratio"]) for place in places]
        springs, points = list(dict.fromkeys(own)), {(place.where, place.point): place for place in places}
        at = [scene.point(place.where[0], anchor(scene, place)) for place in points.values()]
        p, a = torch.stack([one.p for one in at]), torch.stack([one.a for one in at])
        rest = torch.stack(
            [scene.span.point(place.where[0], anchor(scene, place)).a[:, :1] for place in points.values()]
        )
        x, xdd = wobble(a, scene.rate, springs, rest)
        w = 2.0 * math.pi * x.new_tensor([frequency for frequency, _ in springs])
        sag = -lift(x) / w.square()[:, None, None]
        moment = cross(p[:, None], xdd) + cross(x + sag, (a + lift(x))[:, None])
        found, point = torch.cat([xdd, moment], 2), {key: k for k, key in enumerate(points)}
        return found[[point[place.where, place.point] for place in places], [springs.index(spring) for spring in own]]

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        spring = {key: theta.new_tensor(place.grid[key]) for key in self.grid_keys}
        return by_key(self.parameters, theta) | spring

    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> Estimates:
        """Frequency and damping are known to a step of their grids; slowly shaken, a mass shows over that squared."""
        found = propagated(lambda x: self.named(place, x), theta, covariance)
        (mass, sd), (frequency, _), (damping, _) = (found[k] for k in ("mass_kg", "frequency_hz", "damping_ratio"))
        part = _grain(FREQUENCIES)
        return found | {
            "mass_kg": (mass, torch.hypot(sd, 2.0 * part * mass)),
            "frequency_hz": (frequency, part * frequency),
            "damping_ratio": (damping, _grain(DAMPING) * damping),
        }

    def sentence(self, finding: NamedEffect) -> str:
        frequency, damping = of(finding, "frequency_hz")[0], of(finding, "damping_ratio")[0]
        return (
            f"{size(finding, 'mass_kg', 'kg')} of the mass of {self.located(finding.where)} lag behind the bone and "
            f"ring at about {number(frequency[0])} Hz, damped by {percent(damping[0])} of the critical"
        )


def _grain(grid: Sequence[float]) -> float:
    """Standard deviation of a value that is rounded to a geometric grid, over that value."""
    return math.log(grid[-1] / grid[0]) / (len(grid) - 1) / math.sqrt(12.0)


def wobble(
    a: Float[Tensor, "points 3 frames"],
    rate_hz: float,
    springs: Sequence[tuple[float, float]],
    rest: Float[Tensor, "points 3 1"] | None = None,
) -> tuple[Float[Tensor, "points springs 3 frames"], Float[Tensor, "points springs 3 frames"]]:
    """Masses on springs relative to their accelerated carriers, at rest before the start.

    Args:
        a: acceleration of each carrier [m/s^2].
        rate_hz: samples per second.
        springs: frequency [Hz] and damping ratio of each.
        rest: acceleration of each carrier at which masses count as at rest [m/s^2]; None: the first.

    Returns:
        Place [m] and acceleration [m/s^2] of each mass on each spring.
    """
    force = a - (a[..., :1] if rest is None else rest)
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

    In the mean, a line through the samples of a course f is h^2 / 12 f'' higher than the course.
    """
    bent = force.copy()
    bent[..., 1:-1] -= np.diff(force, 2) / 12.0
    return bent


def _on_spring(force: np.ndarray, rate_hz: float, frequency_hz: float, damping_ratio: float) -> np.ndarray:
    """Place and speed of a mass on one spring, stacked."""
    both, own = _spring(rate_hz, frequency_hz, damping_ratio)
    return np.stack([scipy.signal.lfilter(one, own, force) for one in both])


@lru_cache(maxsize=64)
def _spring(rate_hz: float, frequency_hz: float, damping_ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """The spring as digital filters, numerators (for place and speed) and denominator, forced along straight lines."""
    w = 2.0 * math.pi * frequency_hz
    system = [[0.0, -1.0], [-1.0, 0.0]], [1.0, 2.0 * damping_ratio * w, w * w]
    discrete: Any = scipy.signal.cont2discrete(system, 1.0 / rate_hz, "foh")
    return discrete[0], np.ravel(discrete[1])
