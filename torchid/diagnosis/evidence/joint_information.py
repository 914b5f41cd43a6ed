"""Information that data hold of the parameters of all candidates at once, and what they say of them, beside a base.

The blocks on its diagonal are those of ``gains.informed``; the others say how much one effect looks like another.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.posterior import Posterior
from torchid.diagnosis.evidence.statistics import Statistics


@dataclass(frozen=True)
class JointInformation:
    """Information and moment of all parameters of some candidates, in units of their priors."""

    candidates: tuple[Candidate, ...]
    """The candidates that act in a trial of the base."""
    at: tuple[Int[Tensor, " _"], ...]
    """Indices of the parameters of each candidate."""
    value: Float[Tensor, "all all"]
    """The information."""
    moment: Float[Tensor, " all"]
    """Moment of the data: the parameters would be estimated as the information's inverse times it."""

    def between(self, one: int, other: int) -> Float[Tensor, "n m"]:
        """Return the block of two candidates.

        Args:
            one: index of the candidate of its rows.
            other: index of that of its columns.
        """
        return self.value[self.at[one]][:, self.at[other]]

    def taken_by_each(self, one: int, scatter: Float[Tensor, "n n"]) -> Float[Tensor, " candidates"]:
        """Return the mean energy that each candidate, with a unit prior, takes away of what one of them does.

        Args:
            one: index of the one.
            scatter: mean square of its parameters, in units of their priors.
        """
        seen = self._whitened[:, self.at[one]]
        energy, owner = ((seen @ scatter) * seen).sum(1), torch.arange(len(self.at), device=seen.device)
        sizes = torch.tensor([len(at) for at in self.at], device=seen.device)
        return energy.new_zeros(len(self.at)).index_add_(0, owner.repeat_interleave(sizes), energy)

    @cached_property
    def _whitened(self) -> Float[Tensor, "all all"]:
        """Rows of the information of each candidate, times the inverse factor of its own block with the prior."""
        found = torch.empty_like(self.value)
        for at in self.at:
            factor = torch.linalg.cholesky(self.value[at][:, at] + torch.eye(len(at)).to(self.value))
            found[at] = torch.linalg.solve_triangular(factor, self.value[at], upper=False)
        return found


def joint_information(statistics: Statistics, base: Posterior, candidates: Sequence[Candidate]) -> JointInformation:
    """Return the information of all candidates' parameters.

    Args:
        statistics: statistics of all trials.
        base: posterior of the base.
        candidates: candidates of the same design, whose parameters all their trials share.
    """
    groups: dict[frozenset[int], list[Candidate]] = {}
    for one in candidates:
        assert not one.effect.per_trial, "parameters that differ from trial to trial"
        if block := one.trials & base.seen:
            groups.setdefault(block, []).append(one)
    if not groups:
        return JointInformation((), (), base.factor.new_zeros(0, 0), base.factor.new_zeros(0))
    parts = [_Part.of(statistics, base, block, some) for block, some in groups.items()]
    rows = [torch.cat([one.against(other, statistics) for other in parts], 1) for one in parts]
    moment = torch.cat([one.moment(base, statistics) for one in parts])
    order = tuple(one for some in groups.values() for one in some)
    at = torch.arange(len(moment)).split([len(one.columns) for one in order])
    return JointInformation(order, at, torch.cat(rows), moment)


@dataclass(frozen=True)
class _Part:
    """Parameters that act in the same trials."""

    block: frozenset[int]
    """The trials."""
    columns: Int[Tensor, " n"]
    """Columns of the design."""
    relative: Float[Tensor, " n"]
    """Standard deviations of the priors over those of the columns' sources."""
    shared: Float[Tensor, "base n"]
    """Whitened products with the base."""

    @classmethod
    def of(cls, statistics: Statistics, base: Posterior, block: frozenset[int], some: Sequence[Candidate]) -> "_Part":
        """Return the parameters of some candidates in some trials."""
        columns, relative = torch.cat([c.columns for c in some]), torch.cat([c.relative for c in some]).to(base.factor)
        cross = statistics.cross(base.chosen, columns, block) * relative
        return cls(block, columns, relative, torch.linalg.solve_triangular(base.factor, cross, upper=False))

    def moment(self, base: Posterior, statistics: Statistics) -> Float[Tensor, " n"]:
        """Return what the data say of them beside the base."""
        return self.relative * statistics.moment(self.columns, self.block) - self.shared.mT @ base.whitened

    def against(self, other: "_Part", statistics: Statistics) -> Float[Tensor, "n m"]:
        """Return the information of both."""
        own = statistics.block(self.columns, other.columns, self.block & other.block)
        return self.relative[:, None] * own * other.relative - self.shared.mT @ other.shared
