"""Chosen effects as causes: parameters, rivals, confidence, and what each gains on held-out motion."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchid.diagnosis.candidates.marker_faults import MarkerFault
from torchid.diagnosis.candidates.missing_weight import MissingWeight
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.search.estimates import estimate, instead, internal
from torchid.diagnosis.search.result import SearchResult, without
from torchid.diagnosis.search.rivals import RivalShare, Round, named_in, same, shares, twins
from torchid.diagnosis.testing.heldout import HeldOut, HeldOutFit
from torchid.diagnosis.trace import StepKind, TraceStep
from torchid.diagnosis.verdict.records import Alternative, Cause, Diagnosis, NearestEffect, Twin
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.observation.plate_registry import SessionPlate
from torchid.observation.trial import TrialObservation

NO_GAIN = {"heldout_log_likelihood": 0.0, "force_rmse_pct": 0.0, "moment_rmse_pct": 0.0}
"""Estimator. Held-out gain of what was not searched: none, against a gap, or a marker where the model has it."""
LISTED = 1e-3
"""Resolution. Probability below which a rival is not listed: less than a tenth of a percent is never printed."""


def with_missing_weight(found: Diagnosis, some: Sequence[MissingWeight], options: DiagnosisOptions) -> Diagnosis:
    """Return the verdict with plain contacts, which were found before anything was searched, as its first causes.

    Args:
        found: verdict of the search.
        some: the contacts.
        options: thresholds of confidence and of rivals.
    """
    causes = tuple(_plain(one, options) for one in some)
    steps = tuple(
        TraceStep(StepKind.ENTER, c.effect, c.where, "missing_weight", {"missing_part": one.missing_part})
        for c, one in zip(causes, some, strict=True)
    )
    aside = tuple(i for one in some for i in one.aside)
    return replace(found, causes=(*causes, *found.causes), aside=aside, trace=(*steps, *found.trace))


def with_marker_faults(found: Diagnosis, some: Sequence[MarkerFault]) -> Diagnosis:
    """Return the verdict with what distances tell of markers, which no search of the motion could find.

    Args:
        found: verdict of the search.
        some: faults of markers.
    """
    causes = tuple(
        Cause(
            one.effect.name, one.place.where, one.place.when, _told(one), one.confidence, (), (), NO_GAIN, one.place,
            one.theta[None], one.trials, False,
        )
        for one in some
    )  # fmt: skip
    steps = tuple(TraceStep(StepKind.ENTER, one.effect.name, one.place.where, one.rule, one.numbers) for one in some)
    ordered = tuple(sorted((*found.causes, *causes), key=after_forces))
    return replace(found, causes=ordered, trace=(*steps, *found.trace))


def _told(one: MarkerFault) -> dict[str, dict[str, Tensor]]:
    """Return the parameters of a fault of markers."""
    return parameter_table(one.effect.estimated(one.place, one.theta, one.covariance))


def _plain(one: MissingWeight, options: DiagnosisOptions) -> Cause:
    """Return a plain contact as a cause."""
    assert one.place.when is not None
    own, limits = one.effect, options.confidence
    order = sorted(one.odds.items(), key=lambda both: -both[1])
    listed = tuple(Alternative(own.name, (name,), odds) for name, odds in order if name not in one.place.where)
    least = math.exp(-options.naming.alike_nats) * order[0][1]
    alike = [a for a in listed if a.confidence > least][: limits.twins]
    twins = tuple(Twin(a.effect, a.where, a.confidence) for a in alike)
    parameters = parameter_table(own.estimated(one.place, one.theta, torch.diag(one.sd.square())))
    confidence = min(1.0, order[0][1] + sum(t.confidence for t in twins))
    alternatives = tuple(a for a in listed if a.confidence > LISTED)[: limits.rivals]
    return Cause(
        own.name, one.place.where, one.place.when, parameters, confidence, alternatives, twins, one.gain,
        one.place, one.theta[None], (one.place.when[0].trial,), False,
    )  # fmt: skip


def after_forces(cause: Cause) -> bool:
    """Return whether a cause is of markers or bodies, which are read after what a laboratory did to forces.

    Args:
        cause: the cause.
    """
    return effect(cause.effect).moves_markers or effect(cause.effect).bodily


def nearest(scan: Round, most: int) -> tuple[NearestEffect, ...]:
    """Return the effects that came closest in the last scan, which named nothing, the best first.

    Args:
        scan: the last round.
        most: number of effects at most.
    """
    best = sorted(scan.families.items(), key=lambda both: -both[1])[:most]
    first = {name: next(r.candidate for r in scan.rivals if r.candidate.effect.name == name) for name, _ in best}
    return tuple(NearestEffect(name, first[name].place.where, score) for name, score in best)


def causes_of(found: SearchResult, unseen: HeldOut, extended: HeldOutFit, names: Sequence[str]) -> Iterator[Cause]:
    """Yield the chosen effects that are named as causes, each with what it gains on top of the others.

    Args:
        found: result of the search, without refuted effects.
        unseen: the held-out trials.
        extended: fit of the model with all of these effects to them.
        names: names of the fit trials and, behind them, of the held-out ones.
    """
    for k, one in enumerate(found.named):
        gain = extended.over(unseen.fit(without(found.named, one)))
        yield cause_of(found, k, gain, names)


def cause_of(found: SearchResult, k: int, gain: dict[str, float], names: Sequence[str]) -> Cause:
    """Return the k-th of the chosen effects as a cause, against the rivals of the round that named it.

    Args:
        found: result of the search.
        k: index of the effect.
        gain: what it gains on held-out motion (``HeldOutFit.over``).
        names: names of the fit trials and, behind them, of the held-out ones.
    """
    one, limits = found.chosen[k], found.options.confidence
    own, others = shares(named_in(found.rounds, one), one)
    alike = tuple(_twin(found, k, share) for share in twins(others, limits.twins))
    listed = tuple(Alternative(*_named(share), share.weight) for share in others if share.weight > LISTED)
    confidence = min(1.0, own.weight + sum(twin.confidence for twin in alike))
    acting = tuple(names[j] for j in sorted(one.trials))
    return Cause(
        one.effect.name, one.place.where, one.place.when, parameter_table(estimate(found, k)), confidence,
        listed[: limits.rivals], alike, gain, one.place, internal(found, k).view(len(one.blocks), -1), acting,
        one.trials == found.model.statistics.all,
    )  # fmt: skip


def _twin(found: SearchResult, k: int, share: RivalShare) -> Twin:
    """Return a rival as a twin, with its size in place of the k-th chosen effect where that can be had."""
    own = next((c for c in found.twins if same(share.rival.candidate, c) and c not in found.chosen), None)
    if own is None:
        return Twin(*_named(share), share.weight)
    return Twin(*_named(share), share.weight, own.place, parameter_table(instead(found, k, own)))


def _named(share: RivalShare) -> tuple[str, tuple[str, ...]]:
    """Return effect and place of a rival by their names."""
    return share.rival.candidate.effect.name, share.rival.candidate.place.where


def parameter_table(values: dict[str, tuple[Tensor, Tensor]]) -> dict[str, dict[str, Tensor]]:
    """Return values and standard deviations by key, as ``Cause.parameters`` has them.

    Args:
        values: both, by key.
    """
    return {key: {"value": value, "sd": sd} for key, (value, sd) in values.items()}


def untested(observed: Sequence[TrialObservation], plates: Sequence[SessionPlate]) -> dict[str, str]:
    """Return by effect why it cannot be tested at some places of the session.

    Args:
        observed: fit trials.
        plates: plates of the session.
    """
    views, names = [one.view for one in observed], [plate.frame.name for plate in plates]
    return {name: why for name, one in CATALOGUE.items() if (why := one.untested(views, names))}
