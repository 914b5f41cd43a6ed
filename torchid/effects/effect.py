"""What an effect is: a name, places, parameters with priors, and how it changes what the plates read.

Every effect is one object that plants itself in a simulation and predicts itself in a fit. It changes the wrench that
the ground must supply (``load``), or what the plates make of it (``read``), or both; parameters are zero where it is
absent.
"""

from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.scene import Reading, Scene
from torchid.errors import ConfigError

STEP = 1e-3
"""Of the central differences, in prior standard deviations: exact for parameters that act linearly."""


@dataclass(frozen=True)
class Parameter:
    """One internal parameter of an effect, scalar or vector, zero where the effect is absent."""

    key: str
    """With its unit, as in ``mass_kg``."""
    scale: float
    """Standard deviation of the prior of each component."""
    size: int = 1
    positive: bool = False


@dataclass(frozen=True)
class Interval:
    """Part of a trial [s]."""

    trial: str
    t0: float
    t1: float


@dataclass(frozen=True)
class Place:
    """Where an effect sits."""

    where: tuple[str, ...]
    """Segments, plates (``plate_1``), trials, or ``session``."""
    when: tuple[Interval, ...] | None = None
    """None: throughout."""
    point: tuple[float, float, float] | None = None
    """On the segment, where the effect acts, in its axes [m]; None: its centre of mass."""
    grid: dict[str, float] = field(default_factory=dict)
    """Values of parameters that no column can be linear in, such as a frequency."""
    odds: float = 1.0
    """How likely before any data, against the effect's other places."""


class Effect(ABC):
    """One entry of the catalogue."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    alike: ClassVar[tuple[str, ...]] = ()
    """Effects that it is easily taken for."""

    def places(self, scenes: Sequence[Scene], readings: Sequence[Reading]) -> tuple[Place, ...]:
        """Everywhere it could sit in a session."""
        raise NotImplementedError

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        """Wrench about the origin of W that the ground must supply because of it."""
        return theta.new_zeros(6, len(scene.time))

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """What the plates then read."""
        return reading

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        """The parameters as reported: values by key."""
        parts = zip(self.parameters, self.split(theta), strict=True)
        return {p.key: part[0] if p.size == 1 else part for p, part in parts}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """The inverse of ``named``.

        Raises:
            ConfigError: a parameter is missing or has another size.
        """
        return torch.cat([value_of(values, self.name, p.key, p.size) for p in self.parameters])

    def split(self, theta: Float[Tensor, " params"]) -> tuple[Tensor, ...]:
        """One part for each parameter."""
        return torch.split(theta, [p.size for p in self.parameters])

    @property
    def size(self) -> int:
        """Number of internal parameters."""
        return sum(p.size for p in self.parameters)

    @property
    def scale(self) -> tuple[float, ...]:
        """Prior standard deviations of all of them."""
        return tuple(p.scale for p in self.parameters for _ in range(p.size))


def value_of(values: dict[str, Tensor], effect: str, key: str, size: int) -> Float[Tensor, " size"]:
    """A reported parameter as a vector.

    Raises:
        ConfigError: it is missing or has another size.
    """
    found = torch.as_tensor(values[key], dtype=torch.float64).reshape(-1) if key in values else None
    if found is None or len(found) != size:
        raise ConfigError(
            "effect.parameters", f"needs {key} with {size} value{'s' if size > 1 else ''}", place=effect,
            found=", ".join(values) or "no parameters", remedy="Give every parameter of the effect",
        )  # fmt: skip
    return found


@dataclass(frozen=True)
class Planted:
    """An effect at a place, with values."""

    effect: Effect
    place: Place
    theta: Float[Tensor, " params"]

    def load(self, scene: Scene) -> Float[Tensor, "6 frames"]:
        """Wrench that the ground must supply because of it."""
        return self.effect.load(scene, self.place, self.theta)

    def read(self, reading: Reading) -> Reading:
        """What the plates then read."""
        return self.effect.read(reading, self.place, self.theta)


def columns(
    effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Float[Tensor, " params"] | None = None
) -> Float[Tensor, "6 params frames"]:
    """Change of the plates' total per internal parameter; scene and reading on one clock.

    Args:
        effect: which.
        scene: motion and inertia as estimated.
        reading: of the plates, as measured: what a map of plates acts on is known from it well enough.
        place: where.
        theta: where to linearise; absent, where the effect is.
    """
    theta = reading.wrench.new_zeros(effect.size) if theta is None else theta
    found = []
    for k, scale in enumerate(effect.scale):
        step = torch.zeros_like(theta)
        step[k] = STEP * scale
        ahead, behind = (_total(effect, scene, reading, place, theta + sign * step) for sign in (1.0, -1.0))
        found.append((ahead - behind) / (2.0 * STEP * scale))
    return torch.stack(found, 1)


def _total(effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Tensor) -> Tensor:
    return effect.load(scene, place, theta) + effect.read(reading, place, theta).total


def anchor(scene: Scene, place: Place) -> Float[Tensor, " 3"]:
    """The point of the place's segment where the effect acts, in its axes."""
    return scene.centre(place.where[0]) if place.point is None else scene.phi.new_tensor(place.point)


def covers(place: Place, trial: str) -> bool:
    """Whether a place without segments or plates includes a trial."""
    return "session" in place.where or trial in place.where


def within(place: Place, trial: str, time: Float[Tensor, " frames"], edge_s: float = 0.1) -> Float[Tensor, " frames"]:
    """1 inside the place's intervals and 0 outside, risen along half a cosine of ``edge_s`` about their ends."""
    if place.when is None:
        return torch.ones_like(time)
    inside = torch.zeros_like(time)
    for interval in place.when:
        if interval.trial == trial:
            depth = torch.minimum(time - interval.t0, interval.t1 - time) / edge_s
            inside = torch.maximum(inside, 0.5 - 0.5 * torch.cos(torch.pi * (depth + 0.5).clamp(0.0, 1.0)))
    return inside
