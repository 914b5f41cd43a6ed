"""Which arrangements of the units are equally likely where conditions mean nothing: all of them, or many.

Unpaired units, trials or blocks of successive cycles, have a label each, and all ways of dealing the labels are equally
likely (Anderson 2001, Can J Fish Aquat Sci 58:626). Paired units, subjects, have a difference each, whose sign is as
likely either way (Nichols & Holmes 2002, Hum Brain Mapp 15:1).

Permutation tests look at many columns at once, with the family-wise error rate controlled by the largest statistic.
The statistic of an unpaired column is the correlation r between the label and the value, which is a monotone function
of Student's t, t^2 = (n - 2) r^2 / (1 - r^2), whose denominator does not depend on the label. Adjusted p-values are
those of the step-down maximum (Westfall & Young 1993, Resampling-Based Multiple Testing, algorithm 4.1): the dependence
between joints and measures is in the permutations, and nothing has to be assumed about it.

Courses over the cycle are in the same family. The statistic of a course is that of its largest point, made as small as
that of a single measure whose chance is ``COURSE_COUNTS`` times the point's own by Student's t: courses of a hundred
points would drown measures else. The family-wise rate is exact whatever that number is, since all arrangements are
treated alike.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import torch
from jaxtyping import Bool, Float
from scipy import stats
from torch import Generator, Tensor

TIE = 1e-9
"""Resolution. Statistics that differ by less are equal: sums of the same numbers in another order."""
COURSE_COUNTS = 8
"""Choice. Measures as which a course counts in the family: one more than a coordinate has by default."""


@dataclass(frozen=True)
class Tested:
    """p-values of all columns and courses; NaN where one could not be tested."""

    p: Float[Tensor, " columns"]
    """Of each column alone."""
    adjusted: Float[Tensor, " columns"]
    """Chance that any column or course would show so much if no label meant anything."""
    statistic: Float[Tensor, " columns"]
    """Of the observed arrangement, positive where the second condition has the larger values."""
    courses: Float[Tensor, " courses"]
    """Adjusted p-values of whole courses."""
    points: Float[Tensor, "points courses"]
    """Adjusted p-values of all points of the courses."""


def correlations(
    values: Float[Tensor, "units columns"], second: Bool[Tensor, "arrangements units"]
) -> Float[Tensor, "arrangements columns"]:
    """Correlation of value and label in every arrangement, over the units that have a value.

    Args:
        values: NaN where a unit has none.
        second: units that carry the second label.

    Returns:
        Zero where fewer than two units of either label have a value, or all values are equal.
    """
    known = torch.isfinite(values)
    mask = known.to(values.dtype)
    count = mask.sum(0)
    mean = torch.where(known, values, 0.0).sum(0) / count.clamp(min=1.0)
    centred = torch.where(known, values - mean, 0.0)
    size = centred.square().sum(0).sqrt()
    labels = second.to(values.dtype)
    own = labels @ mask
    other = count - own
    scale = (count / (own * other).clamp(min=1.0)).sqrt() / size.clamp(min=1e-300)
    found = (labels @ centred) * scale
    flat = size <= TIE * (mean.abs() * count.sqrt() + 1e-12)
    return torch.where((own >= 2) & (other >= 2) & ~flat, found, 0.0)


def sign_means(
    values: Float[Tensor, "units columns"], signs: Float[Tensor, "arrangements units"]
) -> Float[Tensor, "arrangements columns"]:
    """Sum of paired differences over the root of their sum of squares, for every arrangement of signs.

    Args:
        values: differences of the units, NaN where one has none.
        signs: of ``arrangements.flip``.
    """
    known = torch.isfinite(values)
    size = torch.where(known, values, 0.0).square().sum(0).sqrt().clamp(min=1e-300)
    return (signs @ torch.where(known, values, 0.0)) / size


def counted_as_many(
    size: Float[Tensor, "*any columns"], largest: Float[Tensor, " columns"], freedom: Float[Tensor, " columns"]
) -> Float[Tensor, "*any columns"]:
    """Statistics of single measures whose chance by Student's t is ``COURSE_COUNTS`` times that of these.

    Args:
        size: absolute statistics.
        largest: that a column can have, and ``freedom`` of its t (``Arrangements.scale``).
        freedom: degrees of freedom.
    """
    freedom = freedom.clamp(min=1.0)
    r = (size / largest.clamp(min=1e-300)).clamp(max=1.0)
    t = r * (freedom / (1.0 - r.square()).clamp(min=1e-300)).sqrt()
    own = freedom.cpu().numpy()
    chance = COURSE_COUNTS * stats.t.sf(t.cpu().numpy(), own)
    less = r.new_tensor(stats.t.isf(chance.clip(max=0.5), own)).clamp(max=1e100)
    return largest * less / (less.square() + freedom).sqrt()


def step_down(
    statistics: Float[Tensor, "arrangements columns"], courses: Float[Tensor, "arrangements courses"] | None = None,
    points: Float[Tensor, "points courses"] | None = None,
) -> Tested:  # fmt: skip
    """p-values from the statistics of all arrangements, the observed one first.

    Args:
        statistics: of ``Arrangements.statistics``; a column that is zero as observed is not tested.
        courses: statistics of whole courses, NaN of those that are not tested; absent: there are none.
        points: statistics of their points as observed, NaN where one is not tested.
    """
    curves = statistics.new_zeros(len(statistics), 0) if courses is None else courses
    every = torch.cat([statistics.abs(), curves.nan_to_num(0.0)], 1)
    tested = torch.cat([statistics[0] != 0.0, curves[0].isfinite()])
    own = (every >= every[0] - TIE).to(every.dtype).mean(0)
    adjusted = torch.full_like(own, torch.nan)
    order = every[0].argsort(descending=True)
    order = order[tested[order]]
    tail = every[:, order].flip(1).cummax(1).values.flip(1)
    columns, running = statistics.shape[1], 0.0
    shown = (
        statistics.new_full((0, curves.shape[1]), torch.nan) if points is None else torch.full_like(points, torch.nan)
    )
    for k, column in enumerate(order.tolist()):
        running = max(running, float((tail[:, k] >= every[0, column] - TIE).to(every.dtype).mean()))
        adjusted[column] = running
        if points is not None and column >= columns:
            each = points[:, column - columns]
            p = (tail[:, k, None] >= each - TIE).to(every.dtype).mean(0).clamp(min=running)
            shown[:, column - columns] = torch.where(each.isfinite(), p, torch.nan)
    p = torch.where(tested, own, torch.nan)
    return Tested(p[:columns], adjusted[:columns], statistics[0], adjusted[columns:], shown)


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
