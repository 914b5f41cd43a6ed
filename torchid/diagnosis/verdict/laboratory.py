"""Faults that witnesses name by themselves, as causes of a verdict."""

from collections.abc import Sequence

from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.trace import StepKind, TraceStep
from torchid.diagnosis.verdict.causes import LISTED, parameter_table
from torchid.diagnosis.verdict.records import Alternative, Cause, Twin
from torchid.effects.place import SESSION, covers
from torchid.effects.traits import Site
from torchid.model_free.faults import Scored, SuspectedFault, alike, instead, probability
from torchid.model_free.panel import Panel

NAMED = "witnesses_name"
"""Rule by which witnesses name a fault, as in ``docs/diagnosis.md``."""
DISAGREE = "witnesses_disagree"
"""Rule by which a fault is not named that leaves too much of what they state."""
OUTDONE = "witnesses_outdone"
"""Rule by which a fault is not named whose place one without a size takes better."""


def causes_of_faults(
    panel: Panel, faults: Sequence[SuspectedFault], trials: Sequence[str], options: DiagnosisOptions
) -> tuple[Cause, ...]:
    """Return the errors of measuring as causes, but for what they gain on held-out motion.

    Args:
        panel: the statements that name them.
        faults: the faults.
        trials: names of the fit trials and, behind them, of the held-out ones.
        options: limits of what a verdict may claim.
    """
    return tuple(_cause(panel, faults, k, trials, options) for k, one in enumerate(faults) if one.of_measuring)


def steps_of(faults: Sequence[SuspectedFault], options: DiagnosisOptions) -> tuple[TraceStep, ...]:
    """Return the entry of each fault that is an error of measuring.

    Args:
        faults: the faults.
        options: thresholds that they passed.
    """
    return tuple(
        TraceStep(StepKind.ENTER, one.suspect.effect.name, one.suspect.place.where, NAMED,
             {"witness_nats": one.scan[0].nats, "probability": probability(one.scan, options.witnesses.alike_nats),
              "least_probability": options.witnesses.named_probability})
        for one in faults
        if one.of_measuring
    )  # fmt: skip


def refusals_of(faults: Sequence[SuspectedFault], rule: str, numbers: dict[str, float]) -> tuple[TraceStep, ...]:
    """Return the refusal of each fault, where together they are not what the witnesses state.

    Args:
        faults: the faults.
        rule: ``DISAGREE`` or ``OUTDONE``.
        numbers: what the rule decided by, under the names of the trace.
    """
    return tuple(
        TraceStep(StepKind.REFUSE, one.suspect.effect.name, one.suspect.place.where, rule,
             {"witness_nats": one.scan[0].nats, **numbers})
        for one in faults
        if one.of_measuring
    )  # fmt: skip


def _cause(
    panel: Panel, faults: Sequence[SuspectedFault], k: int, trials: Sequence[str], options: DiagnosisOptions
) -> Cause:
    """Return the k-th fault as a cause."""
    own, size, scan, limits = faults[k].suspect, faults[k].size, faults[k].scan, options.confidence
    told = _one_each(alike(scan, options.witnesses.alike_nats))[: limits.twins]
    twins = tuple(_twin(panel, faults, k, one) for one in told)
    confidence = min(1.0, sum(one.probability for one in (scan[0], *told)))
    listed = tuple(Alternative(*_named(one), one.probability) for one in scan[1:] if one.probability > LISTED)
    everywhere = own.effect.site is not Site.TRIAL or own.place.where == SESSION.where
    acting = tuple(name for name in trials if everywhere or covers(own.place, name))
    parameters = parameter_table(own.effect.estimated(own.place, size.mean, size.covariance))
    return Cause(
        own.effect.name, own.place.where, None, parameters, confidence, listed[: limits.rivals], twins, {},
        own.place, size.mean[None], acting, everywhere,
    )  # fmt: skip


def _one_each(rivals: Sequence[Scored]) -> tuple[Scored, ...]:
    """Return the best of every effect: where else it may be says less than what else it may be."""
    first: dict[str, Scored] = {}
    for one in rivals:
        first.setdefault(one.suspect.effect.name, one)
    return tuple(first.values())


def _twin(panel: Panel, faults: Sequence[SuspectedFault], k: int, one: Scored) -> Twin:
    """Return a rival that cannot be told from the k-th fault, with its size in place of it."""
    other = one.suspect
    size = instead(panel, faults, k, other)
    values = parameter_table(other.effect.estimated(other.place, size.mean, size.covariance))
    return Twin(*_named(one), one.probability, other.place, values)


def _named(one: Scored) -> tuple[str, tuple[str, ...]]:
    """Return effect and place of a suspect by their names."""
    return one.suspect.effect.name, one.suspect.place.where
