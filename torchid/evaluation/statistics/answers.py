"""The answer of one body: its measures compared, and the courses of what was found."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.evaluation.cycle_measures.cycles import Cycle
from torchid.evaluation.cycle_measures.layout import MeasureLayout
from torchid.evaluation.cycle_measures.rows import CycleRows
from torchid.evaluation.evaluation import BodyAnswer
from torchid.evaluation.statistics.comparing import Comparison, Sample, compare, course_p, with_others


def answer(
    config: Config, layout: MeasureLayout, cycles: Sequence[Cycle], conditions: Sequence[str], rows: CycleRows
) -> BodyAnswer:  # fmt: skip
    """What one body says of all conditions.

    Args:
        config: of the evaluation.
        layout: columns and courses.
        cycles: of all trials.
        conditions: condition of every cycle.
        rows: measures and courses of the cycles.
    """
    options, seed = config.evaluate, config.seed
    trials, sides = tuple(c.trial for c in cycles), tuple(c.side for c in cycles)
    sample = Sample(trials, tuple(conditions), layout.columns, rows.values, rows.draws, sides)
    reference = next(name for name, own in config.conditions.items() if own.reference)
    others = [name for name in config.conditions if name != reference]
    each = [compare(sample, reference, name, options, seed) for name in others]
    comparisons = tuple(with_others(one, len(others)) for one in each)
    courses = sided_courses(rows.human, layout, cycles)
    p = tuple(_course_p(config, one, courses, sample, layout) for one in comparisons)
    return BodyAnswer(rows, sample, comparisons, p)


def sided_courses(
    courses: Float[Tensor, "cycles points courses"], layout: MeasureLayout, cycles: Sequence[Cycle]
) -> Float[Tensor, "cycles points courses"]:
    """Courses with NaN where a cycle is of the other side's foot.

    Args:
        courses: of all cycles.
        layout: sides of the courses.
        cycles: with their sides.
    """
    found = courses.clone()
    for k, cycle in enumerate(cycles):
        for j, column in enumerate(layout.courses):
            if cycle.side and column.side and cycle.side != column.side:
                found[k, :, j] = torch.nan
    return found


def _course_p(
    config: Config, comparison: Comparison, courses: Tensor, sample: Sample, layout: MeasureLayout
) -> Float[Tensor, "points courses"]:
    """Adjusted p-values of the courses of which a measure was found; NaN for the others."""
    names = {layout.columns[k].where for k in comparison.found(config.evaluate.level)}
    wanted = [j for j, column in enumerate(layout.courses) if column.where in names]
    own = [k for k, name in enumerate(sample.conditions) if name in (comparison.reference, comparison.condition)]
    found = courses.new_full(courses.shape[1:], torch.nan)
    if wanted:
        found[:, wanted] = course_p(courses[own][:, :, wanted], comparison.units, config.evaluate, config.seed)
    return found
