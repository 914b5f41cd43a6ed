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
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.effects.momentum import displaced
from torchid.effects.scene import Reading, Scene
from torchid.effects.sight import Sight, Slid, View
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
    follows: str | None = None
    """Coordinate whose angle the effect follows."""
    markers: tuple[str, ...] = ()
    """On the segment, where an effect has parameters for each."""


class Effect(ABC):
    """One entry of the catalogue."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    bodily: ClassVar[bool] = False
    """Every living body has some of it: named when it is there, and counted apart from errors of the laboratory."""
    recorded: ClassVar[bool] = False
    """What was written down of the subject is wrong, not what was measured."""
    kinematic: ClassVar[bool] = False
    """It changes what cameras see (``move``, ``slide``)."""
    anew: ClassVar[bool] = False
    """Its parameters are others in every trial."""
    accelerated: ClassVar[bool] = False
    """Its columns follow accelerations of the found motion, or the loads that they make: markers' noise shows."""
    late: ClassVar[bool] = False
    """It shifts the plates' readings in time."""
    curved: ClassVar[bool] = False
    """Its load is not linear in its parameters, but twice as much for twice all of them: columns taken where it was
    found, times its parameters there, are all of it (Euler)."""
    inverted: ClassVar[bool] = False
    """Its columns are what taking it out of the plates' readings takes away (``undone``)."""
    lasting: ClassVar[bool] = False
    """A state of single recordings: where it is in some, only another recording itself says whether it is there."""
    timed: ClassVar[bool] = False
    """It comes and goes: its places need intervals."""
    strewn: ClassVar[bool] = False
    """Living bodies do some of it at every place: what is named must stand out from the others. All its places have
    equally many parameters."""
    whole: ClassVar[bool] = False
    """Its one parameter is one, or it is not there."""

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Everywhere it could sit in a session."""
        raise NotImplementedError

    def finer(self, place: Place) -> tuple[Place, ...]:
        """The place with a finer course in time, worth its columns only where the effect is known to be."""
        return ()

    def period_s(self, place: Place) -> float:
        """Time after which it repeats itself; zero where it does not."""
        return 0.0

    def trusted(
        self, added: Float[Tensor, "frames 6"], rate_hz: float, place: Place, theta: Float[Tensor, " params"]
    ) -> Float[Tensor, "frames 6"]:
        """Of the wrench that it explains, what is believed of motion that it was not fitted to."""
        return added

    def source(self, place: Place) -> tuple[Place, tuple[str, ...] | None]:
        """Where its columns are those of ``place``, and the trials they are cut down to; None: all."""
        return place, None if place.when is None else tuple(dict.fromkeys(own.trial for own in place.when))

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        """Wrench about the origin of W that the ground must supply because of it."""
        return theta.new_zeros(6, len(scene.time))

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """What the plates then read."""
        return reading

    def undone(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """What plates that read this would have read without it."""
        return self.read(reading, place, -theta)

    def move(
        self, scene: Scene, place: Place, theta: Float[Tensor, " params"]
    ) -> Float[Tensor, "bodies 6 frames"] | None:
        """Displacement of bodies that the model holds elsewhere: of their origins [m] and rotation [rad], in W."""
        return None

    def courses(
        self, scene: Scene, place: Place
    ) -> tuple[Float[Tensor, "ways bodies 6 frames"], Float[Tensor, "modes frames"]] | None:
        """Displacements whose courses in time its parameters are coefficients of, way after way, if they are."""
        return None

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid | None:
        """How far cameras see markers from where the bodies carry them."""
        return None

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

    def stated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
        """The parameters as reported, with their standard deviations."""
        out = {}
        for key, value in self.named(place, theta).items():
            slope = torch.func.jacrev(lambda x, key=key: self.named(place, x)[key])(theta)
            flat = slope.reshape(-1, len(theta))
            out[key] = value, (flat @ covariance * flat).sum(1).sqrt().reshape(value.shape)
        return out

    def split(self, theta: Float[Tensor, " params"]) -> tuple[Tensor, ...]:
        """One part for each parameter."""
        return torch.split(theta, [p.size for p in self.parameters])

    def size(self, place: Place) -> int:
        """Number of internal parameters."""
        return sum(p.size for p in self.parameters)

    def scale(self, place: Place) -> tuple[float, ...]:
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
        moved = self.effect.move(scene, self.place, self.theta)
        load = self.effect.load(scene, self.place, self.theta)
        return load if moved is None else load + displaced(scene, moved[None])[0]

    def seen(self, sight: Sight) -> Float[Tensor, "markers 3 frames"]:
        """How far it takes the markers from where the model's bodies carry them [m]."""
        moved = self.effect.move(sight.scene, self.place, self.theta)
        slid = self.effect.slide(sight, self.place, self.theta)
        found = torch.zeros_like(sight.p) if moved is None else sight.carried(moved)
        if slid is not None:
            found[list(slid.which)] += slid.by
        return found

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
        reading: of the plates: as the effect found it, or left it if it is ``inverted``.
        place: where.
        theta: where to linearise; absent, where the effect is.
    """
    start = reading.wrench.new_zeros(effect.size(place)) if theta is None else theta
    found = reading.wrench.new_zeros(6, len(start), len(scene.time))
    if place.when is not None and all(own.trial != scene.trial for own in place.when):
        return found
    for k, scale in enumerate(effect.scale(place)):
        step = torch.zeros_like(start)
        step[k] = STEP * scale
        ahead = _total(effect, scene, reading, place, start + step)
        if theta is None and type(effect).read is Effect.read:
            # Absent, it loads nothing: half the work of central differences.
            found[:, k] = ahead / (STEP * scale)
        else:
            found[:, k] = (ahead - _total(effect, scene, reading, place, start - step)) / (2.0 * STEP * scale)
    return found


def _total(effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Tensor) -> Tensor:
    """Only what the effect has a say in: most of a catalogue's cost are loads."""
    found = reading.wrench.new_zeros(6, len(scene.time))
    if type(effect).load is not Effect.load:
        found = found + effect.load(scene, place, theta)
    if effect.inverted:
        return found - effect.undone(reading, place, theta).total
    return found if type(effect).read is Effect.read else found + effect.read(reading, place, theta).total


def anchor(scene: Scene, place: Place) -> Float[Tensor, " 3"]:
    """The point of the place's segment where the effect acts, in its axes."""
    return scene.centre(place.where[0]) if place.point is None else scene.phi.new_tensor(place.point)


def covers(place: Place, trial: str) -> bool:
    """Whether a place without segments or plates includes a trial."""
    return "session" in place.where or trial in place.where


EDGE_S = 0.1


def edge(place: Place) -> float:
    """How long what comes and goes takes to come, and to go [s]."""
    return place.grid.get("edge_s", EDGE_S)


def within(
    place: Place, trial: str, time: Float[Tensor, " frames"], edge_s: float | None = None
) -> Float[Tensor, " frames"]:
    """0 outside the place's intervals, 1 inside, risen along half a cosine of ``edge_s`` from their ends."""
    if place.when is None:
        return torch.ones_like(time)
    inside, edge_s = torch.zeros_like(time), edge(place) if edge_s is None else edge_s
    for interval in place.when:
        if interval.trial == trial:
            depth = torch.minimum(time - interval.t0, interval.t1 - time)
            depth = depth / edge_s if edge_s > 0.0 else torch.where(depth >= -1e-9, 1.0, 0.0)
            inside = torch.maximum(inside, 0.5 - 0.5 * torch.cos(torch.pi * depth.clamp(0.0, 1.0)))
    return inside


def inside_any(intervals: Sequence[Interval], trial: str, time: Float[Tensor, " frames"]) -> Bool[Tensor, " frames"]:
    """Whether frames of a trial are in any of the intervals."""
    found = torch.zeros_like(time, dtype=torch.bool)
    for one in intervals:
        if one.trial == trial:
            found |= (time >= one.t0) & (time <= one.t1)
    return found


def mean_within(place: Place) -> float:
    """Mean of ``within`` over the intervals; 1 throughout."""
    if place.when is None:
        return 1.0
    return 1.0 - edge(place) * len(place.when) / sum(own.t1 - own.t0 for own in place.when)
