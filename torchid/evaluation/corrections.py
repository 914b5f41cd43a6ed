"""Corrections that an evaluation rests on: faults that the diagnosis found, and took out of body and recordings."""

from dataclasses import dataclass

from torchid.report.cause_sentences import name, told
from torchid.session import Outcome


@dataclass(frozen=True)
class AppliedCorrection:
    """A cause that the body's run has corrected for."""

    label: str
    what: str
    """Fault, place, size and time in a sentence."""
    effect: str
    where: tuple[str, ...]
    confidence: float
    """Probability that it, or one that cannot be told from it, is there."""
    trials: tuple[str, ...]
    """Trials in which it acts."""


def corrections_of(outcome: Outcome) -> tuple[AppliedCorrection, ...]:
    """Causes of a run's diagnosis that were applied.

    Args:
        outcome: of the body's run.
    """
    if outcome.diagnosis is None or outcome.base is None:
        return ()
    return tuple(
        AppliedCorrection(name(cause), told(cause), cause.effect, cause.where, cause.confidence, cause.trials)
        for cause in outcome.diagnosis.causes
        if cause.applied
    )
