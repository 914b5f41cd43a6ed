"""What a source of live measurements is, and what it hands over."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torchid.recording import Forces, Markers, Plate, Trial


@dataclass(frozen=True)
class Packet:
    """Frames and samples that arrived since a source was last asked: in any order, some twice, some never."""

    markers: Markers
    """Frames of markers, by the clock of the source."""
    forces: Forces | None
    """Samples of the plates, by the same clock."""
    arrived_s: float
    """When the newest frame was there to be taken, by the monotonic clock of this machine [s]."""


@runtime_checkable
class Source(Protocol):
    """Where frames come from."""

    labels: tuple[str, ...]
    """Names of the markers, in the order of every packet."""
    rate_hz: float
    """Nominal frames per second."""
    plates: tuple[Plate, ...]
    """Force plates, in the order of every packet."""
    force_rate_hz: float
    """Nominal samples per second, zero without plates."""

    def take(self) -> Packet | None:
        """Return what arrived since the last call, perhaps nothing; None where nothing will come any more."""


AT_ONCE = 16
"""Choice. Frames of a packet where no clock says how many have come: a batch of this size takes a seventh of the time
per frame that a single one does, and in a sixth of a second at 100 Hz no posture moves far."""


class Replay:
    """The frames and samples of a trial, as a laboratory would have sent them."""

    def __init__(self, trial: Trial, speed: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin with the first frame when first asked.

        Args:
            trial: with its forces on their own clock.
            speed: multiple of the recording's own pace; infinite: each packet has ``AT_ONCE`` frames.
            clock: monotonic time [s].
        """
        self.labels, self.rate_hz = trial.markers.labels, trial.markers.rate
        forces = trial.forces
        self.plates = () if forces is None else forces.plates
        self.force_rate_hz = 0.0 if forces is None else forces.rate
        self._trial, self._speed, self._clock = trial, speed, clock
        self._begun: float | None = None
        self._frame, self._sample = 0, 0

    def take(self) -> Packet | None:
        """Return the frames that are due, and all samples up to the newest of them; None after the last."""
        markers, forces = self._trial.markers, self._trial.forces
        if self._frame == len(markers.time):
            return None
        now = self._clock()
        self._begun = now if self._begun is None else self._begun
        stop = self._due(now)
        part, first = slice(self._frame, stop), float(markers.time[0])
        arrived = now
        if math.isfinite(self._speed) and stop > self._frame:
            arrived = self._begun + (float(markers.time[stop - 1]) - first) / self._speed
        samples = None
        if forces is not None:
            end = len(forces.time) if stop == len(markers.time) else int(
                (forces.time <= (markers.time[stop - 1] if stop else -math.inf)).sum()
            )  # fmt: skip
            samples = forces.samples(slice(self._sample, max(end, self._sample)))
            self._sample = max(end, self._sample)
        self._frame = stop
        return Packet(markers.frames(part), samples, arrived)

    def _due(self, now: float) -> int:
        time_s = self._trial.markers.time
        if not math.isfinite(self._speed):
            return min(self._frame + AT_ONCE, len(time_s))
        assert self._begun is not None
        return max(self._frame, int((time_s - time_s[0] <= (now - self._begun) * self._speed).sum()))
