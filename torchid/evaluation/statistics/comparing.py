"""Two conditions compared over their units: trials, blocks of cycles, or subjects with a difference each.

All measures and all courses over the cycle are one family of hypotheses, so that a report on data without any effect
says something false as rarely as the level allows, whatever it says it of.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.config.conditions import EvaluateOptions
from torchid.evaluation.statistics.arrangements import Arrangements, Tested, counted_as_many, deal, flip, step_down
from torchid.evaluation.statistics.effects import Estimate, difference_of, hedges, hedges_paired, mean_of
from torchid.evaluation.statistics.units import LeastUnits, Units, choose_units, needed_for, unit_means
from torchid.runs import runs


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
    courses: tuple[MeasureColumn, ...] = ()
    curves: Float[Tensor, "cycles points courses"] | None = None
    """Courses over the cycle, NaN where a cycle does not tell."""

    def of(self, names: Sequence[str]) -> "Sample":
        """The cycles of some conditions."""
        kept = [k for k, name in enumerate(self.conditions) if name in names]
        draws = None if self.draws is None else self.draws[:, kept]
        trials, conditions = (tuple(x[k] for k in kept) for x in (self.trials, self.conditions))
        curves = None if self.curves is None else self.curves[kept]
        return replace(
            self, trials=trials, conditions=conditions, values=self.values[kept], draws=draws, sides=(), curves=curves
        )


@dataclass(frozen=True)
class Rule:
    """How comparisons are judged."""

    level: float
    """Family-wise rate of false findings, of all comparisons together."""
    permutations: int
    """At most so many arrangements are tried."""
    seed: int
    """Of random arrangements."""
    comparisons: int = 1
    """Conditions that are compared with the reference: adjusted p-values are multiplied by it (Bonferroni)."""


@dataclass(frozen=True)
class UnitRows:
    """What the units of a comparison have: values, or differences where they are paired; NaN where one has none."""

    columns: tuple[MeasureColumn, ...]
    values: Float[Tensor, "units columns"]
    draws: Float[Tensor, "draws units columns"] | None = None
    """The same with other bodies."""
    courses: tuple[MeasureColumn, ...] = ()
    curves: Float[Tensor, "units points courses"] | None = None


@dataclass(frozen=True)
class Comparison:
    """One condition against the reference."""

    reference: str
    condition: str
    units: Units
    """What was exchanged: trials, blocks or subjects."""
    rows: UnitRows
    least_p: float
    """Smallest p-value that these units can give, before the number of comparisons multiplies it."""
    complete: bool
    """Whether all arrangements were tried."""
    needed: LeastUnits
    """What a finding would need; nothing where one is possible."""
    difference: Estimate
    effect: Estimate
    """Hedges' g; NaN where nothing can be tested: units too few for a test tell no scatter to divide by."""
    tested: Tested

    @property
    def columns(self) -> tuple[MeasureColumn, ...]:
        """Measures that are compared."""
        return self.rows.columns

    @property
    def courses(self) -> tuple[MeasureColumn, ...]:
        """Courses over the cycle that are compared."""
        return self.rows.courses

    @property
    def testable(self) -> bool:
        """Whether some arrangement can be rare enough."""
        return not self.needed.said

    @property
    def agreeing(self) -> list[tuple[int, int]]:
        """Of each column, how many paired units change as their mean does, and how many have a value."""
        same, known = self.rows.values * self.difference.value > 0.0, torch.isfinite(self.rows.values)
        return list(zip(same.sum(0).tolist(), known.sum(0).tolist(), strict=True))

    def found(self, level: float) -> list[int]:
        """Columns whose difference is a finding at a family-wise level.

        Args:
            level: of all measures and courses of all comparisons together.
        """
        return [k for k, p in enumerate(self.tested.adjusted.tolist()) if p <= level]

    def found_courses(self, level: float) -> list[int]:
        """Courses that differ somewhere in the cycle, at the same level.

        Args:
            level: as of ``found``.
        """
        return [k for k, p in enumerate(self.tested.courses.tolist()) if p <= level]

    def ranked(self) -> list[int]:
        """Columns with a difference, the smallest adjusted p first, the largest statistic before others as small."""
        p = [x if math.isfinite(x) else math.inf for x in self.tested.adjusted.tolist()]
        size, known = self.tested.statistic.abs().tolist(), self.difference.value.isfinite().tolist()
        return sorted((k for k, has in enumerate(known) if has), key=lambda k: (p[k], -size[k]))


def compare(
    sample: Sample, reference: str, condition: str, options: EvaluateOptions, seed: int, comparisons: int = 1
) -> Comparison:  # fmt: skip
    """Compare a condition with the reference over trials or blocks of cycles.

    Args:
        sample: cycles of these conditions, and perhaps of others.
        reference: condition whose mean is subtracted.
        condition: the other one.
        options: units, level, number of permutations.
        seed: of random arrangements.
    """
    own = sample.of((reference, condition))
    units = choose_units(own.values, own.trials, [name == condition for name in own.conditions], options.units)
    draws = None if own.draws is None else unit_means(own.draws, units)
    curves = own.curves
    if curves is not None:
        curves = unit_means(curves.flatten(1), units).unflatten(1, curves.shape[1:])
    rows = UnitRows(own.columns, unit_means(own.values, units), draws, own.courses, curves)
    return compare_units(
        (reference, condition), units, rows, Rule(options.level, options.permutations, seed, comparisons)
    )


def compare_units(names: tuple[str, str], units: Units, rows: UnitRows, rule: Rule) -> Comparison:
    """Compare a condition with the reference over units that are given.

    Args:
        units: trials, blocks or subjects.
        rule: level, permutations, and how many comparisons share the level.
    """
    second, paired = units.second, units.paired
    ways = (flip(len(second), rule.permutations, rule.seed) if paired
            else deal(second, rule.permutations, rule.seed))  # fmt: skip
    needed = needed_for(units, ways.least_p, rule.permutations, rule.level / rule.comparisons)
    statistics = ways.statistics(rows.values)
    if needed.said:
        statistics = torch.zeros_like(statistics)
    tested = step_down(statistics, *(_course_statistics(ways, rows, not needed.said)))
    if paired:
        difference, effect = mean_of(rows.values, None), hedges_paired
    else:
        difference, effect = difference_of(rows.values, second, rows.draws), partial(hedges, second=second)
    blank = torch.full_like(difference.value, torch.nan)
    sized = Estimate(blank, blank, blank, blank) if needed.said else effect(rows.values)
    return Comparison(
        *names, units, rows, ways.least_p, ways.complete, needed, difference, sized, _shared(tested, rule.comparisons)
    )


def _course_statistics(
    ways: Arrangements, rows: UnitRows, testable: bool
) -> tuple[Float[Tensor, "arrangements courses"] | None, Float[Tensor, "points courses"] | None]:
    """Statistics of the courses in all arrangements, and of their points as observed."""
    if rows.curves is None:
        return None, None
    _, points, courses = rows.curves.shape
    flat = rows.curves.flatten(1)
    size = ways.statistics(flat).abs()
    largest, freedom = (x.reshape(points, courses).amax(0) for x in ways.scale(flat))
    peaks = counted_as_many(size.reshape(-1, points, courses).amax(1), largest, freedom)
    own = size[0].reshape(points, courses)
    seen = torch.where((own > 0.0) & testable, counted_as_many(own, largest, freedom), torch.nan)
    return torch.where(seen.isfinite().any(0), peaks, torch.nan), seen


def _shared(tested: Tested, comparisons: int) -> Tested:
    """The adjusted p-values times the number of comparisons."""
    adjusted, courses, points = (
        (x * comparisons).clamp(max=1.0) for x in (tested.adjusted, tested.courses, tested.points)
    )
    return replace(tested, adjusted=adjusted, courses=courses, points=points)


def spans(significant: Bool[Tensor, " points"]) -> list[tuple[float, float]]:
    """Runs of points of a course as parts of the cycle, in percent."""
    last = max(1, len(significant) - 1)
    return [(100.0 * a / last, 100.0 * (b - 1) / last) for a, b in runs(significant)]
