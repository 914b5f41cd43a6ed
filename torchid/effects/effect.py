"""The base class of effects, and an effect that sits somewhere with values (``Planted``).

Every effect is one object that plants itself in a simulation, predicts itself in a fit and tells itself in a report.
Classes are abstract or final. A final class is of one of the kinds of ``effects.kinds``, which say what it acts on;
declares its member of each enumeration of ``effects.traits``, unless it is the default; and has the words of
``effects.described``. A method that is not marked ``@final`` is a default, which is replaced at most once.
"""

from abc import ABC
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.described import Described
from torchid.effects.displacement import displaced
from torchid.effects.evidence import TrialEvidence
from torchid.effects.intervals import in_intervals
from torchid.effects.marker_scene import Sight, Slid, Sway, View
from torchid.effects.parameter import Parameter, by_key, propagated, stacked
from torchid.effects.place import Place
from torchid.effects.scene import Reading, Scene
from torchid.effects.traits import ColumnNoise, Correction, Traits
from torchid.geometry.result import GeometryFit

Estimates = dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]
"""Value and standard deviation of reported parameters, by key."""


@dataclass(frozen=True)
class Ordinary:
    """A place of an effect that is integrated out, with the prior of its parameters there."""

    place: Place
    mean: tuple[float, ...]
    sd: tuple[float, ...]


class Effect(Traits, Described, ABC):
    """One entry of the catalogue, or a nuisance of the same build."""

    name: ClassVar[str]
    """Name in ``diagnosis.json``."""
    parameters: ClassVar[tuple[Parameter, ...]]
    grid_keys: ClassVar[tuple[str, ...]] = ()
    """Reported parameters that a place's grid holds, see ``grid``."""

    @final
    @property
    def moves_markers(self) -> bool:
        """True if it changes what cameras see."""
        return isinstance(self, MarkerEffect)

    # Where and when.

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Return all places in a session, of which the trials are given, at which it could sit."""
        raise NotImplementedError

    def propose(self, observed: Sequence[TrialEvidence]) -> tuple[Place, ...]:
        """The places that are worth columns: all, or, where it comes and goes, in intervals that residuals suggest."""
        places = self.places([one.view for one in observed])
        return in_intervals(places, observed) if self.intermittent else places

    def ordinary(self, views: Sequence[View], fit: GeometryFit | None) -> Iterator[Ordinary]:
        """Yield the places at which every recording has a little of it, which are integrated out and never named.

        Args:
            views: of the trials.
            fit: with which they were followed; None where no camera is at hand.
        """
        yield from ()

    def finer(self, place: Place) -> tuple[Place, ...]:
        """The place with a finer course in time, worth its columns only where the effect is known to be."""
        return ()

    def untested(self, views: Sequence[View], plates: Sequence[str]) -> str:
        """Return why it cannot be tested at some places in a session; empty where it can be.

        Args:
            views: of the fit trials.
            plates: names of all plates of the session.
        """
        return ""

    def period_s(self, place: Place) -> float:
        """Time after which it repeats itself [s]; zero where it does not."""
        return 0.0

    def source(self, place: Place) -> tuple[Place, tuple[str, ...] | None]:
        """Another place that has the same columns, and the trials that these are cut down to; None: all."""
        return place, None if place.when is None else tuple(dict.fromkeys(own.trial for own in place.when))

    def grid(self, values: Mapping[str, Tensor]) -> dict[str, float]:
        """The grid of the place at which these reported parameters are planted."""
        return {key: float(values[key]) for key in self.grid_keys if key in values}

    # What it does: nothing, but for what its kind makes abstract.

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        """Wrench about the origin of W that the ground must supply because of it [N, N m]."""
        return theta.new_zeros(6, len(scene.time))

    def rigid(self, scene: Scene, place: Place) -> Float[Tensor, "bodies 10 params"] | None:
        """Return its share of the bodies' inertial parameters, if its load is no more than that."""
        return None

    def loads(self, scene: Scene, places: Sequence[Place]) -> Float[Tensor, "places 6 frames"] | None:
        """Return its unit loads at several places, if it knows a way to make them at once."""
        return None

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """Return the plates' reading of what they bear."""
        return reading

    def undone(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """Return the reading that plates with this one would have had without it."""
        return self.read(reading, place, -theta)

    def move(
        self, scene: Scene, place: Place, theta: Float[Tensor, " params"]
    ) -> Float[Tensor, "bodies 6 frames"] | None:
        """Displacement of bodies that the model holds elsewhere: of their origins [m] and rotation [rad], in W."""
        return None

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid | None:
        """Return the markers that cameras see elsewhere than the bodies carry them."""
        return None

    def sway(self, sight: Sight, place: Place) -> Sway | None:
        """Return what ``move`` and ``slide`` do, if that is fixed ways times courses in time."""
        return None

    def beneath(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Sight:
        """The sight of a motion that was seen with it, as ``slide`` wants it."""
        return sight

    def trusted(
        self, added: Float[Tensor, "frames 6"], rate_hz: float, place: Place, theta: Float[Tensor, " params"]
    ) -> Float[Tensor, "frames 6"]:
        """The part of the wrench that it explains that is believed of motion that it was not fitted to."""
        return added

    # Its parameters.

    def scale(self, place: Place) -> tuple[float, ...]:
        """Prior standard deviations of the internal parameters."""
        return tuple(p.scale for p in self.parameters for _ in range(p.size))

    @final
    def size(self, place: Place) -> int:
        """Number of internal parameters."""
        return len(self.scale(place))

    @final
    def split(self, theta: Float[Tensor, " params"]) -> tuple[Tensor, ...]:
        """One part of theta for each of ``parameters``."""
        return torch.split(theta, [p.size for p in self.parameters])

    def positives(self, place: Place) -> int:
        """Return the number of internal parameters that are never negative; they are the first ones."""
        return self.parameters[0].size if self.parameters[0].positive else 0

    def part_of(self, own: Place, effect: "Effect", place: Place) -> Float[Tensor, "params own"] | None:
        """Return the matrix from its parameters to those of another effect, if it is part of that."""
        return None

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        """Reported parameters by key, from internal ones."""
        return by_key(self.parameters, theta)

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """The inverse of ``named``.

        Raises:
            ConfigError: a parameter is missing or has another size.
        """
        return stacked(self.parameters, values, self.name)

    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> Estimates:
        """Reported parameters with their standard deviations, from mean and covariance of the internal ones."""
        return propagated(lambda x: self.named(place, x), theta, covariance)


class MarkerEffect(Effect):
    """An effect on what cameras see; abstract, of one of the two kinds of ``effects.kinds``."""

    column_noise = ColumnNoise.SHRUNK
    correction = Correction.MARKERS


@dataclass(frozen=True)
class Planted:
    """An effect at a place, with internal parameters."""

    effect: Effect
    place: Place
    theta: Float[Tensor, " params"]

    def load(self, scene: Scene) -> Float[Tensor, "6 frames"]:
        """Wrench about the origin of W that the ground must supply because of it [N, N m]."""
        moved = self.effect.move(scene, self.place, self.theta)
        load = self.effect.load(scene, self.place, self.theta)
        return load if moved is None else load + displaced(scene, moved[None])[0]

    def seen(self, sight: Sight) -> Float[Tensor, "markers 3 frames"]:
        """Return the displacement of the markers from where the model's bodies carry them, in W [m]."""
        moved = self.effect.move(sight.scene, self.place, self.theta)
        slid = self.effect.slide(sight, self.place, self.theta)
        found = torch.zeros_like(sight.p) if moved is None else sight.carried(moved)
        if slid is not None:
            found[list(slid.which)] += slid.by
        return found

    def read(self, reading: Reading) -> Reading:
        """Return the plates' reading of what they bear."""
        return self.effect.read(reading, self.place, self.theta)
