"""Two conditions compared: all measures in one family of hypotheses, then the courses of what was found.

Measures are tested at the level. Courses over the cycle say when a difference is there; they are looked at for the
coordinates of which a measure was found, so that a report on data without any effect says something false as rarely as
the measures alone do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.config.conditions import EvaluateOptions
from torchid.evaluation.statistics.arrangements import Arrangements, deal
from torchid.evaluation.statistics.effects import Estimate, difference_of, hedges
from torchid.evaluation.statistics.permutation import Tested, correlations, same_sized_p, step_down
from torchid.evaluation.statistics.units import Units, choose_units, unit_means


@dataclass(frozen=True)
class MeasureColumn:
    """What a column of measures holds."""

    where: str
    """Coordinate, ``L5/S1``, or ``gait``."""
    measure: str
    side: str = ""
    """Side of the coordinate, empty for the trunk and for what all cycles judge."""


@dataclass(frozen=True)
class Sample:
    """Measures of cycles in the order of recording."""

    trials: tuple[str, ...]
    """Trial of every cycle."""
    conditions: tuple[str, ...]
    """Condition of every cycle."""
    columns: tuple[MeasureColumn, ...]
    values: Float[Tensor, "cycles columns"]
    """NaN where a cycle does not tell."""
    draws: Float[Tensor, "draws cycles columns"] | None = None
    """The same with other bodies, each the same body in all cycles."""
    sides: tuple[str, ...] = ()
    """Foot of every cycle, empty for the whole body's."""

    def of(self, names: Sequence[str]) -> "Sample":
        """The cycles of some conditions.

        Args:
            names: of the conditions.
        """
        kept = [k for k, name in enumerate(self.conditions) if name in names]
        draws = None if self.draws is None else self.draws[:, kept]
        trials, conditions = (tuple(x[k] for k in kept) for x in (self.trials, self.conditions))
        return Sample(trials, conditions, self.columns, self.values[kept], draws)


@dataclass(frozen=True)
class Comparison:
    """One condition against the reference."""

    reference: str
    condition: str
    columns: tuple[MeasureColumn, ...]
    units: Units
    least_p: float
    """Smallest p-value that these units can give."""
    complete: bool
    """Whether all arrangements were tried."""
    difference: Estimate
    effect: Estimate
    tested: Tested

    def found(self, level: float) -> list[int]:
        """Columns whose difference is a finding at a family-wise level.

        Args:
            level: of all comparisons of the evaluation together.
        """
        return [k for k, p in enumerate(self.tested.adjusted.tolist()) if p <= level]


def compare(sample: Sample, reference: str, condition: str, options: EvaluateOptions, seed: int) -> Comparison:
    """Compare a condition with the reference in all columns.

    Args:
        sample: cycles of these conditions, and perhaps of others.
        reference: condition whose mean is subtracted.
        condition: the other one.
        options: units, level, number of permutations.
        seed: of random arrangements.
    """
    own = sample.of((reference, condition))
    units = choose_units(own.values, own.trials, [name == condition for name in own.conditions], options)
    means = unit_means(own.values, units)
    draws = None if own.draws is None else unit_means(own.draws, units)
    ways = deal(units.second, options.permutations, seed)
    statistics = correlations(means, ways.second)
    if not units.testable:
        statistics = torch.zeros_like(statistics)
    return Comparison(
        reference, condition, own.columns, units, ways.least_p, ways.complete,
        difference_of(means, units.second, draws), hedges(means, units.second), step_down(statistics, options.level),
    )  # fmt: skip


def with_others(comparison: Comparison, comparisons: int) -> Comparison:
    """The comparison with its adjusted p-values multiplied by the number of comparisons (Bonferroni).

    Args:
        comparison: of one condition.
        comparisons: how many conditions are compared with the reference.
    """
    old = comparison.tested
    tested = Tested(old.p, (old.adjusted * comparisons).clamp(max=1.0), old.statistic, old.critical)
    return Comparison(
        comparison.reference, comparison.condition, comparison.columns, comparison.units, comparison.least_p,
        comparison.complete, comparison.difference, comparison.effect, tested,
    )  # fmt: skip


def course_p(
    curves: Float[Tensor, "cycles points coordinates"],
    units: Units,
    options: EvaluateOptions,
    seed: int,
) -> Float[Tensor, "points coordinates"]:
    """p-values of all points of the courses, adjusted for all points of all coordinates.

    Args:
        curves: normalised courses of the cycles of two conditions, NaN where not known.
        units: of the same cycles.
        options: number of permutations.
        seed: of random arrangements.
    """
    cycles, points, coordinates = curves.shape
    if not units.testable or not coordinates:
        return curves.new_full((points, coordinates), torch.nan)
    means = unit_means(curves.reshape(cycles, -1), units)
    ways: Arrangements = deal(units.second, options.permutations, seed)
    statistics = correlations(means, ways.second)
    p = same_sized_p(statistics)
    return torch.where(statistics[0] != 0.0, p, torch.nan).reshape(points, coordinates)


def spans(significant: Bool[Tensor, " points"]) -> list[tuple[float, float]]:
    """Runs of points as parts of the cycle, in percent.

    Args:
        significant: points of one course.
    """
    last = max(1, len(significant) - 1)
    edges = torch.diff(torch.nn.functional.pad(significant.long(), (1, 1)))
    starts, stops = (edges == 1).nonzero()[:, 0].tolist(), (edges == -1).nonzero()[:, 0].tolist()
    return [(100.0 * a / last, 100.0 * (b - 1) / last) for a, b in zip(starts, stops, strict=True)]
