"""Causes that evidence supports and that are none: where noise does not explain the residual, evidence is cheap."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.design import Candidate
from torchid.diagnosis.evidence import fit
from torchid.diagnosis.found import Search, without
from torchid.diagnosis.residual import residuals
from torchid.diagnosis.watched import Watched

PLAIN = 0.05
"""Part of the residual force or moment that a cause takes away that nobody doubts."""
OPPOSED = 0.5
"""Of the energy of the larger of two causes: what is left where they undo each other."""


def relevant(found: Search, watched: Sequence[Watched]) -> Search:
    """Where noise does not explain the residual, evidence alone is cheap: forces must also be seen to gain.

    Judged without courses that are anew in every trial: what markers draw there can double the residual of the forces,
    beside which 32 N of a plate went unseen. A wrong record is spared: a body 3 kg heavier than written down, 48 nats
    against a scale of 0.3 kg, left in forces nothing that inertia did not take on.
    """
    kept = list(found.chosen)
    # The last that were named, which explain least, are asked first: of two that can stand for each other, they go.
    for one in reversed(found.chosen):
        if one.effect.kinematic or one.effect.timed or one.effect.recorded:
            continue
        if _takes_away(found, watched, kept, one) < PLAIN:
            kept.remove(one)
    return replace(found, chosen=tuple(kept), fitted=fit(found.sums, kept))


def _takes_away(found: Search, watched: Sequence[Watched], chosen: Sequence[Candidate], one: Candidate) -> float:
    """Part of the residual force or moment, whichever is more, that an effect takes away beside the others chosen."""
    others = [c for c in without(chosen, one) if not c.effect.anew]
    with_, less = (
        sizes(watched, residuals(watched, found.design, found.prior, fit(found.sums, some)))
        for some in ([*others, one], others)
    )
    return 1.0 - float((with_ - less).exp().min())


def stands_out(found: Search, watched: Sequence[Watched], k: int) -> float:
    """Part of the residual force or moment, whichever is more, that the k-th chosen effect takes away by itself.

    Nothing else makes up for it: what a hidden load needs, the inertia takes on.
    """
    n, more = found.design.inertia, []
    left = residuals(watched, found.design, found.prior, found.fitted)
    for trial, (columns, own) in enumerate(zip(found.design.trials, left, strict=True)):
        share = found.prior.scale * found.fitted.shares(len(found.prior.mean), trial)[k, n:]
        more.append(own + columns.added(share[columns.terms.live[n:] - n]))
    return 1.0 - float((sizes(watched, left) - sizes(watched, more)).exp().min())


def sizes(watched: Sequence[Watched], left: Sequence[Tensor]) -> Float[Tensor, " 2"]:
    """Logarithms of the RMS of forces and moments, averaged over trials: a landing must not drown what squats show."""
    parts = [x[w.rows.used].unflatten(1, (2, 3)) for w, x in zip(watched, left, strict=True)]
    return torch.stack([0.5 * part.square().mean((0, 2)).log() for part in parts]).mean(0)


def without_opposed(found: Search) -> Search:
    """Without causes on forces that mostly undo each other: what is left of such a pair has another name, or none.

    A runner's trunk that moved less than its markers was 9 kg less of mass and a tether that pulled down by as much.
    """
    energy = _energies(found)
    own = [k for k, one in enumerate(found.chosen) if not one.effect.kinematic]
    pairs = [(i, k) for i, k in combinations(own, 2)
             if energy[[i, k]][:, [i, k]].sum() < OPPOSED * max(energy[i, i], energy[k, k])]  # fmt: skip
    out = {k for pair in pairs for k in pair}
    kept = tuple(one for k, one in enumerate(found.chosen) if k not in out)
    return replace(found, chosen=kept, fitted=fit(found.sums, kept))


def _energies(found: Search) -> Float[Tensor, "chosen chosen"]:
    """Products of what the chosen effects do to the whitened rows."""
    total = torch.zeros(len(found.chosen), len(found.chosen)).to(found.prior.mean)
    for trial, raw in enumerate(found.sums.trials):
        share = found.fitted.shares(len(found.prior.mean), trial)[:, raw.live]
        total += share @ raw.gram[:-1, :-1] @ share.T
    return total
