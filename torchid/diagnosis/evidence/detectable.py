"""The smallest size of each effect that a session would have shown: what a verdict without a cause is worth.

An effect of that size, in a direction by lot, would be named in ``CHANCE`` of all cases by the rules of a round
(``search/rivals.py``): its score, and what it has beyond its appearance, both reach ``named_nats``, and it explains
what the session would hold then by ``very_strong_nats`` better than any other effect or place that has a size; that
margin is a choice. Not asked is the consent of single trials.

Left out are effects without one size: what comes and goes, what differs from trial to trial, what is there in full or
not at all. So is what bodies imitate at every place, and what other proof than forces decides about.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.gains import informed
from torchid.diagnosis.evidence.joint_information import JointInformation, joint_information
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.planted_moments import directions, moments_of
from torchid.diagnosis.evidence.planted_rivals import rival_moments
from torchid.diagnosis.evidence.planted_rules import PlantedRules, smallest
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.options import NamingOptions
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.traits import Proof, Site

LOT = 0
"""Resolution. Seed of the lots, the same for all: where sizes differ, it is not by chance."""
WIDE = (Site.SEGMENT, Site.MARKER, Site.JOINT)
"""Wording. Sites that a session has dozens of."""


@dataclass(frozen=True)
class Detectable:
    """The smallest size of an effect that a session would have shown."""

    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of the place."""
    key: str
    """Parameter, with its unit; all others are zero."""
    size: float | None
    """Size from which the effect is named in ``CHANCE`` of all cases: the length of a vector, the distance of a factor
    from one; None: not testable in this session."""


def detectable(
    statistics: Statistics,
    chosen: Sequence[Candidate],
    candidates: Sequence[Candidate],
    naming: NamingOptions,
    rivals: Sequence[Candidate] = (),
) -> tuple[Detectable, ...]:
    """Return the smallest size that would have been named of each effect at each place, key by key.

    Args:
        statistics: statistics of all trials.
        chosen: effects that the model has.
        candidates: candidates that could have been named beside them.
        naming: thresholds.
        rivals: what competes with them and is not asked about itself.
    """
    bare, kept = marginalise_per_trial(statistics.unstated, chosen)
    whole, _ = marginalise_per_trial(statistics, chosen)
    base, less = fit(whole, kept), fit(bare, kept)
    asked, beside = ([c for c in some if has_size(c.effect)] for some in (candidates, rivals))
    joint, found = joint_information(whole, base, [*asked, *beside]), []
    for name in dict.fromkeys(c.effect.name for c in asked):
        own = [c for c in asked if c.effect.name == name]
        both = zip(informed(whole, base, own), informed(bare, less, own), strict=True)
        for (rows, told, _), (_, unstated, _) in both:
            found += _of_keys([own[k] for k in rows], told, unstated, joint, naming)
    return tuple(found)


def has_size(effect: Effect) -> bool:
    """Return whether one number can say how much of an effect there is, and forces decide whether it is named.

    Args:
        effect: the effect.
    """
    other = effect.proof in (Proof.DISTANCES, Proof.SMOOTHNESS)
    return not (effect.intermittent or effect.per_trial or effect.all_or_nothing or effect.widespread or other)


def _of_keys(
    some: Sequence[Candidate],
    told: Float[Tensor, "some n n"],
    unstated: Float[Tensor, "some n n"],
    joint: JointInformation,
    naming: NamingOptions,
) -> Iterator[Detectable]:
    """Yield the sizes of candidates of one effect, given the information of all rows and of those without statements,
    and that of all candidates."""
    effect = some[0].effect
    for key, parts in _keys(effect, some[0].place):
        lot = torch.Generator().manual_seed(LOT)
        direction = directions(some[0], parts, lot).to(told)
        whole, bare = moments_of(told, unstated, direction, lot)
        rivals = [rival_moments(joint, one, direction, whole, k) for k, one in enumerate(some)]
        rules = PlantedRules.of(some, whole, bare, rivals)
        for one, size in zip(some, smallest(rules, naming).tolist(), strict=True):
            own = size * float(direction[0].norm()) * effect.scale(one.place)[parts[0]]
            yield Detectable(effect.name, one.place.where, key, own if math.isfinite(own) else None)


def _keys(effect: Effect, place: Place) -> Iterator[tuple[str, list[int]]]:
    """Yield the keys of an effect that mean something by themselves, with the parameters that share the key's unit:
    those with the prior of its first one.

    Beside a parameter that is never negative, such as a mass, the others mean nothing without it.
    """
    scale, single, at = effect.scale(place), len(effect.parameters) == 1, 0
    for one in effect.parameters:
        size = len(scale) if single else one.size
        yield one.key, [k for k in range(at, at + size) if scale[k] == scale[at]]
        at += size
        if effect.positives(place):
            return


def extremes(found: Sequence[Detectable]) -> tuple[Detectable, ...]:
    """Return sizes in the order of the catalogue; of sites that a session has dozens of, the least and the largest.

    Args:
        found: sizes of all places.
    """
    names = list(CATALOGUE)
    groups: dict[tuple[str, str], list[Detectable]] = {}
    for one in sorted(found, key=lambda one: names.index(one.effect)):
        groups.setdefault((one.effect, one.key), []).append(one)
    return tuple(one for some in groups.values() for one in _ends(some))


def _ends(some: Sequence[Detectable]) -> Sequence[Detectable]:
    """Return the places with the least and the largest size, if they are segments, markers or joints; else all.

    Of one place at several frequencies, the one that shows best counts.
    """
    if CATALOGUE[some[0].effect].site not in WIDE:
        return some
    best: dict[tuple[str, ...], Detectable] = {}
    for one in sorted(some, key=lambda one: math.inf if one.size is None else one.size):
        best.setdefault(one.where, one)
    first, *others = best.values()
    return (first, *others[-1:])
