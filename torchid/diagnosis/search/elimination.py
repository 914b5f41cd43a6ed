"""Causes that evidence supports and that are none: where noise does not explain the residual, evidence is cheap."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.search.estimates import parameter_map
from torchid.diagnosis.search.result import SearchResult, support, without
from torchid.diagnosis.search.rivals import NAMED
from torchid.diagnosis.search.scan import scan_all
from torchid.observation.trial import TrialObservation

PLAIN = 0.05
"""Part of the residual force or moment that a cause takes away that nobody doubts."""
OPPOSED = 0.5
"""Of the energy of the larger of two causes: what is left where they undo each other."""


def drop_without_residual_gain(found: SearchResult, observed: Sequence[TrialObservation]) -> SearchResult:
    """Where noise does not explain the residual, evidence alone is cheap: forces must also be seen to gain.

    Judged without courses that are anew in every trial: what markers draw there can double the residual of the forces,
    beside which 32 N of a plate went unseen. A wrong record is spared: a body 3 kg heavier than written down, 48 nats
    against a scale of 0.3 kg, left in forces nothing that inertia did not take on.
    """
    kept = list(found.chosen)
    # The last that were named, which explain least, are asked first: of two that can stand for each other, they go.
    for one in reversed(found.chosen):
        if one.effect.moves_markers or one.effect.intermittent or one.effect.on_record:
            continue
        if _takes_away(found, observed, kept, one) < PLAIN:
            kept.remove(one)
    return replace(found, chosen=tuple(kept), posterior=fit(found.statistics, kept))


def _takes_away(
    found: SearchResult, observed: Sequence[TrialObservation], chosen: Sequence[Candidate], one: Candidate
) -> float:
    """Part of the residual force or moment, whichever is more, that an effect takes away beside the others chosen."""
    others = [c for c in without(chosen, one) if not c.effect.per_trial]
    with_, less = (
        sizes(observed, residuals(observed, found.design, found.prior, fit(found.statistics, some)))
        for some in ([*others, one], others)
    )
    return 1.0 - float((with_ - less).exp().min())


def stands_out(found: SearchResult, observed: Sequence[TrialObservation], k: int) -> float:
    """Part of the residual force or moment, whichever is more, that the k-th chosen effect takes away by itself.

    Nothing else makes up for it: what a hidden load needs, the inertia takes on.
    """
    n, more = found.design.inertia, []
    left = residuals(observed, found.design, found.prior, found.posterior)
    for trial, (columns, own) in enumerate(zip(found.design.trials, left, strict=True)):
        share = found.prior.scale * found.posterior.shares(len(found.prior.mean), trial)[k, n:]
        more.append(own + columns.added(share[columns.terms.live[n:] - n]))
    return 1.0 - float((sizes(observed, left) - sizes(observed, more)).exp().min())


def sizes(observed: Sequence[TrialObservation], left: Sequence[Tensor]) -> Float[Tensor, " 2"]:
    """Logarithms of the RMS of forces and moments, averaged over trials: a landing must not drown what squats show."""
    parts = [x[w.rows.used].unflatten(1, (2, 3)) for w, x in zip(observed, left, strict=True)]
    return torch.stack([0.5 * part.square().mean((0, 2)).log() for part in parts]).mean(0)


def drop_opposed(found: SearchResult) -> SearchResult:
    """Without causes on forces that mostly undo each other: what is left of such a pair has another name, or none.

    A runner's trunk that moved less than its markers was 9 kg less of mass and a tether that pulled down by as much.
    """
    energy = _energies(found)
    own = [k for k, one in enumerate(found.chosen) if not one.effect.moves_markers]
    pairs = [(i, k) for i, k in combinations(own, 2)
             if energy[[i, k]][:, [i, k]].sum() < OPPOSED * max(energy[i, i], energy[k, k])]  # fmt: skip
    out = {k for pair in pairs for k in pair}
    kept = tuple(one for k, one in enumerate(found.chosen) if k not in out)
    return replace(found, chosen=kept, posterior=fit(found.statistics, kept))


def _energies(found: SearchResult) -> Float[Tensor, "chosen chosen"]:
    """Products of what the chosen effects do to the whitened rows."""
    total = torch.zeros(len(found.chosen), len(found.chosen)).to(found.prior.mean)
    for trial, raw in enumerate(found.statistics.trials):
        share = found.posterior.shares(len(found.prior.mean), trial)[:, raw.live]
        total += share @ raw.gram[:-1, :-1] @ share.T
    return total


def restore_record(before: SearchResult, after: SearchResult) -> SearchResult:
    """With a wrong record or a common gain, if forces that were dropped have stood for it.

    A runner written down 6 kg too light was 25 nats, until forces at an arm and the thorax, which explained more and
    took nothing away from the residual, pulled at him by as much.
    """
    left = [c for c in after.scales if c not in after.chosen]
    if len(after.chosen) == len(before.chosen) or not left:
        return after
    scan = scan_all(after.statistics, left, after.chosen).round
    if scan.named is None:
        return after
    chosen = (*after.chosen, scan.named.candidate)
    rounds = (*after.rounds[:-1], scan, after.rounds[-1])
    return replace(after, chosen=chosen, posterior=fit(after.statistics, chosen), rounds=rounds)


SURELY = 3.0
"""Standard deviations below zero that refute one of several parameters that cannot be there. Set with three
recordings seen: in a runner and in walks and squats no softness of 24 segments is below zero by more than two; in a
child's walk that hardly stands on plates, two of 15 were by more than three, one by six."""


def drop_unsupported(found: SearchResult, last: bool = False) -> SearchResult:
    """Without those that the others have made superfluous, or that stood by others which have gone since.

    A late runner was 4 kg lighter than written down beside forces that pulled at his arm and thigh; they were dropped,
    and without them the record had 1.0 nat against it.
    """
    kept = list(found.chosen)
    for one in reversed(found.chosen):
        if support(found.statistics, kept, one) < NAMED:
            kept.remove(one)
    left = drop_negative(replace(found, chosen=tuple(kept), posterior=fit(found.statistics, kept)), last)
    return left if len(left.chosen) == len(found.chosen) else drop_unsupported(left, last)


def drop_negative(found: SearchResult, last: bool = False) -> SearchResult:
    """No load and no spring is negative: one is there, not its like taken away.

    That one spring of many is negative says something at ``last`` only, when nothing else goes any more: forces that
    pulled at a runner's arm and thorax, and were dropped later, had made his thorax one.
    """
    for k, one in reversed(list(enumerate(found.chosen))):
        if _negative(found, k, SURELY if last else math.inf):
            kept = tuple(without(found.chosen, one))
            return drop_negative(replace(found, chosen=kept, posterior=fit(found.statistics, kept)), last)
    return found


def _negative(found: SearchResult, k: int, surely: float) -> bool:
    """Whether all parameters that cannot be negative are, or one of them is by that many standard deviations."""
    one, factor = found.chosen[k], parameter_map(found, k)
    n = one.effect.positives(one.place)
    theta = (factor @ found.posterior.mean)[:n]
    sd = (factor @ found.posterior.covariance @ factor.T).diagonal()[:n].sqrt()
    return n > 0 and bool((theta < 0.0).all() or (theta < -surely * sd).any())
