"""Statements of a trial on errors of measuring, beside its rows of forces: normal equations of a few columns."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Statements:
    """Gram matrix and moment of whitened statements, dimensionless for unit parameters."""

    columns: Int[Tensor, " some"]
    """Columns of the design that change the statements, ascending."""
    gram: Float[Tensor, "some some"]
    """Products of these columns with each other."""
    moment: Float[Tensor, " some"]
    """Products of these columns with the statements."""

    def only(self, some: Int[Tensor, " kept"]) -> "Statements":
        """Return the statements in a design that kept some columns.

        Args:
            some: columns that it kept, ascending.
        """
        at, kept = positions(self.columns, some)
        return Statements(kept, self.gram[at][:, at], self.moment[at])

    def times(self, factor: float) -> "Statements":
        """Return the statements as if they were told so many times.

        Args:
            factor: that number.
        """
        return Statements(self.columns, factor * self.gram, factor * self.moment)

    def __add__(self, other: "Statements") -> "Statements":
        columns = torch.cat([self.columns, other.columns]).unique()
        n = len(columns)
        found = Statements(columns, self.gram.new_zeros(n, n), self.moment.new_zeros(n))
        for one in (self, other):
            at = torch.searchsorted(columns, one.columns)
            found.gram[at[:, None], at] += one.gram
            found.moment[at] += one.moment
        return found


def positions(
    live: Int[Tensor, " live"], some: Int[Tensor, " some"]
) -> tuple[Int[Tensor, " kept"], Int[Tensor, " kept"]]:
    """Return where those of some columns that live stand among all that do, and which of the some they are.

    Args:
        live: columns that there are, ascending.
        some: columns to find.
    """
    at = torch.searchsorted(live, some).clamp(max=len(live) - 1)
    there = (live[at] == some).nonzero()[:, 0] if len(live) else some[:0]
    return at[there], there
