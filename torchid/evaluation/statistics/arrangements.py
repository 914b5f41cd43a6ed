"""Which trials, or blocks of cycles, could have been recorded under which condition: all arrangements, or many.

Under the null hypothesis the label of a condition says nothing about the unit that carries it, so that all ways of
dealing the labels are equally likely. What is dealt is a unit that shares errors within itself: a trial, or a block of
successive cycles (Anderson 2001, Can J Fish Aquat Sci 58:626).
"""

import math
from dataclasses import dataclass
from itertools import combinations

import torch
from jaxtyping import Bool, Float
from torch import Generator, Tensor


@dataclass(frozen=True)
class Arrangements:
    """Ways of dealing labels, the observed one first."""

    second: Bool[Tensor, "arrangements units"]
    """Units that carry the second label."""
    complete: bool
    """Whether these are all there are; else they are drawn, and p-values have chance in them."""

    @property
    def least_p(self) -> float:
        """Smallest p-value that a two-sided test can give."""
        halves = int(self.second[0].sum()) * 2 == self.second.shape[1]
        return (2 if halves and self.complete else 1) / len(self.second)


def count_arrangements(first: int, second: int) -> int:
    """Number of ways of dealing two labels to so many units each."""
    return math.comb(first + second, second)


def deal(second: Bool[Tensor, " units"], most: int, seed: int) -> Arrangements:
    """All arrangements where they are at most ``most``, else as many random ones.

    Args:
        second: units that carry the second label as recorded.
        most: arrangements, the observed one included.
        seed: of random ones.
    """
    units, own = len(second), int(second.sum())
    if count_arrangements(units - own, own) <= most:
        chosen = torch.tensor(list(combinations(range(units), own)), dtype=torch.long).reshape(-1, own)
        dealt = torch.zeros(len(chosen), units, dtype=torch.bool).scatter_(1, chosen, True)
        observed = (dealt == second.cpu()).all(1)
        dealt = torch.cat([dealt[observed], dealt[~observed]])
        return Arrangements(dealt.to(second.device), True)
    generator = Generator().manual_seed(seed)
    order = torch.rand(most - 1, units, generator=generator).argsort(1)
    drawn = second.cpu()[order]
    return Arrangements(torch.cat([second.cpu()[None], drawn]).to(second.device), False)


def flip(subjects: int, most: int, seed: int) -> Float[Tensor, "arrangements subjects"]:
    """Signs of paired differences, all or many ways, the observed one (all plus) first.

    Args:
        subjects: number of differences.
        most: ways, the observed one included.
        seed: of random ones.
    """
    if 2**subjects <= most:
        ways = torch.arange(2**subjects)[:, None] >> torch.arange(subjects)
        return 1.0 - 2.0 * (ways & 1).to(torch.float64)
    generator = Generator().manual_seed(seed)
    drawn = torch.randint(0, 2, (most - 1, subjects), generator=generator).to(torch.float64)
    return torch.cat([torch.ones(1, subjects, dtype=torch.float64), 1.0 - 2.0 * drawn])
