"""One scan of the catalogue: log evidence that each candidate would add, with the consent of every trial."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.apparent import apparent_evidence
from torchid.diagnosis.evidence.background import background_evidence
from torchid.diagnosis.evidence.gains import gains, informed, scale_averaged_gains
from torchid.diagnosis.evidence.other_proof import NOTHING_TOLD, Told, told_nats
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import Posterior, fit
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.rivals import Rival, Round

LOOSE = 100.0
"""Resolution. Times its prior, with which the best takes away all that it can: what a narrow prior keeps it from, its
look-alikes would add beside it, and pass for other things."""


@dataclass(frozen=True)
class Scanned:
    """Candidates as all trials together speak for them, before each trial is asked for its consent."""

    statistics: Statistics
    """Statistics in which effects with parameters of their own in every trial are integrated out."""
    chosen: Sequence[Candidate]
    """Chosen effects but for those."""
    given: tuple[Statistics, Sequence[Candidate]]
    """All statistics, and all chosen effects."""
    rivals: tuple[Rival, ...]
    """Candidates with their evidence from all trials."""
    options: NamingOptions
    """Thresholds of naming."""
    largest: float | None = None
    """Share of sessions that seem to have as much of an effect as one that has it; None: the effect's own."""

    @cached_property
    def round(self) -> Round:
        """The round with each trial's consent, best first."""
        rivals, every = self.rivals, self.statistics.all
        without = [fit(self.statistics, self.chosen, every - {k}) for k in every] if len(every) > 1 else []
        if without:
            rivals = _consented(self.statistics, without, rivals, self.options.out_of_sight_nats)
        rivals = sorted(rivals, key=lambda rival: -rival.weighed)
        names = dict.fromkeys(one.candidate.effect.name for one in self.rivals)
        places = {n: [r for r in rivals if r.candidate.effect.name == n] for n in names}
        families = {n: _mean([r.weighed for r in some]) for n, some in places.items()}
        found = Round(tuple(rivals), families, self.options)
        if (best := found.named) is None:
            return found
        appearance = self._appearance(places[best.candidate.effect.name])
        compared = _compared(self.statistics, self.chosen, without, found)
        return replace(found, appearance=appearance, compared=compared)

    def _appearance(self, places: Sequence[Rival]) -> float:
        """Return ``Round.appearance`` of the places of an effect."""
        statistics, chosen = self.given
        bare, others = marginalise_per_trial(statistics.unstated, chosen)
        apparent = apparent_evidence(bare, fit(bare, others), [r.candidate for r in places], self.largest)
        both = zip(places, apparent, strict=True)
        return _mean([max(x - r.ordinary, 0.0) + math.log(r.candidate.odds) for r, x in both])


def scan_all(
    statistics: Statistics,
    left: Sequence[Candidate],
    chosen: Sequence[Candidate],
    options: NamingOptions,
    told: Told = NOTHING_TOLD,
    largest: float | None = None,
) -> Scanned:
    """Return what each candidate would add beside the chosen effects.

    Args:
        statistics: statistics of all trials, of a design that has the columns of both.
        left: candidates.
        chosen: effects that the model has.
        options: thresholds of naming.
        told: what other proof than forces says.
        largest: share of those without an effect that seem to have as much of it as one that has it; None: that of
            sessions.
    """
    given = statistics, chosen
    statistics, chosen = marginalise_per_trial(statistics, chosen)
    posterior = fit(statistics, chosen)
    gain, energy = (x.tolist() for x in gains(statistics, posterior, left))
    each = zip(left, gain, energy, _ordinary(statistics, posterior, left), strict=True)
    rivals = tuple(Rival(c, g, g, e - 0.5 * c.size, o, options=options, told=told_nats(told, c)) for c, g, e, o in each)
    return Scanned(statistics, chosen, given, rivals, options, largest)


def _ordinary(statistics: Statistics, posterior: Posterior, left: Sequence[Candidate]) -> list[float]:
    """Return ``Rival.ordinary`` of the candidates, zero but for widespread effects: places of one effect tell of each
    other."""
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


def _compared(
    statistics: Statistics, chosen: Sequence[Candidate], without: Sequence[Posterior], found: Round
) -> tuple[Rival, ...]:
    """Return the rivals with sizes averaged over orders of magnitude where they explain nearly what the best does.

    ``without`` is the base fitted to all trials but each in turn; nothing where there is one alone.
    A widespread effect keeps its own prior: it is compared with what is ordinary, which is small.
    """
    best, rivals = found.rivals[0], list(found.rivals)
    least = best.weighed - found.options.out_of_sight_nats
    near = [k for k, r in enumerate(rivals) if r.explained + 0.5 * r.candidate.size > least]
    which = [k for k in near if not rivals[k].candidate.effect.widespread]
    some = [rivals[k].candidate for k in which]
    evidence = scale_averaged_gains(statistics, fit(statistics, chosen), some)
    crossed = (
        _crossed(without, evidence, lambda base: scale_averaged_gains(statistics, base, some)) if without else evidence
    )
    less, others = marginalise_per_trial(statistics, [*chosen, replace(best.candidate, widened=LOOSE)])
    beside = scale_averaged_gains(less, fit(less, others), some)
    for k, *own in zip(which, evidence.tolist(), crossed.tolist(), beside.tolist(), strict=True):
        rivals[k] = replace(rivals[k], evidence=own[0], crossed=own[1], beside=own[2])
    return tuple(rivals)


def _consented(
    statistics: Statistics, without: Sequence[Posterior], rivals: Sequence[Rival], out_of_sight: float
) -> list[Rival]:
    """Return the rivals, with the consent of each trial to those that may come out best, or near.

    ``without`` is the base fitted to all trials but each in turn.
    """
    asked, best = [], -math.inf
    # What all trials together do not support needs no consent of each.
    silent, waiting = [r for r in rivals if r.evidence <= 0.0], [r for r in rivals if r.evidence > 0.0]
    while waiting and (top := max(r.weighed for r in waiting)) > best - out_of_sight:
        fresh = [r for r in waiting if r.weighed >= top - out_of_sight]
        waiting = [r for r in waiting if r.weighed < top - out_of_sight]
        whole = torch.tensor([r.evidence for r in fresh]).to(statistics.trials[0].moment)
        own = [r.candidate for r in fresh]
        crossed = _crossed(without, whole, lambda base, own=own: gains(statistics, base, own)[0]).tolist()
        asked += [replace(r, crossed=x) for r, x in zip(fresh, crossed, strict=True)]
        best = max(r.weighed for r in asked)
    return asked + waiting + silent


def _crossed(
    without: Sequence[Posterior], whole: Float[Tensor, " some"], gained: Callable[[Posterior], Float[Tensor, " some"]]
) -> Float[Tensor, " some"]:
    """Return the log evidence that candidates add to each trial given the others, summed over the trials [nat].

    By the chain rule, that of a trial is the evidence of all less that of the others, to which ``without`` was fitted.
    """
    return sum((whole - gained(base) for base in without), start=torch.zeros_like(whole))


def _mean(weighed: Sequence[float]) -> float:
    """Return the logarithm of the mean of exponentials of evidence whose places are weighed by their odds."""
    return float(torch.logsumexp(torch.tensor(weighed, dtype=torch.float64), 0))
