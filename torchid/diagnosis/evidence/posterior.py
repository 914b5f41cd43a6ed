"""Evidence of models that are linear in inertia, nuisances and effects, all integrated out.

In coordinates in which every prior is a unit normal, a model with columns I has log evidence (up to what all models
share) b' L^-1 b / 2 - log det L / 2 with L = G_II + 1. A candidate's gain over a base follows from the Schur complement
of the base: one factorisation serves the whole catalogue.

Reference: MacKay, Neural Computation 4:415 (1992), on evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.statistics import Statistics, blocks_of


@dataclass(frozen=True)
class Posterior:
    """Posterior of one model: chosen effects, factor of L, whitened moment; base columns first."""

    chosen: tuple[Candidate, ...]
    """Effects of the model."""
    seen: frozenset[int]
    """Indices of the trials that it was fitted to."""
    factor: Float[Tensor, "n n"]
    """Lower Cholesky factor of L."""
    whitened: Float[Tensor, " n"]
    """Inverse of the factor times the moment."""

    @property
    def log_evidence(self) -> float:
        """Log evidence up to what all models of the same rows share [nat]."""
        return float(0.5 * self.whitened @ self.whitened - self.factor.diagonal().log().sum())

    @property
    def mean(self) -> Float[Tensor, " n"]:
        """Mean of z: base columns, then each chosen effect's, block after block of trials."""
        return torch.linalg.solve_triangular(self.factor.T, self.whitened[:, None], upper=True)[:, 0]

    @property
    def covariance(self) -> Float[Tensor, "n n"]:
        """Covariance of z, in the order of ``mean``."""
        return torch.cholesky_inverse(self.factor)

    @property
    def information(self) -> Float[Tensor, "n n"]:
        """Inverse of ``covariance``."""
        return self.factor @ self.factor.mT

    def z(self, columns: int, trial: int) -> Float[Tensor, " all"]:
        """Return the mean of z over all columns of the design in one trial.

        Args:
            columns: number of columns of the design.
            trial: index of the trial.
        """
        found = self.shares(columns, trial).sum(0)
        base = len(self.factor) - sum(c.size for c in self.chosen)
        # Candidates may share the columns of nuisances.
        found[:base] += self.mean[:base]
        return found

    def shares(self, columns: int, trial: int) -> Float[Tensor, "chosen all"]:
        """Return the share of each chosen effect in the mean of z in one trial.

        Args:
            columns: number of columns of the design.
            trial: index of the trial.
        """
        mean = self.mean
        found = mean.new_zeros(len(self.chosen), columns)
        at = len(mean) - sum(c.size for c in self.chosen)
        for k, one in enumerate(self.chosen):
            for block in one.blocks:
                if trial in block:
                    found[k, one.columns] = one.relative.to(mean) * mean[at : at + len(one.columns)]
                at += len(one.columns)
        return found


def assembled(
    statistics: Statistics, chosen: Sequence[Candidate], seen: frozenset[int]
) -> tuple[Float[Tensor, "n n"], Float[Tensor, " n"]]:
    """Return Gram matrix and moment of the base and some effects.

    Args:
        statistics: statistics of all trials.
        chosen: the effects.
        seen: indices of the trials to sum over.
    """
    blocks = [statistics.cross(chosen, slice(statistics.base), seen)]
    moments = [statistics.moment(slice(statistics.base), seen)]
    for own, scale, block in blocks_of(chosen):
        relative = scale.to(blocks[0])
        blocks.append(statistics.cross(chosen, own, block & seen) * relative)
        moments.append(relative * statistics.moment(own, block & seen))
    return torch.cat(blocks, 1), torch.cat(moments)


def fit(statistics: Statistics, chosen: Sequence[Candidate] = (), seen: frozenset[int] | None = None) -> Posterior:
    """Return the posterior of the model with some effects, on some trials.

    Args:
        statistics: statistics of all trials.
        chosen: the effects.
        seen: indices of the trials; None: all.
    """
    seen = statistics.all if seen is None else seen
    L, moment = assembled(statistics, chosen, seen)
    factor = torch.linalg.cholesky(L + torch.eye(len(L)).to(L))
    whitened = torch.linalg.solve_triangular(factor, moment[:, None], upper=False)[:, 0]
    return Posterior(tuple(chosen), seen, factor, whitened)
