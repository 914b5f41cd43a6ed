"""A simulated subject as a source: it stands, and does what it is advised to, in real time."""

import signal
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from simulated_person.clips import STANDING, Standing, make_clip, make_standing, stand_still
from torchid.live.estimation.beside import apart
from torchid.live.exercises.advice import Advice
from torchid.live.exercises.exercises import LIBRARY, Exercise
from torchid.live.exercises.guidance import GOAL
from torchid.live.sources.stream import Packet
from torchid.recording import Trial
from torchid.simulate.options import ANALOG_RATIO, SimulateOptions
from torchid.simulate.subject import SimulatedSubject
from torchid.simulate.trial import measure
from torchid.storage.snapshot import from_bytes, to_bytes

STAND_S = 0.2
"""Choice. For how long the subject stands at least between two exercises, and at a time while it waits for one: how
long people need to answer what they see."""

HEAR_S = 1.0
"""Choice. By how much the subject is done sooner than asked: an exercise begins some time after it is asked for, and
one that took all its time would begin later and later after its advice, to which what it tells is counted."""


@dataclass(frozen=True)
class Done:
    """An exercise that the subject has begun."""

    exercise: str
    start_s: float
    """On the clock of the stream [s]."""
    seconds: float
    """For how long it takes."""


class SimulatedSource:
    """``with SimulatedSource(...) as source:`` measures somebody who follows the advice that ``hear`` is told of.

    Every new piece of advice is prepared at once, in a process of its own, and begun when what was begun before is
    over. Until then, and where nothing is advised, the subject stands. The stream ends once everything is known.
    """

    def __init__(
        self, who: SimulatedSubject, options: SimulateOptions, seed: int,
        clock: Callable[[], float] = time.monotonic, pool: Executor | None = None,
    ) -> None:  # fmt: skip
        """Let the subject stand; the stream begins when it is first asked for frames.

        Args:
            who: the subject.
            options: rates, plates and noise.
            seed: of motions and noise.
            clock: monotonic time [s].
            pool: what prepares exercises; None: a process, which starts with the ``with`` block.
        """
        self._options, self._seed, self._clock, self._pool = options, seed, clock, pool
        self._standing = make_standing(who, seed, options.rate_hz)
        self._still = stand_still(self._standing, STAND_S, options)
        self._rng = np.random.default_rng((seed, 5))
        self._piece, self._at, self._before = self._stood(), 0, 0
        self._begun: float | None = None
        self._advice: Advice | None = None
        self._coming: tuple[Exercise, Future[bytes]] | None = None
        self._asked, self._known = 0, False
        self.done: list[Done] = []
        markers, forces = self._piece.markers, self._piece.forces
        assert forces is not None
        self.labels, self.rate_hz = markers.labels, options.rate_hz
        self.plates, self.force_rate_hz = forces.plates, options.rate_hz * ANALOG_RATIO

    def __enter__(self) -> "SimulatedSource":
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, get_context("spawn"), _begin)
            with apart():
                self._pool.submit(_begin)  # a process starts with its first task, and takes seconds
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)

    def hear(self, advice: Advice | None, known: Float[Tensor, " bodies"] | None) -> None:
        """Take up what the subject is asked for, and whether everything is known; returns at once.

        Args:
            advice: the newest; None before there is any.
            known: share of what can be known of each body, as ``Found.known``.
        """
        self._known = known is not None and bool((known >= GOAL).all())
        if advice is None or advice == self._advice:
            return
        self._advice = advice
        if self._coming is not None:
            self._coming[1].cancel()
        asked = next(one for one in LIBRARY if one.name == advice.name)
        exercise = replace(asked, seconds=asked.seconds - HEAR_S)
        assert self._pool is not None, "not entered"
        self._asked += 1
        given = to_bytes((exercise, self._standing, self._options, self._seed + self._asked))
        self._coming = exercise, self._pool.submit(_prepared, given)

    def take(self) -> Packet | None:
        """Return the frames that are due, and the samples up to the newest of them; None once everything is known.

        Raises:
            ConfigError: ``simulate.balance``, the subject cannot do what it is asked for.
        """
        if self._known:
            return None
        now = self._clock()
        self._begun = now if self._begun is None else self._begun
        if self._at == len(self._piece.markers.time):
            self._before += self._at
            self._piece, self._at = self._next(), 0
        due = int((now - self._begun) * self.rate_hz) + 1 - self._before
        stop = min(max(due, self._at), len(self._piece.markers.time))
        part, self._at = slice(self._at, stop), stop
        return self._packet(part, self._begun + (self._before + stop - 1) / self.rate_hz)

    def _packet(self, part: slice, arrived_s: float) -> Packet:
        """Frames of the piece that is under way, at their times in the stream."""
        markers, forces = self._piece.markers.frames(part), self._piece.forces
        assert forces is not None
        samples = forces.samples(slice(part.start * ANALOG_RATIO, part.stop * ANALOG_RATIO))
        since_s = self._before / self.rate_hz
        return Packet(
            replace(markers, time=markers.time + since_s), replace(samples, time=samples.time + since_s), arrived_s
        )

    def _next(self) -> Trial:
        """The exercise that was advised, where it is prepared and another one was not done just now; else standing."""
        if self._coming is None or not self._coming[1].done() or self._piece.name != STANDING:
            return self._stood()
        exercise, future = self._coming
        self._coming = None
        self.done.append(Done(exercise.name, self._before / self.rate_hz, exercise.seconds))
        return from_bytes(future.result())

    def _stood(self) -> Trial:
        return measure(self._standing.who, self._still, self._options, self._rng).trial


def _begin() -> None:
    """In the process that prepares: Ctrl-C is for the parent, and the other core is the stream's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)


def _prepared(given: bytes) -> bytes:
    """A recording of an exercise, with noise, from what ``hear`` sends."""
    exercise, standing, options, seed = from_bytes(given)  # a snapshot keeps a named tuple as a tuple
    standing = Standing(*standing)
    clip = make_clip(exercise, standing, options, seed)
    return to_bytes(measure(standing.who, clip, options, np.random.default_rng((seed, 6))).trial)
