"""What a diagnosis says: causes with their parameters, rivals and confidence, and what they gain."""

import math
from dataclasses import dataclass, field, replace

from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.testing.heldout import Errors
from torchid.effects.catalogue import effect
from torchid.effects.effect import Planted
from torchid.effects.place import Interval, Place
from torchid.observation.plate_registry import SessionPlate

RIVALS = 4
"""Alternatives that are listed at most."""


@dataclass(frozen=True)
class Alternative:
    """Another explanation."""

    effect: str
    where: tuple[str, ...]
    confidence: float


@dataclass(frozen=True)
class Twin(Alternative):
    """One that cannot be told from the cause."""

    place: Place | None = None
    parameters: dict[str, dict[str, Tensor]] | None = None
    """In place of the cause, as there; both None where that needs another search."""


@dataclass(frozen=True)
class Cause:
    """An effect that the data support."""

    effect: str
    where: tuple[str, ...]
    when: tuple[Interval, ...] | None
    parameters: dict[str, dict[str, Tensor]]
    """``value`` and ``sd`` by key."""
    confidence: float
    """Probability that it, or one that cannot be told from it, is there."""
    alternatives: tuple[Alternative, ...]
    indistinguishable: tuple[Twin, ...]
    gain: dict[str, float]
    """Held-out, of this cause on top of the others."""
    place: Place
    theta: Float[Tensor, "blocks params"]
    """Internal parameters, see ``Effect``; one row, or one for each of the trials."""
    trials: tuple[str, ...]
    """In which it acts."""
    everywhere: bool
    """In all fit trials, and therefore in others too."""
    doubted: bool = False
    """What contradicts the model, or cannot be checked, has been taken off the confidence."""

    def scaled(self, factor: float) -> "Cause":
        """As many times as sure, and so of its rivals."""
        alternatives, twins = (
            tuple(replace(one, confidence=factor * one.confidence) for one in some)
            for some in (self.alternatives, self.indistinguishable)
        )
        confidence = factor * self.confidence
        return replace(self, confidence=confidence, alternatives=alternatives, indistinguishable=twins)

    def on(self, trial: str) -> Planted | None:
        """As it acts in a trial, None where it does not or nobody knows."""
        own, place = effect(self.effect), self.place
        if own.per_recording and place.when is not None:
            # Of a long recording a part was searched; what was knocked stayed so in all of it.
            place = replace(place, when=tuple(Interval(i.trial, -math.inf, math.inf) for i in place.when))
        if trial in self.trials:
            return Planted(own, place, self.theta[self.trials.index(trial) if own.per_trial else 0])
        return Planted(own, place, self.theta[0]) if self.everywhere and not own.per_trial else None


@dataclass(frozen=True)
class Near:
    """An effect that was not named, at its best place."""

    effect: str
    where: tuple[str, ...]
    evidence_nats: float
    """Of the effect, averaged over its places; ``NAMED`` would name it."""


@dataclass(frozen=True)
class Refuted:
    """A cause that fit trials named and held-out motion speaks against; the model was not extended by it."""

    effect: str
    where: tuple[str, ...]
    heldout_log_likelihood: float
    """What it gained there; where it acts on forces alone, that of the forces after what cameras saw. Less than
    ``-REFUTED``, unless both forces and moments err plainly more with it."""
    instead: tuple[str, ...] | None = None
    """Where it sits as held-out motion has it, among places that fit trials support nearly as well."""


@dataclass(frozen=True)
class Diagnosis:
    """What the model gets wrong, and why."""

    plates: tuple[SessionPlate, ...]
    baseline: Errors
    extended: Errors
    causes: tuple[Cause, ...]
    unexplained: Adequacy
    not_testable: dict[str, str] = field(default_factory=dict)
    """Why, by effect."""
    nearest: tuple["Near", ...] = ()
    """What came closest to being named beside the causes, best first."""
    refuted: tuple["Refuted", ...] = ()
    aside: tuple[Interval, ...] = ()
    """What no model was fitted to, or should be: something unmeasured bears a good part of the weight."""
