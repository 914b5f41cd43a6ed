"""Which arrangements of the units are equally likely where conditions mean nothing: all of them, or many.

Unpaired units, trials or blocks of successive cycles, have a label each, and all ways of dealing the labels are equally
likely (Anderson 2001, Can J Fish Aquat Sci 58:626). Paired units, subjects, have a difference each, whose sign is as
likely either way (Nichols & Holmes 2002, Hum Brain Mapp 15:1).
"""

import math
from dataclasses import dataclass
from itertools import combinations

import torch
from jaxtyping import Bool, Float
from torch import Generator, Tensor

from torchid.evaluation.statistics.permutation import correlations, sign_means


@dataclass(frozen=True)
class Arrangements:
    """Labels dealt to units, or signs given to their differences, the observed arrangement first."""

    ways: Tensor
    """(arrangements, units): units that carry the second label; 1 or -1 where units are paired."""
    paired: bool
    complete: bool
    """Whether these are all there are; else they are drawn, and p-values have chance in them."""

    @property
    def least_p(self) -> float:
        """Smallest p-value that a two-sided test can give."""
        mirrored = self.paired or int(self.ways[0].sum()) * 2 == self.ways.shape[1]
        return (2 if mirrored and self.complete else 1) / len(self.ways)

    def statistics(self, values: Float[Tensor, "units columns"]) -> Float[Tensor, "arrangements columns"]:
        """The statistic of every column in all arrangements, zero where it cannot be tested.

        Args:
            values: of the units, or their differences where they are paired; NaN where a unit has none.
        """
        if not self.paired:
            return correlations(values, self.ways)
        return torch.where(torch.isfinite(values).sum(0) >= 2, sign_means(values, self.ways), 0.0)

    def scale(
        self, values: Float[Tensor, "units columns"]
    ) -> tuple[Float[Tensor, " columns"], Float[Tensor, " columns"]]:
        """Largest statistic that a column can have, and degrees of freedom of its Student's t.

        Args:
            values: as of ``statistics``.
        """
        count = torch.isfinite(values).sum(0).to(values.dtype)
        return (count.sqrt(), count - 1.0) if self.paired else (torch.ones_like(count), count - 2.0)


def count_arrangements(first: int, second: int) -> int:
    """Number of ways of dealing two labels to so many units each."""
    return math.comb(first + second, second)


def deal(second: Bool[Tensor, " units"], most: int, seed: int) -> Arrangements:
    """All arrangements of labels where they are at most ``most``, else as many random ones.

    Args:
        second: units that carry the second label as recorded.
        most: arrangements, the observed one included.
    """
    units, own = len(second), int(second.sum())
    if count_arrangements(units - own, own) <= most:
        chosen = torch.tensor(list(combinations(range(units), own)), dtype=torch.long).reshape(-1, own)
        dealt = torch.zeros(len(chosen), units, dtype=torch.bool).scatter_(1, chosen, True)
        observed = (dealt == second.cpu()).all(1)
        dealt = torch.cat([dealt[observed], dealt[~observed]])
        return Arrangements(dealt.to(second.device), False, True)
    generator = Generator().manual_seed(seed)
    order = torch.rand(most - 1, units, generator=generator).argsort(1)
    drawn = second.cpu()[order]
    return Arrangements(torch.cat([second.cpu()[None], drawn]).to(second.device), False, False)


def flip(units: int, most: int, seed: int) -> Arrangements:
    """Signs of paired differences, all or many ways, the observed one (all plus) first.

    Args:
        most: ways, the observed one included.
        seed: of random ones.
    """
    if 2**units <= most:
        ways = torch.arange(2**units)[:, None] >> torch.arange(units)
        return Arrangements(1.0 - 2.0 * (ways & 1).to(torch.float64), True, True)
    generator = Generator().manual_seed(seed)
    drawn = torch.randint(0, 2, (most - 1, units), generator=generator).to(torch.float64)
    first = torch.ones(1, units, dtype=torch.float64)
    return Arrangements(torch.cat([first, 1.0 - 2.0 * drawn]), True, False)
