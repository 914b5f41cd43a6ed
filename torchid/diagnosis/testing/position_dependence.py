"""Whether a named force changes with the place of its point as its cause would have it.

A magnet is a constant force on a hand that hardly travels, and a spring on a thorax: the names were worth 72 and 30
nats, and no band of the residual was louder than its noise. A field beside them, linear in place, explained chi-squares
of 40 and 81 with 9 parameters, and of 3 to 10 with 9 to 12 beside eight forces that were what they were named.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.adequacy import P_VALUE, Adequacy
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.noise import standardised
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.spectra import trial_spectra, with_columns
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.interval_refinement import extra_columns, extra_terms, with_places
from torchid.diagnosis.search.result import SearchResult, without
from torchid.effects.effect import Parameter
from torchid.effects.forces import PointForce
from torchid.effects.place import Place
from torchid.effects.scene import Point, Scene
from torchid.observation.trial import TrialObservation

SHARE = 0.15**2
"""Part of what a cause and the field explain together from which on it matters: of a force that is 15 % off."""
TOLD = 1.0
"""Information over that of the prior that a direction of the field must have to count."""


class Field(PointForce):
    """A force that is linear in its point's place: whatever it is, near where the point is."""

    name = "field"
    parameters = (Parameter("force_N", 20.0, 3), Parameter("gradient_N_m", 20.0, 9))

    def force(self, scene: Scene, at: Point, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        away = at.p - at.p.mean(1, keepdim=True)
        return theta[:3, None] + theta[3:].view(3, 3) @ away


@dataclass(frozen=True)
class Misfit:
    """Of a named force, that a field beside it shows."""

    index: int
    """Of the chosen effect."""
    p_value: float
    """Of a field that explains as much by chance, for all that were looked at."""
    share: float
    """Part of what both explain that the field does."""


def misfits(found: SearchResult, observed: Sequence[TrialObservation]) -> list[Misfit]:
    """Named forces that a field beside them contradicts; those that come and go have courses of their own."""
    which = [k for k, c in enumerate(found.chosen) if isinstance(c.effect, PointForce) and not c.effect.intermittent]
    looked = (_misfit(found, observed, k, len(which)) for k in which)
    return [one for one in looked if one.p_value < P_VALUE and one.share > SHARE]


def with_misfits(rest: Adequacy, found: SearchResult, bent: Sequence[Misfit]) -> Adequacy:
    """What remains, with what fields beside named forces show."""
    if not bent:
        return rest
    worst = min(bent, key=lambda one: one.p_value)
    said = "; and ".join(_described(found.chosen[one.index], one) for one in bent)
    if rest.significant:
        return replace(rest, description=f"{rest.description}; and {said}")
    return Adequacy(True, worst.p_value, worst.share, said, beyond=True)


def _described(one: Candidate, bent: Misfit) -> str:
    what, where = one.effect.name.replace("_", " "), ", ".join(one.place.where)
    return (
        f"the force that is named {what} at {where} changes with the place of its point as no {what} does: "
        f"{100.0 * bent.share:.0f} % of what a force there explains (a magnet would do so)"
    )


def _misfit(found: SearchResult, observed: Sequence[TrialObservation], k: int, looked: int) -> Misfit:
    one = found.chosen[k]
    probe = Candidate(Field(), Place(one.place.where, point=one.place.point), one.source, found.statistics.all)
    statistics, columns = _beside(found, observed, probe)
    statistics, rest = marginalise_per_trial(statistics, found.chosen)
    model = fit(statistics, rest)
    cross, own, moment = (sum(parts) for parts in zip(*_parts(statistics, rest, columns), strict=True))
    shared = torch.linalg.solve_triangular(model.factor, torch.as_tensor(cross), upper=False)
    told, ways = torch.linalg.eigh(own - shared.T @ shared)
    left = ways.T @ (moment - shared.T @ model.whitened)
    seen = told > TOLD
    square = float((left.square() / told)[seen].sum())
    others = without(rest, one)
    energy = float(gains(statistics, fit(statistics, others), [one])[1])
    p = float(scipy.stats.chi2.sf(square, int(seen.sum()))) if bool(seen.any()) else 1.0
    return Misfit(k, min(1.0, looked * p), square / (square + 2.0 * max(energy, 0.0) + 1e-12))


def _parts(
    statistics: Statistics, chosen: Sequence[Candidate], columns: Tensor
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Trial by trial, products of the model and of further columns with those, and their moments."""
    for k in statistics.all:
        one = frozenset({k})
        yield (
            statistics.cross(chosen, columns, one),
            statistics.block(columns, columns, one),
            statistics.moment(columns, one),
        )


def _beside(found: SearchResult, observed: Sequence[TrialObservation], probe: Candidate) -> tuple[Statistics, Tensor]:
    """Sums of a search with the columns of one more candidate behind all others, and which they are."""
    design = with_places(found.design, probe, (probe.place,))
    prior, trials = found.prior.widened(design), []
    for k, (own, columns) in enumerate(zip(observed, found.design.trials, strict=True)):
        extra = extra_columns(own, design)
        rows = trial_spectra(own, columns, found.design.noisy)
        rows = with_columns(rows, extra_terms(design, k, extra), own, extra, probe.effect.noisy)
        trials.append(standardised(rows, prior, design, found.noise, k)[0])
    return replace(found.statistics, trials=tuple(trials)), design.candidates[0].columns
