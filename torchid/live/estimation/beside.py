"""The identifier in a process of its own, so that it never holds up a posture."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.queues import Queue
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError, TorchidError
from torchid.inertia.fit import InertiaFit
from torchid.inertia.identify import Identified
from torchid.live.estimation.identifier import LiveSubject, Reconstructed
from torchid.live.estimation.pose import Postures
from torchid.live.estimation.refining import MessagePiece, Refining
from torchid.live.estimation.watch import Notice
from torchid.live.exercises.advice import Account, Advice, Adviser
from torchid.recording import Plate
from torchid.storage.allocator import seldom_collect
from torchid.storage.snapshot import from_bytes, to_bytes

THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Variables from which libraries for linear algebra read how many threads they may start."""


@dataclass(frozen=True)
class LiveEstimate:
    """What the identifier has found so far."""

    fit: InertiaFit
    newest: int
    """Number of the newest frame that it had seen."""
    newest_s: float
    """Its time on the stream's uniform clock [s]."""
    forces: Reconstructed | None
    """Of the last block, where it had contacts on plates alone."""
    advice: Advice | None = None
    """What the subject is asked to do next, where it is advised."""
    known: Float[Tensor, " bodies"] | None = None
    """How much of each body's determined parameters is known, where the subject is advised."""


class Beside:
    """An ``Identifier`` that works beside the caller; what is sent waits in order, and results are asked for."""

    def __init__(
        self, subject: LiveSubject, labels: tuple[str, ...], rate_hz: float, plates: tuple[Plate, ...],
        force_rate_hz: float
    ) -> None:  # fmt: skip
        """Start the process; arguments are those of ``Refining``."""
        context = multiprocessing.get_context("spawn")
        # A queue, whose thread writes: neither side may wait for the other to read.
        self._jobs, self._put = context.Queue(), context.Value("Q", 0, lock=False)
        self._pipe, theirs = context.Pipe(duplex=False)
        given = to_bytes((subject.fit, subject.prior, subject.weight, plates, subject.guide, subject.static))
        rest = (subject.config, subject.mass, subject.cutoff_hz, subject.half_life_s, labels, rate_hz, force_rate_hz)
        self._process = context.Process(target=_serve, args=(self._jobs, self._put, theirs, given, rest), daemon=True)
        with apart():
            self._process.start()
        theirs.close()
        self.sent = self.done = 0
        self.version, self.fit, self.prior = 0, subject.fit, subject.prior
        """Number of the newest geometry, and what it is."""
        self.found: LiveEstimate | None = None
        self.notices: tuple[Notice, ...] = ()
        """What is wrong now."""
        self.noted: dict[tuple[str, str], tuple[float, float]] = {}
        """From when to when something was wrong [s], by what and where."""
        self.advice: Advice | None = None
        self.account: Account | None = None

    def add(self, piece: MessagePiece) -> None:
        """Send what came; arguments are those of ``Refining.put``."""
        parts = (piece.index, piece.position, piece.postures.q, piece.postures.error, piece.sample, piece.wrench)
        self._send(tuple(part.numpy() for part in parts))
        self.sent += 1
        self.poll()

    def _send(self, message: tuple | None) -> None:
        """Put a message into the queue, and count it: its pipe holds two, so that nobody sees how many wait."""
        self._jobs.put(message)
        self._put.value += 1

    def poll(self) -> None:
        """Take in what the process has found since; ``found``, ``advice`` and ``done`` have it.

        Raises:
            DataError: ``live.gone``, the process has ended.
        """
        while self._pipe.poll():
            self._keep(*self._received())

    def _keep(self, what: str, value: Any) -> None:
        if what == "done":
            self.done = value
        elif what == "advice":
            self.advice = from_bytes(value)
        elif what == "account":
            self.account = from_bytes(value)
        elif what == "found":
            self.found = LiveEstimate(*from_bytes(value))
            self.advice = self.found.advice
        elif what == "watched":
            self._note(value)
        elif what == "geometry":
            self.version = self.version + 1
            self.fit, self.prior = from_bytes(value)

    def _note(self, watched: list[tuple[float, tuple[Notice, ...]]]) -> None:
        for now_s, self.notices in watched:
            for one in self.notices:
                since, _ = self.noted.get((one.what, one.where), (now_s, now_s))
                self.noted[one.what, one.where] = since, now_s

    def finish(self) -> Identified:
        """Wait for all that was sent, and identify from all of it; ``account`` has what each exercise brought.

        Raises:
            DataError: as ``Refining.finish``; ``live.gone``.
        """
        self._send(None)
        what, value = self._received()
        while what not in ("end", "failed"):
            self._keep(what, value)
            what, value = self._received()
        self.close()
        if what == "failed":
            code, message, found, remedy = value
            raise DataError(code, message, found=found, remedy=remedy)
        return from_bytes(value)

    def _received(self) -> tuple[str, Any]:
        try:
            return self._pipe.recv()
        except EOFError:
            raise DataError(
                "live.gone", "the process that identifies has ended before the stream did",
                found=f"exit code {self._process.exitcode}", remedy="Make room in memory; what was recorded is kept",
            ) from None  # fmt: skip

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._jobs.cancel_join_thread()
        self._jobs.close()
        self._process.join(timeout=1.0)
        if self._process.is_alive():
            self._process.kill()


@contextmanager
def apart() -> Iterator[None]:
    """A process that is started here has one thread for its arithmetic, and never hears Ctrl-C.

    Two processes whose libraries each take all cores wait for each other: a factorisation of 7 ms took 180. Ctrl-C is
    for the parent, which says when the other is to end.
    """
    given = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        with _deaf():
            yield
    finally:
        for name, value in given.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _deaf() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # only that one hears it
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _waiting(jobs: Queue, put: Any, own: Refining) -> Iterator[list[tuple]]:
    """All that has come since, again and again, until nothing is to come; perhaps nothing where there is work."""
    some: list[tuple | None] = []
    taken = 0
    while None not in some:
        some = [jobs.get() for _ in range(put.value - taken)]
        some = some if some or own.busy else [jobs.get()]
        taken += len(some)
        yield [one for one in some if one is not None]


def _serve(jobs: Queue, put: Any, pipe: Connection, given: bytes, rest: tuple) -> None:
    torch.set_num_threads(1)
    seldom_collect()
    fit, prior, weight, plates, guide, static = from_bytes(given)
    config, mass, cutoff_hz, half_life_s, labels, rate_hz, force_rate_hz = rest
    subject = LiveSubject(config, fit, prior, mass, weight, cutoff_hz, static, half_life_s)
    own = Refining(subject, labels, rate_hz, plates, force_rate_hz)
    adviser = None if guide is None else Adviser(guide, rate_hz)
    try:
        if adviser is not None:
            pipe.send(("advice", to_bytes(adviser.after(own.identifier.estimator, 0.0))))
        done = 0
        for messages in _waiting(jobs, put, own):
            for message in messages:
                own.put(_piece(*(torch.from_numpy(np.asarray(part)) for part in message)))
            _work(own, adviser, pipe, rate_hz)
            done += len(messages)
            pipe.send(("done", done))
        _end(own, adviser, pipe)
    except (EOFError, BrokenPipeError):
        pass  # the parent is gone


def _piece(index: Tensor, position: Tensor, q: Tensor, error: Tensor, sample: Tensor, wrench: Tensor) -> MessagePiece:
    return MessagePiece(index, position, Postures(q, error), sample, wrench)


def _work(own: Refining, adviser: Adviser | None, pipe: Connection, rate_hz: float) -> None:
    """Identify from what has come, and say what was found."""
    version = own.version
    done = own.work()
    if own.version > version:
        pipe.send(("geometry", to_bytes((own.subject.fit, own.subject.prior))))
    if not done:
        return
    known = own.identifier
    pipe.send(("watched", known.watched))
    if known.estimator.fit is not None:
        now_s = known.newest / rate_hz
        advice = None if adviser is None else adviser.after(known.estimator, now_s)
        share = None if adviser is None else adviser.share
        pipe.send(("found", to_bytes((known.estimator.fit, known.newest, now_s, known.forces, advice, share))))


def _end(own: Refining, adviser: Adviser | None, pipe: Connection) -> None:
    """Identify from all that has come, and say what was found."""
    version = own.version
    try:
        identified = own.finish()
    except TorchidError as error:
        pipe.send(("failed", (error.code, error.message, error.found, error.remedy)))
        return
    if own.version > version:
        pipe.send(("geometry", to_bytes((own.subject.fit, own.subject.prior))))
    known = own.identifier
    pipe.send(("watched", known.watched))
    if adviser is not None:
        pipe.send(("account", to_bytes(adviser.account(known.estimator, identified))))
    pipe.send(("end", to_bytes(identified)))
