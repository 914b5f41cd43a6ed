"""Measures of one coordinate in one cycle: torque, power, work, load and range, from courses at frame rate.

With torque tau [N m] on a coordinate of rate v [rad/s], power P = tau v, and integrals by the trapezoidal rule:
work done W+ = int max(P, 0) dt and W- = int min(P, 0) dt, cumulative load L = int |tau| dt. A measure of a torque that
is not known in some frame of the cycle is NaN: what is missing may have been the peak.

A stride lasts from a strike of one foot to its next. Its length is the way of that foot's heel over the ground, the
belt's own way added on a treadmill; its step width the distance of the other heel, at its own strike within the stride,
from the line of progression.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.cycles.cycles import Cycle, strikes


@dataclass(frozen=True)
class CycleCourses:
    """What a measure may use of one cycle; the torque may have draws in front."""

    tau: Float[Tensor, "*draws frames columns"]
    """Torque of the human share [N m]."""
    v: Float[Tensor, "frames columns"]
    """Rate [rad/s]."""
    q: Float[Tensor, "frames columns"]
    """Coordinate [rad]."""
    weight: Float[Tensor, " frames"]
    """Of the trapezoidal rule [s]."""


Measure = Callable[[CycleCourses], Float[Tensor, "*draws columns"]]


def trapezoid(frames: int, step_s: float, like: Tensor) -> Float[Tensor, " frames"]:
    """Weights of the trapezoidal rule.

    Args:
        frames: of the cycle, both ends included.
        step_s: time between frames [s].
    """
    weight = like.new_full((frames,), step_s)
    weight[0] = weight[-1] = 0.5 * step_s
    return weight


def _integral(values: Tensor, weight: Tensor) -> Tensor:
    return (values * weight[:, None]).sum(-2)


def _range(c: CycleCourses) -> Tensor:
    span = math.degrees(1.0) * (c.q.amax(-2) - c.q.amin(-2))
    return span.expand(*c.tau.shape[:-2], len(span))


MEASURES: Mapping[str, Measure] = {
    "peak_torque_Nm": lambda c: c.tau.abs().amax(-2),
    "max_torque_Nm": lambda c: c.tau.amax(-2),
    "min_torque_Nm": lambda c: c.tau.amin(-2),
    "mean_torque_Nm": lambda c: _integral(c.tau, c.weight) / c.weight.sum(),
    "positive_work_J": lambda c: _integral((c.tau * c.v).clamp(min=0.0), c.weight),
    "negative_work_J": lambda c: _integral((c.tau * c.v).clamp(max=0.0), c.weight),
    "peak_power_W": lambda c: (c.tau * c.v).amax(-2),
    "cumulative_load_Nms": lambda c: _integral(c.tau.abs(), c.weight),
    "range_deg": _range,
}
"""By the names of ``config.conditions.MEASURES``; the unit ends the name."""
UNITS = {"Nm": "N m", "J": "J", "W": "W", "Nms": "N m s", "deg": "°", "s": "s", "m": "m", "m_s": "m/s", "N": "N"}
"""Units by the ends of names."""
PER_MASS = ("Nm", "J", "W", "Nms")
"""Ends of names of what is divided by the mass on demand."""


def measure(
    names: tuple[str, ...],
    cycle: Cycle,
    tau: Float[Tensor, "*draws frames columns"],
    v: Float[Tensor, "frames columns"],
    q: Float[Tensor, "frames columns"],
    step_s: float,
) -> Float[Tensor, "*draws columns measures"]:
    """Measures of one cycle.

    Args:
        names: of ``MEASURES``.
        tau: torques over the whole trial [N m], NaN where not known.
        v: rates [rad/s].
        q: coordinates [rad].
        step_s: time between frames [s].

    Returns:
        Measures in their units; NaN where a torque is not known throughout, ranges excepted.
    """
    part = cycle.frames
    weight = trapezoid(cycle.stop - cycle.start + 1, step_s, q)
    courses = CycleCourses(tau[..., part, :], v[part], q[part], weight)
    return torch.stack([MEASURES[name](courses) for name in names], dim=-1)


def unit_of(name: str) -> str:
    """Unit of a measure by the end of its name, such as ``N m`` of ``peak_torque_Nm``."""
    ends = [end for end in UNITS if name.endswith(f"_{end}")]
    return UNITS[max(ends, key=len)] if ends else ""


def divides_by_mass(name: str) -> bool:
    """Whether a measure is one that is given per body mass on demand."""
    return any(name.endswith(f"_{end}") for end in PER_MASS)


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
    own = next(k for k, foot in enumerate(contact.feet) if foot[-1] == cycle.side)
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
    own = next(k for k, foot in enumerate(contact.feet) if foot[-1] == cycle.side)
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
