"""The identifier in a process of its own, so that it never holds up a posture."""

import multiprocessing
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
from jaxtyping import Float, Int
from torch import Tensor

from torchid.errors import DataError
from torchid.inertia.fit import InertiaFit
from torchid.inertia.identify import Identified
from torchid.live.advice import Account, Advice, Adviser
from torchid.live.identifier import BLOCK_S, Identifier, Reconstructed, Subject
from torchid.live.pose import Postures
from torchid.live.watch import Notice
from torchid.recording import Plate
from torchid.snapshot import from_bytes, to_bytes


@dataclass(frozen=True)
class Found:
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

    def __init__(self, subject: Subject, rate_hz: float, plates: tuple[Plate, ...], force_rate_hz: float) -> None:
        """Start the process; arguments are those of ``Identifier``."""
        context = multiprocessing.get_context("spawn")
        # A queue, whose thread writes: neither side may wait for the other to read.
        self._jobs = context.Queue()
        self._pipe, theirs = context.Pipe(duplex=False)
        given = to_bytes((subject.fit, subject.prior, subject.weight, plates, subject.guide))
        rest = (subject.config, subject.mass, subject.cutoff_hz, rate_hz, force_rate_hz)
        self._process = context.Process(target=_serve, args=(self._jobs, theirs, given, rest), daemon=True)
        with deaf():
            self._process.start()
        theirs.close()
        self.sent = self.done = 0
        self.found: Found | None = None
        self.notices: tuple[Notice, ...] = ()
        """What is wrong now."""
        self.noted: dict[tuple[str, str], tuple[float, float]] = {}
        """From when to when something was wrong [s], by what and where."""
        self.advice: Advice | None = None
        self.account: Account | None = None

    def add(self, index: Int[Tensor, " frames"], postures: Postures, sample: Tensor, wrench: Tensor) -> None:
        """Send what came; arguments are those of ``Identifier.add``."""
        parts = (index, postures.q, postures.error, sample, wrench)
        self._jobs.put(tuple(part.numpy() for part in parts))
        self.sent += 1
        self.poll()

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
            self.found = Found(*from_bytes(value))
            self.advice = self.found.advice
        elif what == "watched":
            self._note(*value)

    def _note(self, now_s: float, notices: tuple[Notice, ...]) -> None:
        self.notices = notices
        for one in notices:
            since, _ = self.noted.get((one.what, one.where), (now_s, now_s))
            self.noted[one.what, one.where] = since, now_s

    def finish(self) -> Identified:
        """Wait for all that was sent, and identify from all of it; ``account`` has what each exercise brought.

        Raises:
            DataError: as ``Identifier.finish``; ``live.gone``.
        """
        self._jobs.put(None)
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
def deaf() -> Iterator[None]:
    """A process that is started here never hears Ctrl-C: it is for the parent, which says when the other is to end."""
    if threading.current_thread() is not threading.main_thread():  # only that one hears it
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _serve(jobs: Queue, pipe: Connection, given: bytes, rest: tuple) -> None:
    torch.set_num_threads(1)
    fit, prior, weight, plates, guide = from_bytes(given)
    config, mass, cutoff_hz, rate_hz, force_rate_hz = rest
    own = Identifier(Subject(config, fit, prior, mass, weight, cutoff_hz), rate_hz, plates, force_rate_hz)
    adviser = None if guide is None else Adviser(guide, rate_hz)
    count = 0
    try:
        if adviser is not None:
            pipe.send(("advice", to_bytes(adviser.after(own.estimator, 0.0, 0.0))))
        while (message := jobs.get()) is not None:
            count += 1
            index, q, error, sample, wrench = (torch.from_numpy(np.asarray(part)) for part in message)
            if not own.add(index, Postures(q, error), sample, wrench):
                pipe.send(("done", count))
                continue
            pipe.send(("watched", (own.done_s, own.notices)))
            if own.estimator.fit is not None:
                newest = int(index[-1])
                now_s = newest / rate_hz
                advice = None if adviser is None else adviser.after(own.estimator, now_s, own.done_s - 0.5 * BLOCK_S)
                known = None if adviser is None else adviser.share
                pipe.send(("found", to_bytes((own.estimator.fit, newest, now_s, own.forces, advice, known))))
            pipe.send(("done", count))
        try:
            identified = own.finish()
            if adviser is not None:
                pipe.send(("account", to_bytes(adviser.account(own.estimator, identified))))
            pipe.send(("end", to_bytes(identified)))
        except DataError as error:
            pipe.send(("failed", (error.code, error.message, error.found, error.remedy)))
    except (EOFError, BrokenPipeError):
        pass  # the parent is gone
