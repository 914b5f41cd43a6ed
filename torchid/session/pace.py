"""How far a solver has come, and how long it may still take, said where it takes long."""

import logging
import time
from collections.abc import Callable

STEPS = 10
"""Choice. Steps from which the pace of a solver is known."""
LONG_S = 300.0
"""Choice. A solver that may take longer than this says so once its pace is known [s]."""
EVERY_S = 60.0
"""Choice. Time after which a solver that takes long says again how far it has come [s]."""
NEARLY = 0.95
"""Choice. Share of a stage that its solver can reach: what comes after it is left."""

log = logging.getLogger(__name__)


class Pace:
    """Counts the steps of a solver that runs several times in a row, each time for at most so many steps."""

    def __init__(
        self, what: str, most: int, rounds: int, progress: Callable[[str, float], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """Begin before the first step.

        Args:
            most: steps of a round, at most.
            rounds: how often the solver runs.
            progress: called with the stage and the share of it that is done.
            clock: a clock [s].
        """
        self._what, self._most, self._rounds, self._progress, self._clock = what, most, rounds, progress, clock
        self._begun_s = self._said_s = clock()
        self._round, self._last, self._steps, self._long = 0, 0, 0, False

    def __call__(self, step: int, cost: float) -> None:
        """Count a step.

        Args:
            step: of the round, counted from 1; a smaller one than the last begins another round.
            cost: after it.
        """
        self._round, self._steps = self._round + (step <= self._last), self._steps + 1
        self._last = step
        total, done = self._rounds * self._most, min(self._round, self._rounds - 1) * self._most + step
        self._progress(self._what, min(NEARLY, done / total))
        now = self._clock()
        left_s = (now - self._begun_s) / self._steps * max(total - done, 0)
        early = self._steps == STEPS and left_s > LONG_S
        self._long |= early
        if early or (self._long and now - self._said_s > EVERY_S):
            self._said_s = now
            log.warning(
                "%s: step %d of at most %d, cost %.6g; at most %.0f s more", self._what, done, total, cost, left_s
            )
