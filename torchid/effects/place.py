"""Places of effects: segments, plates, markers or trials, and intervals of time."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class Interval:
    """Part of a trial [s]."""

    trial: str
    """Name of the trial."""
    t0: float
    """The first moment in the trial's time [s]."""
    t1: float
    """The last moment [s]."""


BEFORE = " before "
"""Word between the two coordinates of an angle as text."""


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
    """The angle that ``str`` made a text of."""
    dof, said, before = text.partition(BEFORE)
    return Angle(dof, before if said else None)


@dataclass(frozen=True)
class Place:
    """A place of an effect, with all that its parameters depend on."""

    where: tuple[str, ...]
    """Segments, plates (``plate_1``), trials, or ``session``."""
    when: tuple[Interval, ...] | None = None
    """Intervals in which the effect is there; None: throughout."""
    point: tuple[float, float, float] | None = None
    """Point of the segment on which the effect acts, in its axes [m]; None: the centre of mass."""
    grid: dict[str, float] = field(default_factory=dict)
    """Values of parameters that no column can be linear in, such as a frequency."""
    odds: float = 1.0
    """Odds before any data, against the effect's other places."""
    follows: Angle | None = None
    """The angle that the effect goes with."""
    markers: tuple[str, ...] = ()
    """Markers of the segment, if the effect has parameters for each."""


SESSION = Place(("session",))
"""All trials of a session, throughout."""


def covers(place: Place, trial: str) -> bool:
    """Return whether a place without segments or plates includes a trial."""
    return "session" in place.where or trial in place.where


EDGE_S = 0.1
"""Estimator. Time in which an effect comes, or goes, unless its place says otherwise [s]."""


def edge(place: Place) -> float:
    """Return the time in which the effect comes, or goes [s]."""
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
    """Return whether frames of a trial are in any of the intervals."""
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
