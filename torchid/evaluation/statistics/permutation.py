"""Permutation tests of many columns at once, with the family-wise error rate controlled by the largest statistic.

The statistic of a column is the correlation r between the label and the value, which is a monotone function of
Student's t, t^2 = (n - 2) r^2 / (1 - r^2), whose denominator does not depend on the label. Adjusted p-values are those
of the step-down maximum (Westfall & Young 1993, Resampling-Based Multiple Testing, algorithm 4.1): the dependence
between joints and measures is in the permutations, and nothing has to be assumed about it.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

TIE = 1e-9
"""Resolution. Statistics that differ by less are equal: sums of the same numbers in another order."""


@dataclass(frozen=True)
class Tested:
    """p-values of all columns; NaN where a column could not be tested."""

    p: Float[Tensor, " columns"]
    """Of each column alone."""
    adjusted: Float[Tensor, " columns"]
    """Chance that any column would show so much if no label meant anything."""
    statistic: Float[Tensor, " columns"]
    """Correlation of the observed arrangement, positive where the second label has the larger values."""
    critical: float
    """Absolute statistic that the largest of all columns reaches with the chance ``level`` alone."""


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
    values: Float[Tensor, "subjects columns"], signs: Float[Tensor, "arrangements subjects"]
) -> Float[Tensor, "arrangements columns"]:
    """Mean of paired differences over their root mean square, for every arrangement of signs.

    Args:
        values: differences of the subjects, NaN where one has none.
        signs: of ``arrangements.flip``.
    """
    known = torch.isfinite(values)
    size = torch.where(known, values, 0.0).square().sum(0).sqrt().clamp(min=1e-300)
    return (signs @ torch.where(known, values, 0.0)) / size


def step_down(statistics: Float[Tensor, "arrangements columns"], level: float) -> Tested:
    """p-values from the statistics of all arrangements, the observed one first.

    Args:
        statistics: of ``correlations`` or ``sign_means``; a column that is zero as observed is not tested.
        level: family-wise, for the critical value.
    """
    size = statistics.abs()
    tested = size[0] > 0.0
    p = (size >= size[0] - TIE).to(size.dtype).mean(0)
    adjusted = torch.full_like(p, torch.nan)
    order = size[0].argsort(descending=True)
    order = order[tested[order]]
    running = 0.0
    tail = size[:, order].flip(1).cummax(1).values.flip(1)
    for k, column in enumerate(order.tolist()):
        own = float((tail[:, k] >= size[0, column] - TIE).to(size.dtype).mean())
        running = max(running, own)
        adjusted[column] = running
    critical = float("inf")
    if len(order):
        largest = tail[:, 0].sort(descending=True).values
        critical = float(largest[min(len(largest) - 1, int(level * len(largest)))])
    return Tested(torch.where(tested, p, torch.nan), adjusted, statistics[0], critical)


def same_sized_p(statistics: Float[Tensor, "arrangements columns"]) -> Float[Tensor, " columns"]:
    """Single-step adjusted p-values of the columns of a curve, against the largest of all columns.

    Args:
        statistics: of all arrangements, the observed one first.
    """
    size = statistics.abs()
    return (size.amax(1, keepdim=True) >= size[0] - TIE).to(size.dtype).mean(0)
