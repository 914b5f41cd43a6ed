"""One scan of the catalogue: what each candidate would add, with the consent of every trial."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.background import background_evidence
from torchid.diagnosis.evidence.gains import gains, informed, scale_averaged_gains
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import Posterior, fit
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.rivals import OUT_OF_SIGHT, Rival, Round

LOOSE = 100.0
"""Times its prior, with which the best takes away all that it can: what a narrow prior keeps it from, its look-alikes
would add beside it, and pass for other things."""


@dataclass(frozen=True)
class Scanned:
    """Candidates as all trials together speak for them, and what against."""

    statistics: Statistics
    chosen: Sequence[Candidate]
    """But for effects that are anew in every trial, which are integrated out of the sums."""
    rivals: tuple[Rival, ...]

    @cached_property
    def round(self) -> Round:
        """With each trial's consent, best first."""
        rivals = self.rivals if len(self.statistics.all) == 1 else _consented(self.statistics, self.chosen, self.rivals)
        rivals = sorted(rivals, key=lambda rival: -rival.weighed)
        names = dict.fromkeys(one.candidate.effect.name for one in self.rivals)
        families = {n: _mean([r for r in rivals if r.candidate.effect.name == n]) for n in names}
        found = Round(tuple(rivals), families)
        return found if found.named is None else replace(found, compared=_compared(self.statistics, self.chosen, found))


def scan_all(statistics: Statistics, left: Sequence[Candidate], chosen: Sequence[Candidate]) -> Scanned:
    """Candidates beside the chosen ones.

    Args:
        sums: of all trials, of a design that has the columns of both.
        left: candidates.
        chosen: effects that the model has.
    """
    statistics, chosen = marginalise_per_trial(statistics, chosen)
    posterior = fit(statistics, chosen)
    gain, energy = (x.tolist() for x in gains(statistics, posterior, left))
    each = zip(left, gain, energy, _ordinary(statistics, posterior, left), strict=True)
    return Scanned(statistics, chosen, tuple(Rival(c, g, g, e - 0.5 * c.size, usual) for c, g, e, usual in each))


def _ordinary(statistics: Statistics, posterior: Posterior, left: Sequence[Candidate]) -> list[float]:
    """See ``Rival``; the places of an effect tell of each other."""
    found = [0.0] * len(left)
    for name in dict.fromkeys(c.effect.name for c in left if c.effect.widespread):
        which = [k for k, c in enumerate(left) if c.effect.name == name]
        seen = list(informed(statistics, posterior, [left[k] for k in which]))
        usual = background_evidence(
            torch.cat([told for _, told, _ in seen]), torch.cat([moment for _, _, moment in seen])
        )
        for k, x in zip((which[k] for rows, _, _ in seen for k in rows), usual.tolist(), strict=True):
            found[k] = x
    return found


def _compared(statistics: Statistics, chosen: Sequence[Candidate], found: Round) -> tuple[Rival, ...]:
    """Rivals of any smaller size that could come near the best by what they explain.

    What is strewn is judged by what is ordinary, which is small: its own prior stays.
    """
    best, rivals = found.rivals[0], list(found.rivals)
    least = best.weighed - OUT_OF_SIGHT
    near = [k for k, r in enumerate(rivals) if r.explained + 0.5 * r.candidate.size > least]
    which = [k for k in near if not rivals[k].candidate.effect.widespread]
    some = [rivals[k].candidate for k in which]
    evidence = scale_averaged_gains(statistics, fit(statistics, chosen), some)
    base = [fit(statistics, chosen, statistics.all - {k}) for k in statistics.all]
    crossed = (
        _crossed(base, evidence, lambda without: scale_averaged_gains(statistics, without, some))
        if len(base) > 1
        else evidence
    )
    less, others = marginalise_per_trial(statistics, [*chosen, replace(best.candidate, widened=LOOSE)])
    beside = scale_averaged_gains(less, fit(less, others), some)
    for k, *own in zip(which, evidence.tolist(), crossed.tolist(), beside.tolist(), strict=True):
        rivals[k] = replace(rivals[k], evidence=own[0], crossed=own[1], beside=own[2])
    return tuple(rivals)


def _consented(statistics: Statistics, chosen: Sequence[Candidate], rivals: Sequence[Rival]) -> list[Rival]:
    """With the consent of each trial to those that may come out best, or near."""
    base = [fit(statistics, chosen, statistics.all - {k}) for k in statistics.all]
    asked, best = [], -math.inf
    # What all trials together do not support needs no consent of each.
    silent, waiting = [r for r in rivals if r.evidence <= 0.0], [r for r in rivals if r.evidence > 0.0]
    while waiting and (top := max(r.weighed for r in waiting)) > best - OUT_OF_SIGHT:
        fresh = [r for r in waiting if r.weighed >= top - OUT_OF_SIGHT]
        waiting = [r for r in waiting if r.weighed < top - OUT_OF_SIGHT]
        whole = torch.tensor([r.evidence for r in fresh]).to(statistics.trials[0].moment)
        own = [r.candidate for r in fresh]
        crossed = _crossed(base, whole, lambda without, own=own: gains(statistics, without, own)[0]).tolist()
        asked += [replace(r, crossed=x) for r, x in zip(fresh, crossed, strict=True)]
        best = max(r.weighed for r in asked)
    return asked + waiting + silent


def _crossed(
    base: Sequence[Posterior], whole: Float[Tensor, " some"], gained: Callable[[Posterior], Float[Tensor, " some"]]
) -> Float[Tensor, " some"]:
    """Log evidence that candidates add to what each trial says after the others, summed over the trials.

    By the chain rule, that of a trial is the evidence of all less that of the others, to which ``base`` was fitted.
    """
    return sum((whole - gained(without) for without in base), start=torch.zeros_like(whole))


def _mean(rivals: Sequence[Rival]) -> float:
    """Log of the mean of exponentials, places weighed by their odds."""
    return float(torch.logsumexp(torch.tensor([r.weighed for r in rivals], dtype=torch.float64), 0))
