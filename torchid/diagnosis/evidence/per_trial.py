"""Effects whose parameters are others in every trial, taken trial by trial.

Given what the trials share, such parameters are independent from trial to trial, so that they are integrated out of
each trial's statistics alone (Schur complements): eight trials that each have 100 parameters of their own cost eight
factors of 100, not one of 800.
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
    """Posterior of the parameters that act in one trial, by all trials together."""

    columns: Int[Tensor, " acting"]
    """Columns of the design; effects that share a source have the same ones."""
    relative: Float[Tensor, " acting"]
    """Prior standard deviations over those of the sources."""
    mean: Float[Tensor, " acting"]
    """Mean, in units of the priors."""
    covariance: Float[Tensor, "acting acting"]
    """Covariance, in units of the priors."""

    def z(self, columns: int) -> Float[Tensor, " all"]:
        """Return the mean of z over all columns of the design.

        Args:
            columns: number of columns.
        """
        return self.mean.new_zeros(columns).index_add_(0, self.columns, self.relative * self.mean)

    def lost(self, raw: TrialStatistics) -> float:
        """Return the degrees of freedom that a trial's rows have given to the parameters.

        Args:
            raw: statistics of the rows.
        """
        at = raw.at(self.columns)
        gram = raw.gram[at][:, at]
        return float((self.relative[:, None] * gram * self.relative * self.covariance).sum())


@dataclass(frozen=True)
class _Own:
    """Columns of one trial's own parameters, and the factor of what it says of them."""

    columns: Int[Tensor, " own"]
    """Columns of the design."""
    at: Int[Tensor, " own"]
    """Positions of the columns in the trial."""
    relative: Float[Tensor, " own"]
    """Prior standard deviations over those of the sources."""
    factor: Float[Tensor, "own own"]
    """Lower Cholesky factor of their Gram matrix plus the unit matrix."""

    def cross(self, raw: TrialStatistics) -> Float[Tensor, "own padded"]:
        """Return products of the own columns with all columns of the trial."""
        return self.relative[:, None] * raw.gram[self.at]

    def moment(self, raw: TrialStatistics) -> Float[Tensor, "own 1"]:
        """Return the moment of the own columns."""
        return (self.relative * raw.moment[self.at])[:, None]


def _own(raw: TrialStatistics, acting: Sequence[Candidate]) -> _Own:
    """Return the columns of effects that act in a trial with parameters of their own."""
    columns, relative = torch.cat([c.columns for c in acting]), torch.cat([c.relative for c in acting]).to(raw.gram)
    at = raw.at(columns)
    gram = relative[:, None] * raw.gram[at][:, at] * relative
    return _Own(columns, at, relative, torch.linalg.cholesky(gram + torch.eye(len(columns)).to(gram)))


def marginalise_per_trial(statistics: Statistics, chosen: Sequence[Candidate]) -> tuple[Statistics, list[Candidate]]:
    """Return statistics in which effects with parameters of their own in every trial are integrated out, and the
    others.

    Args:
        statistics: statistics of all trials.
        chosen: effects of the model.
    """
    apart, trials, constant = [c for c in chosen if c.effect.per_trial], [], statistics.constant
    if not apart:
        return statistics, list(chosen)
    for k, raw in enumerate(statistics.trials):
        if acting := [c for c in apart if k in c.trials]:
            own = _own(raw, acting)
            shared = torch.linalg.solve_triangular(own.factor, own.cross(raw), upper=False)
            u = torch.linalg.solve_triangular(own.factor, own.moment(raw), upper=False)
            left = torch.addmm(raw.gram, shared.T, shared, alpha=-1.0)
            raw = TrialStatistics(raw.live, left, raw.moment - shared.T @ u[:, 0])
            constant += float(0.5 * u.square().sum() - own.factor.diagonal().log().sum())
        trials.append(raw)
    return replace(statistics, trials=tuple(trials), constant=constant), [c for c in chosen if not c.effect.per_trial]


def trial_posteriors(statistics: Statistics, chosen: Sequence[Candidate]) -> Iterator[TrialPosterior]:
    """Yield the posterior of every trial in turn.

    Args:
        statistics: statistics of all trials.
        chosen: effects of the model.
    """
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
    """Return positions, columns and scales of shared parameters that act in a trial."""
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
    """Return the posterior with the trial's own parameters, which are linear in what trials share, plus what it leaves
    open."""
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
