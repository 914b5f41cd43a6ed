"""The answer of one body: its measures and its courses over the cycle compared."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.cycles.cycles import Cycle
from torchid.evaluation.cycle_measures.layout import MeasureLayout
from torchid.evaluation.cycle_measures.rows import CycleRows
from torchid.evaluation.statistics.comparing import Comparison, Sample, compare
from torchid.evaluation.statistics.effects import Estimate, mean_of
from torchid.evaluation.statistics.units import trial_units, unit_means


@dataclass(frozen=True)
class BodyAnswer:
    """What one body says: the identified one, or the scaled template with tabulated inertia."""

    rows: CycleRows
    sample: Sample
    comparisons: tuple[Comparison, ...]
    """Of every condition with the reference."""

    def cycles_of(self, condition: str) -> list[int]:
        """Numbers of the cycles of a condition."""
        return [k for k, name in enumerate(self.sample.conditions) if name == condition]

    def mean(
        self,
        condition: str,
        values: Float[Tensor, "cycles columns"],
        draws: Float[Tensor, "draws cycles columns"] | None,
    ) -> Estimate:
        """Mean over the trials of a condition; over its cycles where there is one trial.

        Args:
            values: of all cycles, such as the sample's.
            draws: the same with other bodies.
        """
        own = self.cycles_of(condition)
        units = trial_units([self.sample.trials[k] for k in own])
        values, drawn = values[own], None if draws is None else draws[:, own]
        if len(units.second) > 1:
            values, drawn = unit_means(values, units), None if drawn is None else unit_means(drawn, units)
        return mean_of(values, drawn)


def answer(
    config: Config, layout: MeasureLayout, cycles: Sequence[Cycle], conditions: Sequence[str], rows: CycleRows
) -> BodyAnswer:  # fmt: skip
    """What one body says of all conditions.

    Args:
        conditions: condition of every cycle.
    """
    trials, sides = tuple(c.trial for c in cycles), tuple(c.side for c in cycles)
    curves = sided_courses(rows.human, layout, cycles)
    sample = Sample(
        trials, tuple(conditions), layout.columns, rows.values, rows.draws, sides, layout.courses, curves
    )  # fmt: skip
    reference = next(name for name, own in config.conditions.items() if own.reference)
    others = [name for name in config.conditions if name != reference]
    each = (compare(sample, reference, name, config.evaluate, config.seed, len(others)) for name in others)
    return BodyAnswer(rows, sample, tuple(each))


def sided_courses(
    courses: Float[Tensor, "cycles points courses"], layout: MeasureLayout, cycles: Sequence[Cycle]
) -> Float[Tensor, "cycles points courses"]:
    """Courses with NaN where a cycle is of the other side's foot."""
    found = courses.clone()
    for k, cycle in enumerate(cycles):
        for j, column in enumerate(layout.courses):
            if cycle.side and column.side and cycle.side != column.side:
                found[k, :, j] = torch.nan
    return found
