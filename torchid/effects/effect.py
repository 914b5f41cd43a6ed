"""What an effect is: a name, places, parameters with priors, and how it changes what the plates read.

Every effect is one object that plants itself in a simulation and predicts itself in a fit. It changes the wrench that
the ground must supply (``load``), or what the plates make of it (``read``), or both; parameters are zero where it is
absent.
"""

from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.displacement import displaced
from torchid.effects.marker_scene import Sight, Slid, Sway, View
from torchid.effects.place import Place
from torchid.effects.scene import Reading, Scene
from torchid.errors import ConfigError


@dataclass(frozen=True)
class Parameter:
    """One internal parameter of an effect, scalar or vector, zero where the effect is absent."""

    key: str
    """With its unit, as in ``mass_kg``."""
    scale: float
    """Standard deviation of the prior of each component."""
    size: int = 1
    positive: bool = False


class Effect(ABC):
    """One entry of the catalogue."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    bodily: ClassVar[bool] = False
    """Every living body has some of it: named when it is there, and counted apart from errors of the laboratory."""
    whole_body: ClassVar[bool] = False
    """It is all over the body at once: however many single places are named, it is looked for beside them."""
    on_record: ClassVar[bool] = False
    """What was written down of the subject is wrong, not what was measured."""
    moves_markers: ClassVar[bool] = False
    """It changes what cameras see (``move``, ``slide``)."""
    per_trial: ClassVar[bool] = False
    """Its parameters are others in every trial."""
    follows_acceleration: ClassVar[bool] = False
    """Its columns follow accelerations of the found motion, or the loads that they make: markers' noise shows. If it
    changes readings, it maps every sample alike and linearly."""
    shifts_time: ClassVar[bool] = False
    """It shifts the plates' readings in time."""
    nonlinear: ClassVar[bool] = False
    """What it does is not linear in its parameters, but columns taken where it was found, times its parameters there,
    are all of it."""
    reads_measured: ClassVar[bool] = False
    """Its columns are what taking it out of the plates' readings takes away (``undone``)."""
    per_recording: ClassVar[bool] = False
    """A state of single recordings: where it is in some, only another recording itself says whether it is there."""
    intermittent: ClassVar[bool] = False
    """It comes and goes: its places need intervals."""
    widespread: ClassVar[bool] = False
    """Living bodies do some of it at every place: what is named must stand out from the others. All its places have
    equally many parameters."""
    all_or_nothing: ClassVar[bool] = False
    """Its one parameter is one, or it is not there."""

    @property
    def noisy(self) -> bool:
        """Its columns are accelerations that were found, or loads that these make, and hold the markers' noise; in what
        goes with places or speeds, as ropes and drag do, it is neglected."""
        return self.moves_markers or self.follows_acceleration

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

    def rigid(self, scene: Scene, place: Place) -> Float[Tensor, "bodies 10 params"] | None:
        """What it adds to the inertial parameters of the bodies, if its load is no more than that."""
        return None

    def loads(self, scene: Scene, places: Sequence[Place]) -> Float[Tensor, "places 6 frames"] | None:
        """Its unit loads at several places, where it knows a way to make them at once."""
        return None

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

    def sway(self, sight: Sight, place: Place) -> Sway | None:
        """The same as ``move`` and ``slide``, where it is fixed ways times courses in time."""
        return None

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid | None:
        """How far cameras see markers from where the bodies carry them."""
        return None

    def beneath(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Sight:
        """The sight of a motion that was seen with it, as ``slide`` wants it."""
        return sight

    def positives(self, place: Place) -> int:
        """How many of the internal parameters, the first ones, are never negative."""
        return self.parameters[0].size if self.parameters[0].positive else 0

    def weighs(self, place: Place) -> bool:
        """Whether it is that all weight is wrong by a factor, which inertia takes on."""
        return self.on_record

    def part_of(self, own: Place, effect: "Effect", place: Place) -> Float[Tensor, "params own"] | None:
        """What its parameters at its own place add to those of another effect, where it is part of that."""
        return None

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        """What internal parameters amount to: values by key, as they are reported."""
        parts = zip(self.parameters, self.split(theta), strict=True)
        return {p.key: part[0] if p.size == 1 else part for p, part in parts}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """The inverse of ``named``.

        Raises:
            ConfigError: a parameter is missing or has another size.
        """
        return torch.cat([value_of(values, self.name, p.key, p.size) for p in self.parameters])

    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
        """The parameters as reported, with their standard deviations, from the posterior of the internal ones."""
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


def anchor(scene: Scene, place: Place) -> Float[Tensor, " 3"]:
    """The point of the place's segment where the effect acts, in its axes."""
    return scene.centre(place.where[0]) if place.point is None else scene.phi.new_tensor(place.point)
