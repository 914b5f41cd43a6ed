"""Whether a condition helps: which loads on the person are lower, and which are higher."""

from dataclasses import dataclass

from torchid.evaluation.statistics.comparing import Comparison

LOADS = {
    "peak_torque_Nm": 1.0, "cumulative_load_Nms": 1.0, "positive_work_J": 1.0, "negative_work_J": -1.0,
    "peak_power_W": 1.0, "peak_moment_Nm": 1.0, "cumulative_moment_Nms": 1.0, "peak_compression_N": 1.0,
}  # fmt: skip
"""Measures of which less is less load on the person, with the sign by which more load is larger."""


@dataclass(frozen=True)
class LoadChange:
    """Loads of a comparison, as numbers of its columns."""

    tested: tuple[int, ...]
    lower: tuple[int, ...]
    """Findings in which the condition asks for less than the reference."""
    higher: tuple[int, ...]


def load_change(one: Comparison, level: float) -> LoadChange:
    """Loads that a comparison has tested, and those that differ.

    Args:
        one: the comparison.
        level: family-wise.
    """
    adjusted, value = one.tested.adjusted.tolist(), one.difference.value.tolist()
    tested = [k for k, column in enumerate(one.columns) if column.measure in LOADS and adjusted[k] == adjusted[k]]
    found = [k for k in one.ranked() if k in tested and adjusted[k] <= level]
    less = [k for k in found if value[k] * LOADS[one.columns[k].measure] < 0.0]
    return LoadChange(tuple(tested), tuple(less), tuple(k for k in found if k not in less))
