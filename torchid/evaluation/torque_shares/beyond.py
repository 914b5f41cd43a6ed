"""Where a device gives more than a joint needs, so that the person works against it."""

from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.statistics.effects import Estimate

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
        points: of a cycle.
    """
    over = (demand * device > 0.0) & (device.abs() > demand.abs()) & (human.low * human.high > 0.0)
    back = human.value.abs().where(over, human.value.new_zeros(()))
    return over.reshape(points, -1).to(demand.dtype).mean(0), back.reshape(points, -1).amax(0)
