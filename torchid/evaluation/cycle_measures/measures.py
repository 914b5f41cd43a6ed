"""Measures of one coordinate in one cycle: torque, power, work, load and range, from courses at frame rate.

With torque tau [N m] on a coordinate of rate v [rad/s], power P = tau v, and integrals by the trapezoidal rule:
work done W+ = int max(P, 0) dt and W- = int min(P, 0) dt, cumulative load L = int |tau| dt. A measure of a torque that
is not known in some frame of the cycle is NaN: what is missing may have been the peak.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.cycle_measures.cycles import Cycle


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
