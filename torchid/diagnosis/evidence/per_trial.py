"""Effects whose parameters are others in every trial, taken trial by trial.

Eight trials that each have 100 parameters of their own cost eight factors of 100, not one of 800: given what the trials
share, theirs are independent, so that they are integrated out of each trial's sums alone (Schur complements).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics


@dataclass(frozen=True)
class TrialPosterior:
    """What all trials together tell of one trial's parameters."""

    columns: Int[Tensor, " acting"]
    """Of the design; effects that share a source have the same ones."""
    relative: Float[Tensor, " acting"]
    """Prior standard deviations against those of the sources."""
    mean: Float[Tensor, " acting"]
    covariance: Float[Tensor, "acting acting"]

    def z(self, columns: int) -> Float[Tensor, " all"]:
        """Mean over all columns of the design."""
        return self.mean.new_zeros(columns).index_add_(0, self.columns, self.relative * self.mean)

    def lost(self, raw: TrialStatistics) -> float:
        """Degrees of freedom that the trial's rows with these sums have given to the parameters."""
        at = raw.at(self.columns)
        gram = raw.gram[at][:, at]
        return float((self.relative[:, None] * gram * self.relative * self.covariance).sum())


@dataclass(frozen=True)
class _Own:
    """Of one trial: columns, and factor of what it says of them."""

    columns: Int[Tensor, " own"]
    at: Int[Tensor, " own"]
    """Where they stand in the trial."""
    relative: Float[Tensor, " own"]
    factor: Float[Tensor, "own own"]

    def cross(self, raw: TrialStatistics) -> Float[Tensor, "own padded"]:
        return self.relative[:, None] * raw.gram[self.at]

    def moment(self, raw: TrialStatistics) -> Float[Tensor, "own 1"]:
        return (self.relative * raw.moment[self.at])[:, None]


def _own(raw: TrialStatistics, acting: Sequence[Candidate]) -> _Own:
    columns, relative = torch.cat([c.columns for c in acting]), torch.cat([c.relative for c in acting]).to(raw.gram)
    at = raw.at(columns)
    gram = relative[:, None] * raw.gram[at][:, at] * relative
    return _Own(columns, at, relative, torch.linalg.cholesky(gram + torch.eye(len(columns)).to(gram)))


def marginalise_per_trial(statistics: Statistics, chosen: Sequence[Candidate]) -> tuple[Statistics, list[Candidate]]:
    """Sums in which effects that are anew in every trial are integrated out, and the other effects."""
    anew, trials, constant = [c for c in chosen if c.effect.per_trial], [], statistics.constant
    if not anew:
        return statistics, list(chosen)
    for k, raw in enumerate(statistics.trials):
        if acting := [c for c in anew if k in c.trials]:
            own = _own(raw, acting)
            shared = torch.linalg.solve_triangular(own.factor, own.cross(raw), upper=False)
            u = torch.linalg.solve_triangular(own.factor, own.moment(raw), upper=False)
            left = torch.addmm(raw.gram, shared.T, shared, alpha=-1.0)
            raw = TrialStatistics(raw.live, left, raw.moment - shared.T @ u[:, 0])
            constant += float(0.5 * u.square().sum() - own.factor.diagonal().log().sum())
        trials.append(raw)
    return replace(statistics, trials=tuple(trials), constant=constant), [c for c in chosen if not c.effect.per_trial]


def trial_posteriors(statistics: Statistics, chosen: Sequence[Candidate]) -> Iterator[TrialPosterior]:
    """Of every trial in turn."""
    less, shared = marginalise_per_trial(statistics, chosen)
    posterior = fit(less, shared)
    mean, covariance = posterior.mean, posterior.covariance
    for k, raw in enumerate(statistics.trials):
        at, columns, relative = _acting(statistics.base, shared, k)
        here = TrialPosterior(columns, relative.to(mean), mean[at], covariance[at][:, at])
        acting = [c for c in chosen if c.effect.per_trial and k in c.trials]
        yield _joined(here, _own(raw, acting), raw) if acting else here


def _acting(
    base: int, shared: Sequence[Candidate], trial: int
) -> tuple[Int[Tensor, " some"], Int[Tensor, " some"], Float[Tensor, " some"]]:
    """Where parameters of a model without anew effects stand that act in a trial, their columns and scales."""
    at, columns, relative = [torch.arange(base)], [torch.arange(base)], [torch.ones(base, dtype=torch.float64)]
    first = base
    for one in shared:
        if trial in one.trials:
            at.append(torch.arange(first, first + one.size))
            columns.append(one.columns)
            relative.append(one.relative)
        first += one.size
    return torch.cat(at), torch.cat(columns), torch.cat(relative)


def _joined(here: TrialPosterior, own: _Own, raw: TrialStatistics) -> TrialPosterior:
    """With the trial's own parameters, which are linear in what it shares, plus what it leaves open."""
    both = torch.cat([own.cross(raw)[:, raw.at(here.columns)] * here.relative, own.moment(raw)], 1)
    solved = torch.cholesky_solve(both, own.factor)
    slope, n = -solved[:, :-1], len(here.mean)
    cross = slope @ here.covariance
    covariance = cross.new_empty(n + len(cross), n + len(cross))
    covariance[:n, :n], covariance[n:, :n], covariance[:n, n:] = here.covariance, cross, cross.T
    covariance[n:, n:] = cross @ slope.T + torch.cholesky_inverse(own.factor)
    mean = torch.cat([here.mean, solved[:, -1] + slope @ here.mean])
    return TrialPosterior(
        torch.cat([here.columns, own.columns]), torch.cat([here.relative, own.relative]), mean, covariance
    )
