"""What a search for effects found, and what it found them against."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.anew import eliminated
from torchid.diagnosis.design import Candidate, Design, only
from torchid.diagnosis.evidence import Fitted, fit, gains
from torchid.diagnosis.noise import Noise
from torchid.diagnosis.rivals import NAMED, OUT_OF_SIGHT, Round, named_in, same, shares, twins
from torchid.diagnosis.sums import Prior, Sums

STAND_INS = 3
"""Other places of an effect that are asked when held-out motion refutes one."""
SURELY = 3.0
"""Standard deviations below zero that refute one of several parameters that cannot be there. Set with three
recordings seen: in a runner and in walks and squats no softness of 24 segments is below zero by more than two; in a
child's walk that hardly stands on plates, two of 15 were by more than three, one by six."""


@dataclass(frozen=True)
class Search:
    """What was found."""

    design: Design
    prior: Prior
    noise: Noise
    chosen: tuple[Candidate, ...]
    rounds: tuple[Round, ...]
    sums: Sums
    fitted: Fitted
    stand_ins: tuple[tuple[Candidate, Candidate], ...] = ()
    """A chosen effect and another place of it, likelier ones first, see ``_stand_ins``."""
    scales: tuple[Candidate, ...] = ()
    """What makes all weight wrong by a factor, chosen or not."""
    twins: tuple[Candidate, ...] = ()
    """What cannot be told from chosen effects, see ``instead``."""


def reduced(
    design: Design, prior: Prior, noise: Noise, chosen: Sequence[Candidate], rounds: Sequence[Round], sums: Sums
) -> Search:
    """What a search ended with, without columns that nobody chose, that stand for nothing chosen and weigh nothing."""
    pairs, more, alike = list(_stand_ins(design, chosen, rounds)), scales(design), list(_twins(design, chosen, rounds))
    some = list({id(c): c for c in (*chosen, *beside(design, chosen, rounds))}.values())
    small, all_, _ = only(design, some)
    own = {id(old): new for old, new in zip(some, all_, strict=True)}
    less, kept = sums.only(design, some), tuple(own[id(c)] for c in chosen)
    stand_ins = tuple((own[id(first)], own[id(other)]) for first, other in pairs)
    weigh, doubles = (tuple(own[id(c)] for c in some) for some in (more, alike))
    fitted, prior = fit(less, kept), prior.widened(small)
    small = replace(small, trials=tuple(one.alone for one in small.trials))
    return Search(small, prior, noise, kept, tuple(rounds), less, fitted, stand_ins, weigh, doubles)


def beside(design: Design, chosen: Sequence[Candidate], rounds: Sequence[Round]) -> list[Candidate]:
    """What is asked about when the search has ended."""
    pairs = _stand_ins(design, chosen, rounds)
    return [*(other for _, other in pairs), *scales(design), *_twins(design, chosen, rounds)]


def scales(design: Design) -> list[Candidate]:
    """Candidates that make all weight wrong by a factor."""
    return [c for c in design.candidates if c.effect.weighs(c.place)]


def _stand_ins(
    design: Design, chosen: Sequence[Candidate], rounds: Sequence[Round]
) -> Iterator[tuple[Candidate, Candidate]]:
    """Places that fit trials support nearly as well, of effects on forces alone whose columns do not depend on where
    they were found.

    Whole-body motions hardly tell a mass that wobbles in the pelvis from one in the thorax (27.6 and 24.7 nats of a
    hidden one), livelier ones do.
    """
    open_ = {(c.effect.name, id(c.place)): c for c in design.candidates}
    for one in chosen:
        if one.effect.kinematic or one.effect.timed or one.effect.late or one.effect.curved:
            continue
        rivals = [r for r in named_in(rounds, one).rivals if r.candidate.effect.name == one.effect.name]
        near = [r for r in rivals if r.score >= NAMED and r.weighed > rivals[0].weighed - OUT_OF_SIGHT]
        best = {r.candidate.place.where: r for r in reversed(near)}
        best.pop(one.place.where, None)
        for rival in sorted(best.values(), key=lambda rival: -rival.weighed)[:STAND_INS]:
            key = one.effect.name, id(rival.candidate.place)
            if key in open_:
                yield one, open_[key]


def _twins(design: Design, chosen: Sequence[Candidate], rounds: Sequence[Round]) -> Iterator[Candidate]:
    """Of chosen effects, as the scan had them; intervals are not searched again."""
    for one in chosen:
        for twin in (share.rival.candidate for share in twins(shares(named_in(rounds, one), one)[1])):
            if not twin.effect.timed:
                yield from (c for c in design.candidates if same(twin, c))


def without(chosen: Sequence[Candidate], one: Candidate) -> list[Candidate]:
    """The others."""
    return [c for c in chosen if c is not one]


def support(sums: Sums, chosen: Sequence[Candidate], one: Candidate) -> float:
    """Log evidence of one of the chosen effects over the others alone."""
    less, rest = eliminated(sums, without(chosen, one))
    return float(gains(less, fit(less, rest), [one])[0])


def pruned(found: Search, last: bool = False) -> Search:
    """Without those that the others have made superfluous, or that stood by others which have gone since.

    A late runner was 4 kg lighter than written down beside forces that pulled at his arm and thigh; they were dropped,
    and without them the record had 1.0 nat against it.
    """
    kept = list(found.chosen)
    for one in reversed(found.chosen):
        if support(found.sums, kept, one) < NAMED:
            kept.remove(one)
    left = without_negative(replace(found, chosen=tuple(kept), fitted=fit(found.sums, kept)), last)
    return left if len(left.chosen) == len(found.chosen) else pruned(left, last)


def internal(found: Search, k: int) -> Float[Tensor, " params"]:
    """Internal parameters of the k-th chosen effect, block after block of trials."""
    return _told_by(found, k) @ found.fitted.mean


def without_negative(found: Search, last: bool = False) -> Search:
    """No load and no spring is negative: one is there, not its like taken away.

    That one spring of many is negative says something at ``last`` only, when nothing else goes any more: forces that
    pulled at a runner's arm and thorax, and were dropped later, had made his thorax one.
    """
    for k, one in reversed(list(enumerate(found.chosen))):
        if _negative(found, k, SURELY if last else math.inf):
            kept = tuple(without(found.chosen, one))
            return without_negative(replace(found, chosen=kept, fitted=fit(found.sums, kept)), last)
    return found


def _negative(found: Search, k: int, surely: float) -> bool:
    """Whether all parameters that cannot be negative are, or one of them is by that many standard deviations."""
    one, factor = found.chosen[k], _told_by(found, k)
    n = one.effect.positives(one.place)
    theta = (factor @ found.fitted.mean)[:n]
    sd = (factor @ found.fitted.covariance @ factor.T).diagonal()[:n].sqrt()
    return n > 0 and bool((theta < 0.0).all() or (theta < -surely * sd).any())


def _told_by(found: Search, k: int) -> Float[Tensor, "params n"]:
    """The effect's parameters in terms of what was fitted.

    What every plate or skin has a little of is part of an error that is named there: a drift is all of it, and known
    better than the share of it that is out of the ordinary.
    """
    one, at = found.chosen[k], found.design.base + sum(c.size for c in found.chosen[:k])
    scale = found.prior.mean.new_tensor(one.effect.scale(one.place) * len(one.blocks))
    factor = scale.new_zeros(one.size, len(found.fitted.factor))
    factor[:, at : at + one.size] = torch.diag(scale)
    if one.blocks == (found.sums.all,):
        for columns, part in _ordinary(found, one):
            factor[:, columns] = part
    return factor


def _ordinary(found: Search, one: Candidate) -> Iterator[tuple[slice, Float[Tensor, "params some"]]]:
    """Nuisances that are part of an effect: their columns, and what its parameters are of them."""
    mean = found.prior.mean
    if one.source.columns.stop <= found.design.base:
        assert not any(one.source.mean), "errors of plates are about nothing"
        yield one.source.columns, torch.diag(mean.new_tensor(one.source.scale))
    for source in found.design.sources:
        part = source.effect.part_of(source.place, one.effect, one.place)
        if part is not None:
            yield source.columns, part * mean.new_tensor(source.scale)


def estimate(found: Search, k: int) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
    """Named parameters of the k-th chosen effect: values and standard deviations."""
    one, theta, factor = found.chosen[k], internal(found, k), _told_by(found, k)
    return one.effect.estimated(one.place, theta, factor @ found.fitted.covariance @ factor.T)


def instead(found: Search, k: int, twin: Candidate) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
    """The same of another effect in the place of the k-th chosen one."""
    chosen = (*found.chosen[:k], twin, *found.chosen[k + 1 :])
    return estimate(replace(found, chosen=chosen, fitted=fit(found.sums, chosen)), k)
