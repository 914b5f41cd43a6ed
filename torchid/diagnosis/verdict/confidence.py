"""Discounts on the confidence of causes in a model that the data contradict."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.search.elimination import stands_out
from torchid.diagnosis.search.result import SearchResult
from torchid.diagnosis.testing.position_dependence import FieldMisfit
from torchid.diagnosis.trace import StepKind, Trace, step
from torchid.diagnosis.verdict.records import Cause
from torchid.observation.trial import TrialObservation


def trust(rest: Adequacy, options: DiagnosisOptions) -> float:
    """Return the factor, 0 to 1, on the confidence of what forces told a model that leaves such a residual.

    Args:
        rest: adequacy of the model.
        options: thresholds.
    """
    share = rest.share_of_residual if rest.p_value < options.adequacy.p_value else 0.0
    return 1.0 - (1.0 - options.confidence.doubt) * share


def discounted(
    found: SearchResult, observed: Sequence[TrialObservation], rest: Adequacy, causes: Iterable[Cause]
) -> tuple[list[Cause], Trace]:
    """Return causes, with less confidence where the data contradict the model, and those steps.

    What forces say to such a model is doubted; what bodies do and cameras see is not. Where the residual is too little
    to be flagged, only what is small beside it stays in doubt.

    Args:
        found: result of the search, with the chosen effects.
        observed: fit trials.
        rest: adequacy of the model on them.
        causes: causes of the chosen effects, in their order.
    """
    options, causes = found.options, list(causes)
    if not rest.p_value < options.adequacy.p_value:
        return causes, ()
    factor, steps = trust(rest, options), []
    for k, one in enumerate(found.named):
        if not _sure(found, observed, rest, k):
            causes[k] = replace(causes[k].scaled(factor), doubted=True)
            numbers = {"factor": factor, "unexplained_part": rest.share_of_residual}
            steps.append(step(StepKind.DISCOUNT, one, "residual_structure", **numbers))
    return causes, tuple(steps)


def _sure(found: SearchResult, observed: Sequence[TrialObservation], rest: Adequacy, k: int) -> bool:
    """Return whether the k-th cause is beyond the doubt that the residual casts."""
    one = found.chosen[k]
    if rest.significant:
        return one.effect.moves_markers and one.effect.bodily
    least = found.options.elimination.residual_part
    return one.effect.moves_markers or one.effect.intermittent or stands_out(found, observed, k) > least


def bent_by_position(
    found: SearchResult, causes: Sequence[Cause], bent: Sequence[FieldMisfit]
) -> tuple[list[Cause], Trace]:
    """Return causes, with less confidence where a field beside a named force contradicts it, and those steps.

    Args:
        found: result of the search, with the chosen effects.
        causes: causes of the chosen effects, in their order.
        bent: named forces that a field contradicts.
    """
    causes, steps, factor = list(causes), [], found.options.confidence.doubt
    for one in bent:
        causes[one.index] = replace(causes[one.index].scaled(factor), doubted=True)
        numbers = {"factor": factor, "field_part": one.share, "p_value": one.p_value}
        steps.append(step(StepKind.DISCOUNT, found.chosen[one.index], "position_dependence", **numbers))
    return causes, tuple(steps)
