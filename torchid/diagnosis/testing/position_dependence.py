"""Test of named forces: each must change with the place of its point as its cause would have it.

A magnet is nearly a constant force on a hand that hardly travels, and nearly a spring on a thorax, and leaves no band
of the residual louder than its noise. A field beside the named force, linear in place, tells it: what the field
explains by itself has a chi-square of as many degrees of freedom as it has directions that the motion shows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.result import SearchResult, without
from torchid.effects.effect import Parameter
from torchid.effects.forces import PointForce
from torchid.effects.place import Place
from torchid.effects.scene import BodyPoint, Scene
from torchid.observation.trial import TrialObservation

INFORMATIVE = 1.0
"""Resolution. Information over that of the prior from which on the motion shows a direction of the field."""


class Field(PointForce):
    """A force that is linear in its point's place, as any field is near where the point is."""

    name = "field"
    parameters = (Parameter("force_N", 20.0, 3), Parameter("gradient_N_m", 20.0, 9))

    def force(self, scene: Scene, at: BodyPoint, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        """Return the force at the point in W [N], from its mean [N] and its gradient [N/m] in theta.

        Args:
            scene: motion of the trial.
            at: the point.
            theta: mean force, then the rows of the gradient.
        """
        away = at.p - at.p.mean(1, keepdim=True)
        return theta[:3, None] + theta[3:].view(3, 3) @ away


@dataclass(frozen=True)
class FieldMisfit:
    """A named force that a field beside it contradicts, or does not."""

    index: int
    """Index of the chosen effect."""
    p_value: float
    """Chance that a field explains as much, times the number of forces that were looked at."""
    share: float
    """Part of what both explain that the field does."""


def misfits(found: SearchResult, observed: Sequence[TrialObservation]) -> list[FieldMisfit]:
    """Return the named forces that a field beside them contradicts; those that come and go have courses of their own.

    Args:
        found: result of the search.
        observed: fit trials.
    """
    which = [k for k, c in enumerate(found.named) if isinstance(c.effect, PointForce) and not c.effect.intermittent]
    looked = (_misfit(found, observed, k, len(which)) for k in which)
    limits = found.options.adequacy
    return [one for one in looked if one.p_value < limits.p_value and one.share > limits.position_part]


def with_misfits(rest: Adequacy, found: SearchResult, bent: Sequence[FieldMisfit]) -> Adequacy:
    """Return what remains, with what fields beside named forces show.

    Args:
        rest: adequacy of the model.
        found: result of the search.
        bent: named forces that a field contradicts.
    """
    if not bent:
        return rest
    worst = min(bent, key=lambda one: one.p_value)
    said = "; and ".join(_described(found.chosen[one.index], one) for one in bent)
    if rest.significant:
        return replace(rest, description=f"{rest.description}; and {said}")
    return Adequacy(True, worst.p_value, worst.share, said, beyond=True)


def _described(one: Candidate, bent: FieldMisfit) -> str:
    """Return a sentence on a force that a field contradicts."""
    what, where = one.effect.name.replace("_", " "), ", ".join(one.place.where)
    return (
        f"the force that is named {what} at {where} changes with the place of its point as no {what} does: "
        f"{100.0 * bent.share:.0f} % of what a force there explains (a magnet would do so)"
    )


def _misfit(found: SearchResult, observed: Sequence[TrialObservation], k: int, looked: int) -> FieldMisfit:
    """Return what a field beside the k-th chosen effect shows."""
    one = found.chosen[k]
    probe = Candidate(Field(), Place(one.place.where, point=one.place.point), one.source, found.model.statistics.all)
    beside, (field,) = found.model.append(observed, probe, (probe.place,))
    statistics, columns = beside.statistics, field.columns
    statistics, rest = marginalise_per_trial(statistics, found.chosen)
    model = fit(statistics, rest)
    cross, own, moment = (sum(parts) for parts in zip(*_parts(statistics, rest, columns), strict=True))
    shared = torch.linalg.solve_triangular(model.factor, torch.as_tensor(cross), upper=False)
    told, ways = torch.linalg.eigh(own - shared.T @ shared)
    left = ways.T @ (moment - shared.T @ model.whitened)
    seen = told > INFORMATIVE
    square = float((left.square() / told)[seen].sum())
    others = without(rest, one)
    energy = float(gains(statistics, fit(statistics, others), [one])[1])
    p = float(scipy.stats.chi2.sf(square, int(seen.sum()))) if bool(seen.any()) else 1.0
    return FieldMisfit(k, min(1.0, looked * p), square / (square + 2.0 * max(energy, 0.0) + 1e-12))


def _parts(
    statistics: Statistics, chosen: Sequence[Candidate], columns: Tensor
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yield, trial by trial, products of the model and of further columns with the latter, and the moments of the
    latter."""
    for k in statistics.all:
        one = frozenset({k})
        yield (
            statistics.cross(chosen, columns, one),
            statistics.block(columns, columns, one),
            statistics.moment(columns, one),
        )
