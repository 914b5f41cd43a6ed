"""Discounts on the confidence of causes in a model that the data contradict, or that nothing can check."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.search.elimination import stands_out
from torchid.diagnosis.search.result import SearchResult
from torchid.diagnosis.testing.position_dependence import FieldMisfit
from torchid.diagnosis.trace import StepKind, Trace, step
from torchid.diagnosis.verdict.records import EVEN, Cause
from torchid.effects.session import SESSION
from torchid.effects.traits import Proof
from torchid.model_free.testimony import Testimony
from torchid.observation.trial import TrialObservation


def trust(rest: Adequacy, options: DiagnosisOptions) -> float:
    """Return the factor, 0 to 1, on the confidence of what forces told a model that leaves such a residual.

    Args:
        rest: adequacy of the model.
        options: thresholds.
    """
    doubt = options.confidence.doubt
    if rest.alone:
        return doubt
    return 1.0 - (1.0 - doubt) * rest.share_of_residual if rest.p_value < options.adequacy.p_value else 1.0


def discounted(
    found: SearchResult, observed: Sequence[TrialObservation], rest: Adequacy, causes: Iterable[Cause]
) -> tuple[list[Cause], Trace]:
    """Return causes, with less confidence where the data contradict the model or nothing can check it, and those steps.

    What forces say to such a model is doubted; what bodies do and cameras see is not. Where the residual is too little
    to be flagged, only what is small beside it stays in doubt.

    Args:
        found: result of the search, with the chosen effects.
        observed: fit trials.
        rest: adequacy of the model on them.
        causes: causes of the chosen effects, in their order.
    """
    options, causes = found.options, list(causes)
    if rest.alone or not rest.p_value < options.adequacy.p_value:
        return causes, ()
    factor, rule = trust(rest, options), "nothing_can_check" if rest.alone else "residual_structure"
    numbers = {"factor": factor} | ({} if rest.alone else {"unexplained_part": rest.share_of_residual})
    steps = []
    for k, one in enumerate(found.chosen):
        if not _sure(found, observed, rest, k):
            causes[k] = replace(causes[k].scaled(factor), doubted=True)
            steps.append(step(StepKind.DISCOUNT, one, rule, **numbers))
    return causes, tuple(steps)


def _sure(found: SearchResult, observed: Sequence[TrialObservation], rest: Adequacy, k: int) -> bool:
    """Return whether the k-th cause is beyond the doubt that the residual casts."""
    one = found.chosen[k]
    if rest.significant:
        return one.effect.moves_markers and one.effect.bodily
    if rest.alone:
        return visible(one)
    least = found.options.elimination.residual_part
    return one.effect.moves_markers or one.effect.intermittent or stands_out(found, observed, k) > least


def visible(one: Candidate) -> bool:
    """Return whether markers alone tell an effect.

    Where all markers show it at once, or the whole session does, only forces disagree, and in one trial nothing agrees.

    Args:
        one: candidate of the effect.
    """
    return one.effect.moves_markers and not one.effect.whole_body and one.place != SESSION


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


def unwitnessed(
    causes: Sequence[Cause],
    found: SearchResult,
    heard: Sequence[Testimony | None],
    told: Mapping[Proof, Collection[str]],
) -> tuple[list[Cause], Trace]:
    """Return causes, those of a laboratory that no witness supports at most possible, and those steps.

    Args:
        causes: causes of the chosen effects, in their order.
        found: result of the search.
        heard: what witnesses of forces say of each; None where they were not asked.
        told: names of places that other proof than forces bears out.
    """
    causes, steps, most = list(causes), [], min(found.options.confidence.doubt, EVEN)
    least, unheard = found.options.naming.alike_nats, Testimony(0.0, 0.0)
    for k, (one, said) in enumerate(zip(found.chosen, heard, strict=True)):
        said = said or unheard
        borne_out = (
            one.effect.bodily
            or said.nats > least
            or any(name in told.get(one.effect.proof, ()) for name in one.place.where)
        )
        if borne_out or causes[k].confidence <= most:
            continue
        factor = most / causes[k].confidence
        causes[k] = replace(causes[k].scaled(factor), doubted=True)
        numbers = {"factor": factor, "witness_nats": said.nats, "least_nats": least, "heard_sd": said.loudness_sd}
        steps.append(step(StepKind.DISCOUNT, one, "no_witness", **numbers))
    return causes, tuple(steps)
