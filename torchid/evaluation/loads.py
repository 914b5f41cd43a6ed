"""What loads of the person a condition changes, and where a device gives more than a joint needs."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.statistics.effects import Estimate

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
        level: family-wise.
    """
    adjusted, value = one.tested.adjusted.tolist(), one.difference.value.tolist()
    tested = [k for k, column in enumerate(one.columns) if column.measure in LOADS and adjusted[k] == adjusted[k]]
    found = [k for k in one.ranked() if k in tested and adjusted[k] <= level]
    less = [k for k in found if value[k] * LOADS[one.columns[k].measure] < 0.0]
    return LoadChange(tuple(tested), tuple(less), tuple(k for k in found if k not in less))


LEAST_PART = 0.1
"""Choice. Part of the cycle from which on that is said: where a demanded torque passes through zero, every device gives
too much for a moment."""


def beyond_need(
    human: Estimate, demand: Float[Tensor, " columns"], device: Float[Tensor, " columns"], points: int
) -> tuple[Float[Tensor, " courses"], Float[Tensor, " courses"]]:
    """Part of the cycle in which the device gives more than is demanded, and the largest torque that is held back.

    A point counts where demand and device have one sign, the device is the larger, and the human's band excludes zero.

    Args:
        human: mean courses with their band, flattened points times courses.
        demand: mean courses of human and device together.
        device: mean courses of the device.
    """
    over = (demand * device > 0.0) & (device.abs() > demand.abs()) & (human.low * human.high > 0.0)
    back = human.value.abs().where(over, human.value.new_zeros(()))
    return over.reshape(points, -1).to(demand.dtype).mean(0), back.reshape(points, -1).amax(0)
