"""What a search for effects found, and what it found them against."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.design import Design, only
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.noise import Noise
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import Posterior, fit
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.rivals import NAMED, OUT_OF_SIGHT, Round, named_in, same, shares, twins

ALTERNATIVES = 3
"""Other places of an effect that are asked when held-out motion refutes one."""


@dataclass(frozen=True)
class SearchResult:
    """What was found."""

    design: Design
    prior: Prior
    noise: Noise
    chosen: tuple[Candidate, ...]
    rounds: tuple[Round, ...]
    statistics: Statistics
    posterior: Posterior
    alternative_places: tuple[tuple[Candidate, Candidate], ...] = ()
    """A chosen effect and another place of it, likelier ones first, see ``_stand_ins``."""
    scales: tuple[Candidate, ...] = ()
    """What makes all weight wrong by a factor, chosen or not."""
    twins: tuple[Candidate, ...] = ()
    """What cannot be told from chosen effects, see ``instead``."""


def reduced(
    design: Design,
    prior: Prior,
    noise: Noise,
    chosen: Sequence[Candidate],
    rounds: Sequence[Round],
    statistics: Statistics,
) -> SearchResult:
    """What a search ended with, without columns that nobody chose, that stand for nothing chosen and weigh nothing."""
    pairs, more, alike = (
        list(_alternative_places(design, chosen, rounds)),
        scales(design),
        list(_twins(design, chosen, rounds)),
    )
    some = list({id(c): c for c in (*chosen, *asked_later(design, chosen, rounds))}.values())
    small, all_, _ = only(design, some)
    own = {id(old): new for old, new in zip(some, all_, strict=True)}
    less, kept = statistics.only(design, some), tuple(own[id(c)] for c in chosen)
    alternative_places = tuple((own[id(first)], own[id(other)]) for first, other in pairs)
    weigh, doubles = (tuple(own[id(c)] for c in some) for some in (more, alike))
    posterior, prior = fit(less, kept), prior.widened(small)
    small = replace(small, trials=tuple(one.alone for one in small.trials))
    return SearchResult(small, prior, noise, kept, tuple(rounds), less, posterior, alternative_places, weigh, doubles)


def asked_later(design: Design, chosen: Sequence[Candidate], rounds: Sequence[Round]) -> list[Candidate]:
    """What is asked about when the search has ended."""
    pairs = _alternative_places(design, chosen, rounds)
    return [*(other for _, other in pairs), *scales(design), *_twins(design, chosen, rounds)]


def scales(design: Design) -> list[Candidate]:
    """Candidates that make all weight wrong by a factor."""
    return [c for c in design.candidates if c.effect.weighs(c.place)]


def _alternative_places(
    design: Design, chosen: Sequence[Candidate], rounds: Sequence[Round]
) -> Iterator[tuple[Candidate, Candidate]]:
    """Places that fit trials support nearly as well, of effects on forces alone whose columns do not depend on where
    they were found.

    Whole-body motions hardly tell a mass that wobbles in the pelvis from one in the thorax (27.6 and 24.7 nats of a
    hidden one), livelier ones do.
    """
    open_ = {(c.effect.name, id(c.place)): c for c in design.candidates}
    for one in chosen:
        if one.effect.moves_markers or one.effect.intermittent or one.effect.shifts_time or one.effect.nonlinear:
            continue
        rivals = [r for r in named_in(rounds, one).rivals if r.candidate.effect.name == one.effect.name]
        near = [r for r in rivals if r.score >= NAMED and r.weighed > rivals[0].weighed - OUT_OF_SIGHT]
        best = {r.candidate.place.where: r for r in reversed(near)}
        best.pop(one.place.where, None)
        for rival in sorted(best.values(), key=lambda rival: -rival.weighed)[:ALTERNATIVES]:
            key = one.effect.name, id(rival.candidate.place)
            if key in open_:
                yield one, open_[key]


def _twins(design: Design, chosen: Sequence[Candidate], rounds: Sequence[Round]) -> Iterator[Candidate]:
    """Of chosen effects, as the scan had them; intervals are not searched again."""
    for one in chosen:
        for twin in (share.rival.candidate for share in twins(shares(named_in(rounds, one), one)[1])):
            if not twin.effect.intermittent:
                yield from (c for c in design.candidates if same(twin, c))


def without(chosen: Sequence[Candidate], one: Candidate) -> list[Candidate]:
    """The others."""
    return [c for c in chosen if c is not one]


def support(statistics: Statistics, chosen: Sequence[Candidate], one: Candidate) -> float:
    """Log evidence of one of the chosen effects over the others alone."""
    less, rest = marginalise_per_trial(statistics, without(chosen, one))
    return float(gains(less, fit(less, rest), [one])[0])
