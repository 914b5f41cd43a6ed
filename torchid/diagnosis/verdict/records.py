"""Records of a diagnosis: causes with their parameters, rivals and confidence, and what they gain."""

import math
from dataclasses import dataclass, field, replace

from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.evidence.detectable import Detectable
from torchid.diagnosis.evidence.earlier_sessions import Unlike
from torchid.diagnosis.evidence.laboratory import Fault, LaboratoryEvidence
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.trace import Trace
from torchid.effects.catalogue import effect
from torchid.effects.effect import Planted
from torchid.effects.place import Interval, Place
from torchid.model_free.testimony import CheckAnswer
from torchid.observation.plate_registry import SessionPlate

EVEN, CERTAIN = 0.5, 0.99
"""Wording. Confidences above which a cause is more than possible, and practically certain."""


def level_of(confidence: float) -> str:
    """Return how sure a confidence is: ``possible``, ``likely`` or ``certain``.

    Args:
        confidence: probability that something is there.
    """
    if confidence > CERTAIN:
        return "certain"
    return "likely" if confidence > EVEN else "possible"


@dataclass(frozen=True)
class Alternative:
    """Another explanation of what a cause explains, with its posterior probability."""

    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of its place."""
    confidence: float
    """Probability that it is there in place of the cause."""


@dataclass(frozen=True)
class Twin(Alternative):
    """An explanation that cannot be told from the cause."""

    place: Place | None = None
    """Place that it takes; None where its parameters need another search."""
    parameters: dict[str, dict[str, Tensor]] | None = None
    """``value`` and ``sd`` by key, in place of the cause; None where they need another search."""


@dataclass(frozen=True)
class Cause:
    """An effect that the data support."""

    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of its place."""
    when: tuple[Interval, ...] | None
    """Intervals in which it is there [s]; None: throughout."""
    parameters: dict[str, dict[str, Tensor]]
    """``value`` and ``sd`` by key, in the units that the keys end in."""
    confidence: float
    """Probability that it, or one that cannot be told from it, is there."""
    alternatives: tuple[Alternative, ...]
    """Rivals, the likeliest first."""
    indistinguishable: tuple[Twin, ...]
    """Rivals that cannot be told from it."""
    gain: dict[str, float]
    """Held-out gain of this cause on top of the others (``HeldOutFit.over``)."""
    place: Place
    """Place of the effect."""
    theta: Float[Tensor, "blocks params"]
    """Internal parameters (``Effect.internal``): one row, or one for each of the trials."""
    trials: tuple[str, ...]
    """Names of the trials in which it acts."""
    everywhere: bool
    """True if it acts in all fit trials, and therefore in others too."""
    doubted: bool = False
    """True if something contradicts the model, or nothing can check it, which has been taken off the confidence."""
    witnesses: tuple[CheckAnswer, ...] = ()
    """Answers of those who hear it without a body model, the loudest first."""
    applied: bool = True
    """False if the published model is not corrected for it: it is only possible, or everything fitted again with it
    predicts worse."""

    @property
    def level(self) -> str:
        """Return how sure it is: ``possible``, ``likely`` or ``certain``."""
        return level_of(self.confidence)

    def scaled(self, factor: float) -> "Cause":
        """Return the cause with its confidence, and that of its rivals, times a factor.

        Args:
            factor: 0 to 1.
        """
        alternatives, twins = (
            tuple(replace(one, confidence=factor * one.confidence) for one in some)
            for some in (self.alternatives, self.indistinguishable)
        )
        confidence = factor * self.confidence
        return replace(self, confidence=confidence, alternatives=alternatives, indistinguishable=twins)

    def on(self, trial: str) -> Planted | None:
        """Return the cause as it acts in a trial; None where it does not, or where nobody knows.

        Args:
            trial: name of the trial, which may be one that was neither fitted nor held out.
        """
        own, place = effect(self.effect), self.place
        if own.per_recording and place.when is not None:
            # Only part of a long recording was searched; what was knocked stays so in all of it.
            place = replace(place, when=tuple(Interval(i.trial, -math.inf, math.inf) for i in place.when))
        if trial in self.trials:
            return Planted(own, place, self.theta[self.trials.index(trial) if own.per_trial else 0])
        return Planted(own, place, self.theta[0]) if self.everywhere and not own.per_trial else None


@dataclass(frozen=True)
class NearestEffect:
    """An effect that was not named, at its best place."""

    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of the place."""
    evidence_nats: float
    """Score of the effect, averaged over its places [nat]; ``NamingOptions.named_nats`` would name it if its place were
    the best of all."""


@dataclass(frozen=True)
class Refuted:
    """A cause that fit trials named and that they do not support together with held-out motion."""

    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of its place."""
    heldout_log_likelihood: float
    """Log density that it gained there [nat]; where it acts on forces alone, that of forces given what cameras saw."""
    rule: str
    """Name of the rule, ``heldout_density``."""
    numbers: dict[str, float]
    """Numbers that the rule compared, by names that end in their unit."""


@dataclass(frozen=True)
class EarlierSessions:
    """The part that earlier sessions of the laboratory have in a verdict."""

    unlike: Unlike | None
    """The fault by which this session is unlike them, so that they were not asked; None: they were."""
    alone: tuple[Fault, ...]
    """Faults of instruments that fit trials of this session name without them."""


@dataclass(frozen=True)
class Diagnosis:
    """Causes of what the model gets wrong, what remains, and how the verdict came about."""

    plates: tuple[SessionPlate, ...]
    """Plates of the session."""
    baseline: Errors
    """Held-out errors of the model without any effect."""
    extended: Errors
    """Held-out errors of the model with the causes."""
    causes: tuple[Cause, ...]
    """Causes, those of plates and clocks first; in a published verdict those that are only possible last."""
    unexplained: Adequacy
    """Adequacy of the model with the causes."""
    not_testable: dict[str, str] = field(default_factory=dict)
    """Reason why an effect could not be tested, by its name."""
    nearest: tuple["NearestEffect", ...] = ()
    """Effects that came closest to being named beside the causes, best first."""
    refuted: tuple["Refuted", ...] = ()
    """Causes that held-out motion refuted."""
    trace: Trace = ()
    """Every entry, exit, discount and refusal, in order."""
    detectable: tuple[Detectable, ...] = ()
    """Smallest sizes of effects that would have been named beside the causes."""
    laboratory: LaboratoryEvidence | None = None
    """Evidence of the session on its laboratory's instruments, for other sessions of the same."""
    earlier: EarlierSessions | None = None
    """Part of earlier sessions of the laboratory in the verdict; None where the config names none."""
    aside: tuple[Interval, ...] = ()
    """Intervals that no model is fitted to: something unmeasured bears a good part of the weight there."""

    @property
    def likely(self) -> tuple[Cause, ...]:
        """Return the causes that are more than possible."""
        return tuple(cause for cause in self.causes if cause.level != "possible")

    @property
    def possible(self) -> tuple[Cause, ...]:
        """Return the causes that are only possible."""
        return tuple(cause for cause in self.causes if cause.level == "possible")
