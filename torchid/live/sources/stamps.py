"""What is wrong with the times that a stream gives its frames and samples, said while they come."""

import logging
from collections import deque

from torchid.live.estimation.watch import Notice
from torchid.live.sources.intake import Counts

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
