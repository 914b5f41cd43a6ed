"""Contacts that were plain before anything was searched, as causes."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import takewhile

import torch
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.candidates.missing_weight import EFFECT, MissingWeight
from torchid.diagnosis.search.estimates import estimate, instead, internal
from torchid.diagnosis.search.result import SearchResult, without
from torchid.diagnosis.search.rivals import ALIKE, TWINS, Round, Share, named_in, same, shares, twins
from torchid.diagnosis.testing.heldout import HeldOut, HeldOutFit
from torchid.diagnosis.verdict.records import RIVALS, Alternative, Cause, Diagnosis, Near, Twin
from torchid.effects.catalogue import effect
from torchid.observation.plate_registry import SessionPlate
from torchid.observation.trial import TrialObservation


def with_missing_weight(found: Diagnosis, some: Sequence[MissingWeight]) -> Diagnosis:
    """The verdict with contacts that were plain before anything was searched, first."""
    causes = tuple(_plain(one) for one in some)
    return replace(found, causes=(*causes, *found.causes), aside=tuple(i for one in some for i in one.aside))


def _plain(one: MissingWeight) -> Cause:
    assert one.place.when is not None
    order = sorted(one.odds.items(), key=lambda both: -both[1])
    listed = tuple(Alternative(EFFECT.name, (name,), odds) for name, odds in order if name not in one.place.where)
    alike = [a for a in listed if a.confidence > math.exp(-ALIKE) * order[0][1]][:TWINS]
    twins = tuple(Twin(a.effect, a.where, a.confidence) for a in alike)
    told = EFFECT.estimated(one.place, one.theta, torch.diag(one.sd.square()))
    parameters = {key: {"value": value, "sd": sd} for key, (value, sd) in told.items()}
    confidence = min(1.0, order[0][1] + sum(t.confidence for t in twins))
    alternatives = tuple(a for a in listed if a.confidence > 1e-3)[:RIVALS]
    return Cause(
        EFFECT.name, one.place.where, one.place.when, parameters, confidence, alternatives, twins, one.gain,
        one.place, one.theta[None], (one.place.when[0].trial,), False,
    )  # fmt: skip


def after_forces(cause: Cause) -> bool:
    """What a laboratory did to forces is read first, and what markers and bodies are like after it."""
    return effect(cause.effect).moves_markers or effect(cause.effect).bodily


def nearest(scan: Round) -> tuple[Near, ...]:
    """Of the last scan, which named nothing."""
    best = sorted(scan.families.items(), key=lambda both: -both[1])[:RIVALS]
    first = {name: next(r.candidate for r in scan.rivals if r.candidate.effect.name == name) for name, _ in best}
    return tuple(Near(name, first[name].place.where, score) for name, score in best)


def causes_of(found: SearchResult, unseen: HeldOut, extended: HeldOutFit, names: Sequence[str]) -> Iterator[Cause]:
    """The chosen effects, each with what it gains on top of the others."""
    for k, one in enumerate(found.chosen):
        gain = extended.over(unseen.judged(without(found.chosen, one)))
        yield cause_of(found, k, found.rounds, gain, names)


def cause_of(
    found: SearchResult, k: int, rounds: Sequence[Round], gain: dict[str, float], names: Sequence[str]
) -> Cause:
    """The k-th of the chosen effects, against the rivals of the round that named it."""
    one = found.chosen[k]
    scan = _upheld(found, rounds, one)
    own, others = shares(scan, one)
    alike = tuple(_twin(found, k, share) for share in twins(others))
    listed = tuple(Alternative(*_named(share), share.weight) for share in others if share.weight > 1e-3)[:RIVALS]
    confidence = min(1.0, own.weight + sum(twin.confidence for twin in alike))
    acting = tuple(names[j] for j in sorted(one.trials))
    return Cause(
        one.effect.name, one.place.where, one.place.when, _told(estimate(found, k)), confidence, listed, alike, gain,
        one.place, internal(found, k).view(len(one.blocks), -1), acting, one.trials == found.statistics.all,
    )  # fmt: skip


def _twin(found: SearchResult, k: int, share: Share) -> Twin:
    """With its size in place of the k-th chosen effect."""
    own = next((c for c in found.twins if same(share.rival.candidate, c) and c not in found.chosen), None)
    if own is None:
        return Twin(*_named(share), share.weight)
    return Twin(*_named(share), share.weight, own.place, _told(instead(found, k, own)))


def _named(share: Share) -> tuple[str, tuple[str, ...]]:
    return share.rival.candidate.effect.name, share.rival.candidate.place.where


def _told(values: dict[str, tuple[Tensor, Tensor]]) -> dict[str, dict[str, Tensor]]:
    return {key: {"value": value, "sd": sd} for key, (value, sd) in values.items()}


def _upheld(found: SearchResult, rounds: Sequence[Round], one: Candidate) -> Round:
    """The round that named a cause; where it stands for another place, without those that were refused before it."""
    first = next((first for first, other in found.alternative_places if other is one), None)
    if first is None:
        return named_in(rounds, one)
    tried = [first, *(other for own, other in found.alternative_places if own is first)]
    refused = [(c.effect.name, c.place.where) for c in takewhile(lambda c: c is not one, tried)]
    scan = named_in(rounds, first)
    left = (r for r in scan.compared if (r.candidate.effect.name, r.candidate.place.where) not in refused)
    return replace(scan, compared=tuple(left))


def untested_plates(observed: Sequence[TrialObservation], plates: Sequence[SessionPlate]) -> dict[str, str]:
    borne = {
        f.name for w in observed for k, f in enumerate(w.view.reading.frames) if bool(w.view.reading.wrench[:, k].any())
    }
    silent = [plate.frame.name for plate in plates if plate.frame.name not in borne]
    out = {}
    if silent:
        out["plate_gain"] = f"not of {', '.join(silent)}: nobody steps there in a fit trial"
    return out
