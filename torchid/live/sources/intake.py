"""Frames and samples on one uniform clock, however they come."""

import logging
from collections import deque
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.live.estimation.watch import Notice
from torchid.live.sources.stream import Packet
from torchid.recording import Markers

JUMP_S = 2.0
"""Choice. Times that lie further than this from the newest ones are those of a clock that was set, not of late or lost
frames: no network holds a frame back that long."""


@dataclass(frozen=True)
class PlacedPacket:
    """What was new in a packet, on the uniform clock of a session."""

    index: Int[Tensor, " frames"]
    """Number of every frame since the session began; those of frames that never come are left out."""
    markers: Markers
    """The frames, rising; times are those of the uniform clock."""
    sample: Int[Tensor, " samples"]
    """Number of every force sample on the uniform clock of the forces, whose sample zero is at time zero."""
    wrench: Float[Tensor, "samples plates 6"]


@dataclass(frozen=True)
class Counts:
    """How a stream has behaved so far."""

    frames: int = 0
    """Frames that were taken."""
    lost: int = 0
    """Frames between the first and the newest that have not come."""
    again: int = 0
    """Frames that had come before."""
    late: int = 0
    """Frames that came when their block was done."""
    restarts: int = 0
    """Times that the clock was set."""
    apart: int = 0
    """Force samples whose times are far from those of all frames."""


class Intake:
    """Puts frames and samples in their places by their times, once each.

    A frame's place is its time on the uniform clock of the nominal rate. One that had come before is dropped, and so is
    one that comes more than ``patience_s`` after its successors. Where the clock is set, frames go on behind the newest
    one, a pause of ``patience_s`` later, so that nothing is smoothed across.
    """

    def __init__(self, rate_hz: float, force_rate_hz: float, patience_s: float) -> None:
        """Wait for the first frame.

        Args:
            rate_hz: nominal frames per second.
            force_rate_hz: nominal samples per second, zero without plates.
            patience_s: how long a frame is waited for.
        """
        self._rate, self._force_rate = rate_hz, force_rate_hz
        self._patience = max(1, round(patience_s * rate_hz))
        self._origin: float | None = None
        self._phase: float | None = None
        self._newest, self._first, self._known = -1, 0, set[int]()
        self.counts = Counts()

    def place(self, packet: Packet) -> PlacedPacket:
        """Place what is new in a packet."""
        index, keep = self._frames(packet.markers.time)
        order = keep.nonzero()[:, 0][index[keep].argsort()]
        markers = Markers(packet.markers.labels, index[order] / self._rate, packet.markers.position[order])
        sample, wrench = self._samples(packet)
        return PlacedPacket(index[order], markers, sample, wrench)

    def _frames(self, time: Float[Tensor, " frames"]) -> tuple[Int[Tensor, " frames"], Bool[Tensor, " frames"]]:
        """Places of the frames of a packet in the order of their coming, and which of them are new."""
        index, keep = torch.zeros(len(time), dtype=torch.long), torch.zeros(len(time), dtype=torch.bool)
        again = late = restarts = 0
        for k, t in enumerate(time.tolist()):
            if t != t:
                continue
            if self._origin is None:
                self._origin = t
            at = round((t - self._origin) * self._rate)
            if self._newest >= 0 and abs(at - self._newest) > JUMP_S * self._rate:
                restarts, at = restarts + 1, self._newest + 1 + self._patience
                self._origin, self._phase = t - at / self._rate, None
            if at in self._known:
                again += 1
            elif at <= self._newest - self._patience or at < 0:
                late += 1
            else:
                index[k], keep[k] = at, True
                self._known.add(at)
                self._newest = max(self._newest, at)
        self._known = {at for at in self._known if at > self._newest - 2 * self._patience}
        self._count(int(keep.sum()), again, late, restarts)
        return index, keep

    def _count(self, taken: int, again: int, late: int, restarts: int) -> None:
        before = self.counts
        frames, set_ = before.frames + taken, before.restarts + restarts
        lost = self._newest + 1 - set_ * self._patience - frames
        self.counts = Counts(frames, max(lost, 0), before.again + again, before.late + late, set_, before.apart)

    def _samples(self, packet: Packet) -> tuple[Int[Tensor, " samples"], Float[Tensor, "samples plates 6"]]:
        """Places of the samples near the newest frame; others belong to a clock that no frame has shown yet."""
        forces = packet.forces
        if forces is None or self._origin is None or not len(forces.time):
            none = torch.zeros(0, dtype=torch.long)
            return none, torch.zeros(0, 0 if forces is None else len(forces.plates), 6, dtype=torch.float64)
        since = forces.time - self._origin
        near = (since - self._newest / self._rate).abs() <= JUMP_S
        self.counts = replace(self.counts, apart=self.counts.apart + int((~near).sum()))
        if self._phase is None and bool(near.any()):
            first = float(since[near][0]) * self._force_rate
            self._phase = first - round(first)
        # Plates between two places of the markers' clock would fall into either by their jitter, and leave the other.
        place = since[near] * self._force_rate - (self._phase or 0.0)
        return place.round().long(), forces.wrench[near].to(torch.float64)


WINDOW_S = 2.0
"""Choice. What came in so long is looked at together: longer than any time at which frames are late by themselves."""
DROPPED = 0.1
"""Choice. Part of what comes from which on its being dropped is said: networks double and delay single frames."""

log = logging.getLogger(__name__)


class Stamps:
    """Looks at how the newest frames and samples could be placed by their times."""

    def __init__(self, rate_hz: float, force_rate_hz: float) -> None:
        """Begin with nothing.

        Args:
            rate_hz: nominal frames per second.
            force_rate_hz: nominal samples per second, zero without plates.
        """
        self._frames, self._samples = WINDOW_S * rate_hz, WINDOW_S * force_rate_hz
        self._past = deque([Counts()])
        self._said = set[str]()
        self.noted: dict[tuple[str, str], tuple[float, float]] = {}
        """First and last time of the stream at which each notice held [s], by what and where."""

    def after(self, counts: Counts, time_s: float) -> tuple[Notice, ...]:
        """Return what is wrong now; what has not been said before goes to the log as well.

        Args:
            counts: of all that came so far.
        """
        self._past.append(counts)
        while len(self._past) > 2 and _came(counts) - _came(self._past[1]) >= self._frames:
            self._past.popleft()
        found = tuple(self._found(self._past[0], counts))
        for one in found:
            since, _ = self.noted.get((one.what, one.where), (time_s, time_s))
            self.noted[one.what, one.where] = (since, time_s)
            if one.where not in self._said:
                log.warning("%s", one.text)
            self._said.add(one.where)
        return found

    def _found(self, before: Counts, now: Counts) -> list[Notice]:
        came, found = _came(now) - _came(before), []
        dropped = now.again + now.late - before.again - before.late
        if dropped > DROPPED * self._frames:
            text = f"{dropped} of the newest {came} frames carry times of earlier ones and are dropped"
            found.append(Notice("stamps", "frames", f"{text}: look at the clock of their sender"))
        if now.restarts > before.restarts:
            text = "The clock of the frames was set: they go on behind the newest one"
            found.append(Notice("stamps", "clock", text))
        apart = now.apart - before.apart
        if apart > DROPPED * self._samples > 0.0:
            text = f"{apart} samples of the plates carry times that no frame has, and are dropped"
            found.append(Notice("stamps", "plates", f"{text}: let both senders go by one clock"))
        return found


def _came(counts: Counts) -> int:
    return counts.frames + counts.again + counts.late
