"""Values of a stride: time, length, speed, share of stance and width of the step; of other cycles: duration and depth.

A stride lasts from a strike of one foot to its next. Its length is the way of that foot's heel over the ground, the
belt's own way added on a treadmill; its step width the distance of the other heel, at its own strike within the stride,
from the line of progression.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.evaluation.cycle_measures.cycles import Cycle, strikes

STRIDE = ("stride_time_s", "stride_length_m", "speed_m_s", "stance_share", "step_width_m")
STANCE = ("stance_time_s", "speed_m_s")
"""Of cycles that end when the foot leaves the ground; the speed is that of the root over the ground."""
WHOLE = ("duration_s", "depth_m")
"""Of cycles that are no strides; depth is the range of the root's height."""


def stride_values(
    cycle: Cycle,
    contact: Contact,
    heels: dict[str, Float[Tensor, "frames 3"]],
    step_s: float,
) -> Float[Tensor, "5"]:
    """The values of ``STRIDE``; NaN where the other foot shows none.

    Args:
        contact: when feet touch the ground, and how the ground moves.
        heels: places of the heels in W by foot [m].
        step_s: time between frames [s].
    """
    own = next(k for k, foot in enumerate(contact.feet) if foot.endswith(f"_{cycle.side}"))
    other = next((k for k in range(len(contact.feet)) if k != own), None)
    seconds = (cycle.stop - cycle.start) * step_s
    heel = heels[contact.feet[own]]
    way = heel[cycle.stop, :2] - heel[cycle.start, :2] - seconds * contact.belt[own]
    length = float(way.norm())
    stance = float(contact.touching[cycle.start : cycle.stop, own].double().mean())
    width = torch.nan if other is None else _width(cycle, contact.touching[:, other], heel, heels[contact.feet[other]],
                                                   way, step_s)  # fmt: skip
    return heel.new_tensor([seconds, length, length / seconds, stance, width])


def stance_values(
    cycle: Cycle, contact: Contact, root: Float[Tensor, "frames 3"], step_s: float
) -> Float[Tensor, "2"]:  # fmt: skip
    """The values of ``STANCE``.

    Args:
        cycle: of a foot.
        contact: how the ground moves.
        root: place of the root's origin in W [m].
        step_s: time between frames [s].
    """
    own = next(k for k, foot in enumerate(contact.feet) if foot.endswith(f"_{cycle.side}"))
    seconds = (cycle.stop - cycle.start) * step_s
    way = root[cycle.stop, :2] - root[cycle.start, :2] - seconds * contact.belt[own]
    return root.new_tensor([seconds, float(way.norm()) / seconds])


def _width(
    cycle: Cycle, touching: Bool[Tensor, " frames"], own: Tensor, other: Tensor, way: Tensor, step_s: float
) -> float:
    """Distance of the other foot's strike from the line through both strikes of this one, across the way [m]."""
    between = [k for k in strikes(touching, 1.0 / step_s) if cycle.start < k < cycle.stop]
    length = float(way.norm())
    if not between or length < 1e-6:
        return float("nan")
    at = other[between[0], :2] - own[cycle.start, :2]
    return abs(float(way[0] * at[1] - way[1] * at[0])) / length


def whole_values(cycle: Cycle, height: Float[Tensor, " frames"], step_s: float) -> Float[Tensor, "2"]:
    """The values of ``WHOLE``.

    Args:
        height: of the root's origin [m].
        step_s: time between frames [s].
    """
    own = height[cycle.frames]
    return height.new_tensor([(cycle.stop - cycle.start) * step_s, float(own.max() - own.min())])
