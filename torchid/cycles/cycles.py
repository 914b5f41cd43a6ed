"""Cycles of a movement: strides by the feet's contacts, squats and lifts by the rests of a coordinate, or given ones.

A cycle is an interval of frames, both ends included. None is dropped for how it looks: one that stands apart from the
others is named (``outliers``), and what to do about it is the reader's decision.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.config.conditions import CoordinateCycles, EvaluateOptions, EventCycles, GivenCycle
from torchid.contact.contact import Contact
from torchid.recording import Event
from torchid.runs import runs

HELD_S = 0.1
"""Choice. A foot that is in the air, or on the ground, for less than this has not left, or not struck it [s]: the
double support of quick walking takes as long."""
REST = 0.1
"""Choice. A coordinate rests while it is within this part of its range from the end that it starts from."""
RANGE = 0.02, 0.98
"""Choice. Quantiles of a coordinate between which its range is taken, so that a single frame does not make it."""
APART = 3.5
"""Cited. Modified z-score from which on a cycle stands apart (Iglewicz & Hoaglin 1993, How to Detect and Handle
Outliers)."""
MAD_TO_SD = 0.6745
"""Derived. Median absolute deviation of a normal variable of unit standard deviation."""
SIDES = {"l": "l", "r": "r", "left": "l", "right": "r"}
"""Sides as files spell them, in lower case."""


@dataclass(frozen=True)
class Cycle:
    """One cycle of one trial."""

    trial: str
    start: int
    stop: int
    """Last frame, which is the next cycle's first."""
    side: str = ""
    """Foot whose stride it is, l or r; empty: the whole body's."""

    @property
    def frames(self) -> slice:
        """Its frames, both ends included."""
        return slice(self.start, self.stop + 1)


@dataclass(frozen=True)
class Course:
    """What cycles of one trial are found in."""

    trial: str
    time: Float[Tensor, " frames"]
    q: Float[Tensor, "frames dofs"]
    dofs: tuple[str, ...]
    contact: Contact | None = None
    events: tuple[Event, ...] = ()


def find_cycles(course: Course, options: EvaluateOptions) -> tuple[Cycle, ...]:
    """The cycles of one trial in the order of their beginnings.

    Args:
        course: the trial's motion, contacts and events.
        options: how cycles are found and how long they may be.
    """
    wanted = options.cycles
    if isinstance(wanted, EventCycles):
        found = event_cycles(course, wanted.event)
    elif isinstance(wanted, CoordinateCycles):
        found = rest_cycles(course, wanted)
    elif isinstance(wanted, tuple):
        found = given_cycles(course, wanted)
    else:
        found = stances(course) if wanted == "stance" else strides(course)
    step = float(course.time[1] - course.time[0])
    long = [c for c in found if options.shortest_s <= (c.stop - c.start) * step <= options.longest_s]
    return tuple(sorted(long, key=lambda c: (c.start, c.side)))


def strides(course: Course) -> list[Cycle]:
    """Cycles from one strike of a foot to its next."""
    return [
        Cycle(course.trial, a, b, side)
        for side, touching, rate in _feet(course)
        for a, b in pairwise(strikes(touching, rate))
    ]


def stances(course: Course) -> list[Cycle]:
    """Cycles from a strike of a foot to where it leaves the ground, for walkways too short for a stride."""
    return [
        Cycle(course.trial, a, b, side)
        for side, touching, rate in _feet(course)
        for a, b in settled(touching, rate)
        if a > 0 and b < len(course.time)
    ]


def _feet(course: Course) -> Iterator[tuple[str, Bool[Tensor, " frames"], float]]:
    """Side of each foot, when its sole rests on the ground, on plates or beside them, and the frames per second."""
    if course.contact is not None:
        rate = 1.0 / float(course.time[1] - course.time[0])
        for k, foot in enumerate(course.contact.feet):
            yield foot[-1], course.contact.touching[:, k], rate


def strikes(touching: Bool[Tensor, " frames"], rate_hz: float) -> list[int]:
    """Frames in which a foot comes to the ground after it was in the air.

    Args:
        touching: whether it rests on the ground.
    """
    return [start for start, _ in settled(touching, rate_hz) if start > 0]


def settled(touching: Bool[Tensor, " frames"], rate_hz: float) -> list[tuple[int, int]]:
    """First frame of every contact and of the swing behind it, passing over what is too short for either.

    Args:
        touching: whether the foot rests on the ground.
    """
    held = max(1, round(HELD_S * rate_hz))
    down = touching.clone()
    for start, stop in runs(~touching):
        if 0 < start and stop < len(down) and stop - start < held:
            down[start:stop] = True
    return [(start, stop) for start, stop in runs(down) if stop - start >= held]


def event_cycles(course: Course, label: str) -> list[Cycle]:
    """Cycles between successive events of one name and side.

    Args:
        course: its events, in the time of the file.
        label: name of the event, compared without case.
    """
    found = []
    own = [one for one in course.events if one.label.strip().lower() == label.strip().lower()]
    for side in dict.fromkeys(one.side for one in own):
        times = sorted(one.time for one in own if one.side == side)
        at = [int((course.time - t).abs().argmin()) for t in times if _inside(course.time, t)]
        code = SIDES.get(side.strip().lower(), "")
        found += [Cycle(course.trial, a, b, code) for a, b in zip(at, at[1:], strict=False) if b > a]
    return found


def given_cycles(course: Course, given: Iterable[GivenCycle]) -> list[Cycle]:
    """Cycles that a config lists for this trial."""
    found = []
    for one in given:
        if one.trial == course.trial and _inside(course.time, one.t0) and _inside(course.time, one.t1):
            start, stop = (int((course.time - t).abs().argmin()) for t in (one.t0, one.t1))
            found.append(Cycle(course.trial, start, stop, one.side or ""))
    return found


def rest_cycles(course: Course, wanted: CoordinateCycles) -> list[Cycle]:
    """Cycles of a coordinate that leaves its rest, passes half of its range and comes back to rest.

    Args:
        wanted: which coordinate, and whether it leaves to low or to high values.
    """
    if wanted.coordinate not in course.dofs:
        return []
    x = course.q[:, course.dofs.index(wanted.coordinate)]
    x = -x if wanted.turn == "high" else x
    low, high = torch.quantile(x, x.new_tensor(RANGE)).tolist()
    rests = x >= high - REST * (high - low)
    found = []
    for start, stop in runs(~rests):
        if start > 0 and stop < len(x) and bool((x[start:stop] < 0.5 * (low + high)).any()):
            found.append(Cycle(course.trial, start - 1, stop))
    return found


def _inside(time: Tensor, t: float) -> bool:
    half = 0.5 * float(time[1] - time[0])
    return bool(time[0] - half <= t <= time[-1] + half)


def normalise(
    values: Float[Tensor, "*batch frames columns"], cycle: Cycle, points: int
) -> Float[Tensor, "*batch points columns"]:
    """Courses over one cycle at equal parts of its duration, linear between frames.

    Args:
        values: courses over the whole trial.
        points: how many, both ends included.
    """
    place = torch.linspace(cycle.start, cycle.stop, points, dtype=values.dtype, device=values.device)
    before = place.floor().long().clamp(max=cycle.stop)
    after = (before + 1).clamp(max=cycle.stop)
    part = (place - before)[:, None]
    found = (1.0 - part) * values[..., before, :] + part * values[..., after, :]
    return torch.where(part > 0.0, found, values[..., before, :])


def outliers(curves: Float[Tensor, "cycles points columns"]) -> Float[Tensor, " cycles"]:
    """Modified z-scores of the cycles' distances from the median cycle; more than ``APART`` stands apart.

    Each column counts by its own spread; points that are not known in a cycle do not count.

    Args:
        curves: normalised courses of cycles of one kind.

    Returns:
        Scores, zero where there are fewer than three cycles or all are alike.
    """
    if len(curves) < 3:
        return curves.new_zeros(len(curves))
    middle = curves.nanmedian(dim=0).values
    scale = (curves - middle).abs().flatten(0, 1).nanmedian(dim=0).values.clamp(min=1e-12)
    away = ((curves - middle) / scale).square().flatten(1)
    distance = away.nanmean(dim=1).nan_to_num(0.0).sqrt()
    spread = (distance - distance.median()).abs().median()
    return MAD_TO_SD * (distance - distance.median()) / spread if float(spread) > 0.0 else torch.zeros_like(distance)
