"""Records of what is wrong with the track of a marker, and what is said of it."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.checks.finding import Finding, InstrumentFault, Severity
from torchid.errors import Note
from torchid.wording import listing

LISTED = 4
"""Resolution. Intervals that a sentence lists at most."""


class TrackFault(StrEnum):
    """Ways in which the track of a marker can be wrong."""

    JUMP = "jump"
    """Once in the trial the marker is away from its place on the segment, between two frames."""
    FLIP = "flip"
    """It is so several times."""
    FROZEN = "frozen"
    """It stands still while the markers beside it move."""
    EXCHANGED = "exchanged"
    """Two labels carry each other's marker, or one label the other's marker while that is not seen."""
    MOVED = "moved"
    """It sits at another place than in other trials."""


@dataclass(frozen=True)
class TrackStatement:
    """One thing that is wrong with a trial's markers."""

    kind: TrackFault
    """What it is."""
    trial: str
    """Name of the trial."""
    labels: tuple[str, ...]
    """The marker; both that are exchanged; all of which one moved, where nothing tells which."""
    when: tuple[tuple[float, float], ...]
    """First and last time of each interval [s]; empty where it lasts throughout the trial."""
    size_mm: float
    """How far the marker is from its place; of exchanged ones the mean misfit of distances, or step of paths [mm]."""
    sd_mm: float
    """Standard deviation of that where nothing is wrong [mm]."""
    left_mm: float = 0.0
    """The same with the names exchanged, or misfit of distances without the marker that moved [mm]."""
    share: float = 1.0
    """Share of the trial's frames concerned, of those that could be judged."""
    against: tuple[str, ...] = ()
    """Trials that it was compared with; empty: with the rest of its own."""

    def inside(self, time: Float[Tensor, " frames"]) -> Bool[Tensor, " frames"]:
        """Return the mask of frames concerned.

        Args:
            time: of each frame [s].
        """
        if not self.when:
            return torch.ones_like(time, dtype=torch.bool)
        half = 0.5 * float(time.diff().median()) if len(time) > 1 else 0.0
        return torch.stack([(time > t0 - half) & (time < t1 + half) for t0, t1 in self.when]).any(0)

    @property
    def sentence(self) -> str:
        """What is said of it."""
        names, when = " and ".join(self.labels), self._when()
        if self.kind is TrackFault.EXCHANGED:
            return (
                f"{names} carry each other's name {when}: they are off by {self.size_mm:.0f} mm on average as "
                f"labelled, by {self.left_mm:.0f} mm the other way round"
            )
        if self.kind is TrackFault.FROZEN:
            return f"{names} stands still {when} while the markers beside it go {self.size_mm:.0f} mm"
        if self.kind is TrackFault.MOVED:
            compared = listing(self.against)
            if len(self.labels) > 1:
                return (
                    f"one of {listing(self.labels)} sits elsewhere than in {compared}, by {self.size_mm:.0f} mm "
                    f"(sd {self.sd_mm:.0f} mm) if it is {self.labels[0]}, and nothing tells which"
                )
            return (
                f"{names} sits elsewhere than in {compared}, by {self.size_mm:.0f} mm (sd {self.sd_mm:.0f} mm); "
                f"without it, distances on the segment agree within {math.ceil(max(self.left_mm, 1.0))} mm"
            )
        how = "leaps to another place" if self.kind is TrackFault.JUMP else "leaps between two places"
        return f"{names} {how} on its segment, {self.size_mm:.0f} mm off, {when}"

    def _when(self) -> str:
        """Return the times in words."""
        if not self.when:
            return "throughout"
        spans = [(f"{t0:.2f}", f"{t1:.2f}") for t0, t1 in self.when[:LISTED]]
        listed = ", ".join(f"{t0} s" if t0 == t1 else f"{t0}-{t1} s" for t0, t1 in spans)
        more = len(self.when) - LISTED
        return f"at {listed}" + (f" and {more} times more" if more > 0 else "")


TAKEN_OUT = (TrackFault.JUMP, TrackFault.FLIP, TrackFault.FROZEN, TrackFault.EXCHANGED)
"""Kinds whose samples say nothing of where the segment is."""


FAULTS = {
    TrackFault.JUMP: InstrumentFault.JUMP,
    TrackFault.FLIP: InstrumentFault.JUMP,
    TrackFault.FROZEN: InstrumentFault.FROZEN,
    TrackFault.EXCHANGED: InstrumentFault.EXCHANGE,
    TrackFault.MOVED: InstrumentFault.MOVED,
}
"""The faults of instruments that these are."""


def track_finding(one: TrackStatement) -> Finding:
    """Return the statement as one of an instrument, with what is done about it.

    Args:
        one: the statement.
    """
    done = "left as it is" if one.kind is TrackFault.MOVED else "taken as missing there"
    if one.kind is TrackFault.EXCHANGED:
        done = "both taken as missing there; the diagnosis may give them back their names"
    return Finding(
        FAULTS[one.kind], f"tracking.{one.kind}", f"{one.sentence}; {done}", one.trial, one.labels, one.size_mm,
        one.sd_mm, "mm", severity=Severity.WARNING,
    )  # fmt: skip


def notes_of(statements: Iterable[TrackStatement]) -> tuple[Note, ...]:
    """Return the statements as notes, with what is done about each.

    Args:
        statements: of any trials.
    """
    return tuple(track_finding(one).note for one in statements)
