"""The record of how a verdict came about: every entry, exit, discount and refusal of a cause, with its rule."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from torchid.diagnosis.candidates.candidate import Candidate


class StepKind(StrEnum):
    """Changes that a decision makes to the standing of a cause."""

    ENTER = "enter"
    """The cause joins the model."""
    LEAVE = "leave"
    """The cause is taken out of the model again."""
    DISCOUNT = "discount"
    """The cause stays with less confidence."""
    REFUSE = "refuse"
    """The cause is not named, or held-out motion refutes it."""


@dataclass(frozen=True)
class TraceStep:
    """One decision about one cause."""

    kind: StepKind
    """Change of the standing of the cause."""
    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of its place."""
    rule: str
    """The name of the rule that decided, as in ``docs/diagnosis.md``."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Numbers that the rule compared, limits included, by names that end in their unit."""


Trace = tuple[TraceStep, ...]
"""All decisions, in order."""


def step(kind: StepKind, one: Candidate, rule: str, **numbers: float) -> TraceStep:
    """Return the record of a decision about a candidate.

    Args:
        kind: what happens to it.
        one: the candidate.
        rule: name of the rule that decided.
        numbers: what the rule compared, by names that end in their unit.
    """
    return TraceStep(kind, one.effect.name, one.place.where, rule, numbers)
