"""Measures and coordinates in plain words."""

from collections.abc import Sequence

from torchid.cycles.conventions import SIDED
from torchid.evaluation.numbers import column_unit
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.wording import clean

MEASURES = {
    "peak_torque_Nm": "peak torque", "max_torque_Nm": "maximum torque (signed)",
    "min_torque_Nm": "minimum torque (signed)", "mean_torque_Nm": "mean torque",
    "positive_work_J": "work done (positive)", "negative_work_J": "work taken up (negative)",
    "peak_power_W": "peak power", "cumulative_load_Nms": "cumulative load", "range_deg": "range of motion",
    "peak_moment_Nm": "peak extension moment", "cumulative_moment_Nms": "cumulative extension moment",
    "peak_compression_N": "peak compression", "stride_time_s": "stride time", "stride_length_m": "stride length",
    "speed_m_s": "speed", "stance_share": "share of stance", "step_width_m": "step width",
    "stance_time_s": "stance time", "duration_s": "duration", "depth_m": "depth of the pelvis' movement",
}  # fmt: skip
DECIMALS = {
    "stride_time_s": 3, "stride_length_m": 3, "speed_m_s": 3, "stance_share": 3, "step_width_m": 3,
    "stance_time_s": 3, "duration_s": 2, "depth_m": 3, "peak_compression_N": 0,
}  # fmt: skip
WHOLE_BODY = "cycle"
_SIDES = {"l": "left", "r": "right"}


def where_words(where: str) -> str:
    """A coordinate's name in words: ``hip_l_flexion`` is ``left hip flexion``; other names stay as they are."""
    if where in ("L5/S1", WHOLE_BODY):
        return where
    parts = where.split("_")
    own = next((part for part in parts if part in SIDED), "")
    rest = " ".join(part for part in parts if part != own)
    return clean(f"{_SIDES[own]} {rest}" if own else rest)


def measure_words(measure: str) -> str:
    """A measure's name in words."""
    return MEASURES.get(measure, measure.replace("_", " "))


def column_words(column: MeasureColumn) -> str:
    """``peak torque, left hip flexion``."""
    if column.where == WHOLE_BODY:
        return measure_words(column.measure)
    return f"{measure_words(column.measure)}, {where_words(column.where)}"


def labelled(column: MeasureColumn, per_mass: bool) -> str:
    """``peak torque, left hip flexion [N m]``."""
    own = column_unit(column, per_mass)
    return f"{column_words(column)}{f' [{own}]' if own else ''}"


def headed(head: Sequence[str], usual: str) -> tuple[str, ...]:
    """Head of a table whose column ``Template`` is of what the identified body is held against.

    Args:
        usual: as of ``Evaluation.usual``.
    """
    return tuple("Shipped" if one == "Template" and "template" not in usual else one for one in head)


def digits_of(measure: str, per_mass: bool) -> int:
    """Decimals with which a measure is shown."""
    return DECIMALS.get(measure, 3 if per_mass and measure != "range_deg" else 1)
