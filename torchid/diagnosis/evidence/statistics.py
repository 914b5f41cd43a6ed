"""Gram matrices and moments of all parameters, in coordinates z in which every prior is a unit normal."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.observation.statements import Statements, positions


@dataclass(frozen=True)
class TrialStatistics:
    """Gram matrix and moment of one trial's whitened rows; what could happen in another trial alone has no columns in
    them."""

    live: Int[Tensor, " live"]
    """Columns of the design that this trial has, in order."""
    gram: Float[Tensor, "live+1 live+1"]
    """Gram matrix; its last row and column, zero, are those of all columns that do not live."""
    moment: Float[Tensor, " live+1"]
    """Moment; its last element, zero, is that of all columns that do not live."""
    stated: Statements | None = None
    """The part of both that is stated without a body model."""

    @property
    def unstated(self) -> "TrialStatistics":
        """The statistics without what is stated without a body model."""
        if self.stated is None:
            return self
        at, gram, moment = self.at(self.stated.columns), self.gram.clone(), self.moment.clone()
        gram[at[:, None], at] -= self.stated.gram
        moment[at] -= self.stated.moment
        return TrialStatistics(self.live, gram, moment)

    def at(self, columns: Int[Tensor, "*some"]) -> Int[Tensor, "*some"]:
        """Return where columns of the design stand; those that do not live stand last.

        Args:
            columns: columns of the design.
        """
        at = torch.searchsorted(self.live, columns)
        return torch.where(self.live[at.clamp(max=len(self.live) - 1)] == columns, at, len(self.live))

    def only(self, some: Int[Tensor, " fewer"]) -> "TrialStatistics":
        """Return the statistics of a design that kept some columns of this one.

        Args:
            some: columns that it kept.
        """
        at, live = positions(self.live, some)
        where = torch.cat([at, at.new_tensor([len(self.live)])])
        stated = None if self.stated is None else self.stated.only(some)
        return TrialStatistics(live, self.gram[where][:, where], self.moment[where], stated)


@dataclass(frozen=True)
class Statistics:
    """Gram matrices and moments of z, trial by trial."""

    base: int
    """Number of columns of inertia and nuisances, which every trial has; those of the candidates' sources follow."""
    shared: int
    """Number of columns that every trial has; those follow that are one trial's."""
    trials: tuple[TrialStatistics, ...]
    """Statistics of each trial."""
    constant: float = 0.0
    """Log density of all rows up to what models of one noise differ in [nat]."""

    @property
    def unstated(self) -> "Statistics":
        """The statistics without what is stated without a body model."""
        return replace(self, trials=tuple(raw.unstated for raw in self.trials))

    @property
    def all(self) -> frozenset[int]:
        """Indices of all trials."""
        return frozenset(range(len(self.trials)))

    def only(self, which: Int[Tensor, " kept"], shared: int) -> "Statistics":
        """Return the statistics of some columns alone.

        Args:
            which: indices of the columns to keep, ascending.
            shared: number of those that every trial has.
        """
        return replace(self, shared=shared, trials=tuple(raw.only(which) for raw in self.trials))

    def block(
        self, rows: slice | Tensor, columns: slice | Tensor, seen: frozenset[int]
    ) -> Float[Tensor, "rows columns"]:
        """Return part of the Gram matrix, summed over some trials.

        Args:
            rows: columns of the design that its rows are of.
            columns: columns of the design.
            seen: indices of the trials.
        """
        # Symmetric: rows of a matrix lie together in memory, columns do not.
        return self.summed(seen, lambda raw: raw.gram[_of(raw, columns)][:, _of(raw, rows)]).mT

    def moment(self, columns: slice | Tensor, seen: frozenset[int]) -> Float[Tensor, " columns"]:
        """Return part of the moment, summed over some trials.

        Args:
            columns: columns of the design.
            seen: indices of the trials.
        """
        return self.summed(seen, lambda raw: raw.moment[_of(raw, columns)])

    def summed(self, seen: frozenset[int], part: Callable[[TrialStatistics], Tensor]) -> Tensor:
        """Return the sum over some trials of a part of their statistics that is linear in them.

        Args:
            seen: indices of the trials.
            part: function that takes the part out of a trial's statistics.
        """
        left = self.all - seen
        if 0 < len(left) < len(seen):
            # All but a few: what those say taken off.
            return self.summed(self.all, part) - sum(part(self.trials[k]) for k in left)
        if left or len(self.trials) == 1:
            zero = torch.zeros_like(part(self.trials[0]))
            return sum((part(self.trials[k]) for k in seen), start=zero)
        return part(self._whole)

    @cached_property
    def _whole(self) -> TrialStatistics:
        """Sum of all trials over the shared columns: what is one trial's is never summed."""
        n, first = self.shared, self.trials[0]
        gram, moment = first.gram.new_zeros(n + 1, n + 1), first.moment.new_zeros(n + 1)
        for raw in self.trials:
            gram[:n, :n] += raw.gram[:n, :n]
            moment[:n] += raw.moment[:n]
        return TrialStatistics(first.live[:n], gram, moment)

    def cross(self, chosen: Sequence[Candidate], columns: slice | Tensor, seen: frozenset[int]) -> Tensor:
        """Return rows of the base and of chosen candidates against columns, summed over the trials in which they act.

        Args:
            chosen: the candidates.
            columns: columns of the design.
            seen: indices of the trials.
        """
        rows = [self.block(slice(self.base), columns, seen)]
        for own, relative, block in blocks_of(chosen):
            rows.append(relative.to(rows[0])[:, None] * self.block(own, columns, block & seen))
        return torch.cat(rows)


def _of(raw: TrialStatistics, some: slice | Tensor) -> slice | Tensor:
    """Return where columns stand in a trial; slices are of columns that every trial has."""
    return some if isinstance(some, slice) else raw.at(some)


def blocks_of(
    chosen: Sequence[Candidate],
) -> Iterator[tuple[Int[Tensor, " columns"], Float[Tensor, " columns"], frozenset[int]]]:
    """Yield columns and relative scales of neighbours that act in the same trials, and these.

    Args:
        chosen: candidates, in the order of their parameters.
    """
    for block, some in groupby(((one, block) for one in chosen for block in one.blocks), key=lambda both: both[1]):
        own = [one for one, _ in some]
        yield torch.cat([c.columns for c in own]), torch.cat([c.relative for c in own]), block
