"""Where and when effects are."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class Interval:
    """Part of a trial [s]."""

    trial: str
    t0: float
    t1: float


BEFORE = " before "


@dataclass(frozen=True)
class Angle:
    """A coordinate of the model; or what it would be if another turn of its joint came next.

    As text ``hip_l_flexion``, or ``hip_l_flexion before hip_l_rotation``.
    """

    dof: str
    before: str | None = None
    """Coordinate of the turn that comes next."""

    def __str__(self) -> str:
        return self.dof if self.before is None else self.dof + BEFORE + self.before


def parse_angle(text: str) -> Angle:
    """The inverse of ``str``."""
    dof, said, before = text.partition(BEFORE)
    return Angle(dof, before if said else None)


@dataclass(frozen=True)
class Place:
    """Where an effect sits."""

    where: tuple[str, ...]
    """Segments, plates (``plate_1``), trials, or ``session``."""
    when: tuple[Interval, ...] | None = None
    """None: throughout."""
    point: tuple[float, float, float] | None = None
    """On the segment, where the effect acts, in its axes [m]; None: its centre of mass."""
    grid: dict[str, float] = field(default_factory=dict)
    """Values of parameters that no column can be linear in, such as a frequency."""
    odds: float = 1.0
    """How likely before any data, against the effect's other places."""
    follows: Angle | None = None
    """What the effect goes with."""
    markers: tuple[str, ...] = ()
    """On the segment, where an effect has parameters for each."""


def covers(place: Place, trial: str) -> bool:
    """Whether a place without segments or plates includes a trial."""
    return "session" in place.where or trial in place.where


EDGE_S = 0.1


def edge(place: Place) -> float:
    """How long what comes and goes takes to come, and to go [s]."""
    return place.grid.get("edge_s", EDGE_S)


def within(
    place: Place, trial: str, time: Float[Tensor, " frames"], edge_s: float | None = None
) -> Float[Tensor, " frames"]:
    """0 outside the place's intervals, 1 inside, risen along half a cosine of ``edge_s`` from their ends."""
    if place.when is None:
        return torch.ones_like(time)
    inside, edge_s = torch.zeros_like(time), edge(place) if edge_s is None else edge_s
    for interval in place.when:
        if interval.trial == trial:
            depth = torch.minimum(time - interval.t0, interval.t1 - time)
            depth = depth / edge_s if edge_s > 0.0 else torch.where(depth >= -1e-9, 1.0, 0.0)
            inside = torch.maximum(inside, 0.5 - 0.5 * torch.cos(torch.pi * depth.clamp(0.0, 1.0)))
    return inside


def inside_any(intervals: Sequence[Interval], trial: str, time: Float[Tensor, " frames"]) -> Bool[Tensor, " frames"]:
    """Whether frames of a trial are in any of the intervals."""
    found = torch.zeros_like(time, dtype=torch.bool)
    for one in intervals:
        if one.trial == trial:
            found |= (time >= one.t0) & (time <= one.t1)
    return found


def mean_within(place: Place) -> float:
    """Mean of ``within`` over the intervals; 1 throughout."""
    if place.when is None:
        return 1.0
    return 1.0 - edge(place) * len(place.when) / sum(own.t1 - own.t0 for own in place.when)
