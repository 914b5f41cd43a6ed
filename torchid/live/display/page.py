"""The page of a stream: what has been sent by then is drawn sixty times a second, in a process of its own."""

import logging
import multiprocessing
import queue
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.queues import Queue
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import ConfigError
from torchid.geometry.result import GeometryFit
from torchid.kinematics.recursion import body_transforms
from torchid.live.display.board import Board
from torchid.live.estimation.beside import LiveEstimate, apart
from torchid.live.estimation.identifier import BLOCK_S, LAG_PERIODS, LiveSubject
from torchid.live.estimation.pipeline import Moment
from torchid.live.estimation.watch import Notice
from torchid.live.exercises.advice import Advice
from torchid.recording import Plate
from torchid.scene.scene import Ground, Instant
from torchid.scene.server import open_page
from torchid.scene.solids import sticks
from torchid.storage.snapshot import from_bytes, to_bytes

log = logging.getLogger(__name__)
PERIOD_S = 1.0 / 60.0
"""Choice. Between two pictures: what screens show."""
FRESH_S = 0.1
"""Choice. A force that is older is no longer shown: nothing is, where nobody knows."""
PATIENCE_S = 0.1
"""Choice. After so long without a picture it is looked whether to say so."""
WAITING = 4
"""Choice. Pictures that may wait for the page; more are dropped, so that it shows the newest and holds nobody up."""
ASIDE_M, SMALL = 0.4, 0.4
"""Choice. Between drawn postures, and their size: three of them stand beside the subject, and arms do not touch."""
OPENED_S = 60.0
"""Choice. How long a machine that is busy may take to open a page."""

Drawing = Float[np.ndarray, "sticks 2 3"]
"""Sticks, their ends in W [m]."""


@dataclass(frozen=True)
class Address:
    """Where a page is to be opened."""

    port: int
    host: str


@dataclass(frozen=True)
class Picture:
    """One instant as it is sent to the page."""

    time_s: float
    q: Float[np.ndarray, " dofs"]
    markers: Float[np.ndarray, "markers 3"]
    """In the order of the stream."""
    error: Float[np.ndarray, " placed"]
    """Distance from the model, in the order of the fit [m]."""
    plates: Float[np.ndarray, "plates 6"] | None
    notices: tuple[Notice, ...] = ()


class Page:
    """Opens a page beside the caller; ``show`` never waits for it."""

    def __init__(
        self, subject: LiveSubject, labels: tuple[str, ...], plates: tuple[Plate, ...], where: Address
    ) -> None:
        """Start the process and wait until the page is open.

        Raises:
            ConfigError: ``scene.host``; ``live.page``, the page does not open.
        """
        context = multiprocessing.get_context("spawn")
        self._pictures, self._found = context.Queue(WAITING), context.Queue()
        pipe, theirs = context.Pipe(duplex=False)
        rehearsals = () if subject.guide is None else subject.guide.rehearsals
        drawings = {one.exercise.name: one.postures for one in rehearsals}
        given = to_bytes((subject.fit, subject.prior, plates, drawings))
        rest = (subject.cutoff_hz, labels, where)
        self._process = context.Process(
            target=_serve, args=(self._pictures, self._found, theirs, given, rest), daemon=True
        )
        with apart():
            self._process.start()
        theirs.close()
        self.address = self._opened(pipe)
        self._due_s, self._last, self._fit, self._missed = 0.0, None, subject.fit, False
        self.dropped = 0

    def show(self, moment: Moment) -> None:
        """Send the newest frame of a moment, where a picture is due, and what was found since the last one."""
        if not self._process.is_alive():
            self._gone()
            return
        if moment.fit is not self._fit:
            self._fit = moment.fit
            self._found.put(to_bytes(moment.fit))
        if moment.found is not None and moment.found is not self._last:
            self._last = moment.found
            self._found.put(to_bytes(moment.found))
        now = time.monotonic()
        if now < self._due_s:
            return
        self._due_s = max(self._due_s + PERIOD_S, now - PERIOD_S)  # sixty in the mean, however frames come
        plates = None if moment.wrench is None else moment.wrench.numpy()
        picture = Picture(
            float(moment.markers.time[-1]), moment.postures.q[-1].numpy(), moment.markers.position[-1].numpy(),
            moment.postures.error[-1].numpy(), plates, moment.notices,
        )  # fmt: skip
        try:
            self._pictures.put_nowait(picture)
        except queue.Full:
            self.dropped += 1

    def _gone(self) -> None:
        if not self._missed:
            log.warning("the page has ended (exit code %s); the stream goes on", self._process.exitcode)
        self._missed = True

    def close(self) -> None:
        """End the page."""
        for one in (self._pictures, self._found):
            one.cancel_join_thread()
            one.close()
        self._process.terminate()
        self._process.join(timeout=1.0)
        if self._process.is_alive():
            self._process.kill()

    def __enter__(self) -> "Page":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _opened(self, pipe: Connection) -> str:
        """The address; a process that ends says so by closing its pipe."""
        answer: tuple[str, Any] = ("failed", None)
        with suppress(EOFError):
            if pipe.poll(OPENED_S):
                answer = pipe.recv()
        pipe.close()
        what, value = answer
        if what == "open":
            return str(value)
        self.close()
        if value is not None:
            raise ConfigError(
                value["code"], value["message"], place=value["place"], found=value["found"], remedy=value["remedy"]
            )
        raise ConfigError(
            "live.page", "the page does not open", place="--port", found=f"exit code {self._process.exitcode}",
            remedy="Give --headless, or another port",
        )  # fmt: skip


class Show:
    """What the page's process knows, and how it draws it."""

    def __init__(
        self, board: Board, fit: GeometryFit, columns: list[int], cutoff_hz: float, drawings: dict[str, Drawing]
    ) -> None:  # fmt: skip
        """Begin with nothing.

        Args:
            columns: for every marker of the stream its place in the fit, -1 where it has none.
            drawings: of exercises by their names.
        """
        self._board, self._fit, self._columns, self._drawings = board, fit, np.array(columns), drawings
        self._advised: Advice | None = None
        self._delay_s = LAG_PERIODS / cutoff_hz + 2.0 * BLOCK_S
        self._forces: deque[tuple[float, np.ndarray, np.ndarray]] = deque()
        self._seen_s, self._found_q = time.monotonic(), False
        self._plates: tuple[float, np.ndarray | None] = (-np.inf, None)

    def found(self, some: LiveEstimate | GeometryFit) -> None:
        """Take up what the identifier has found."""
        if isinstance(some, GeometryFit):
            self._fit = some
            return
        if some.forces is not None:
            rows = zip(some.forces.time.tolist(), some.forces.measured.numpy(), some.forces.predicted.numpy(),
                       strict=True)  # fmt: skip
            self._forces.extend(rows)
        self._board.identified(some.fit, some.newest_s)
        if some.advice is not None and (self._advised is None or some.advice.name != self._advised.name):
            self._advised = some.advice
            parts = ", ".join(name.replace("_", " ") for name in some.advice.segments)
            why = f"for {some.advice.seconds:.0f} s: it tells most of {parts}"
            self._board.advise(some.advice.text, why, self._drawings.get(some.advice.name))

    def picture(self, some: Picture) -> None:
        """Draw an instant, and beside it the forces of the instant that the identifier has reached."""
        self._seen_s = time.monotonic()
        self._found_q = self._found_q or bool(np.isfinite(some.error).any())
        X_WB = None
        if self._found_q:
            X_WB = body_transforms(self._fit.model.tree, torch.from_numpy(some.q)[None], self._fit.geometry)[0].numpy()
        error = np.append(some.error, np.nan)[self._columns]
        at = some.time_s - self._delay_s
        while len(self._forces) > 1 and self._forces[1][0] <= at:
            self._board.passed(*self._forces.popleft())
        due = self._forces[0] if self._forces and 0.0 <= at - self._forces[0][0] < FRESH_S else None
        if some.plates is not None or some.time_s - self._plates[0] > FRESH_S:
            self._plates = (some.time_s, some.plates)
        measured, predicted = (None, None) if due is None else due[1:]
        self._board.warn([one.text for one in some.notices])
        self._board.show(Instant(X_WB, some.markers, error, self._plates[1], measured, predicted), some.time_s)

    def wait(self) -> None:
        """Say for how long nothing has come."""
        self._board.silent(time.monotonic() - self._seen_s)


def drawn(fit: GeometryFit, postures: Float[Tensor, "postures dofs"]) -> Drawing:
    """Return postures side by side as sticks, to the left of where the subject stands.

    Args:
        postures: what an exercise looks like.
    """
    tree, mean = fit.model.tree, fit.model.inertia.mean
    ends = (2.0 * mean[:, 1:4] / mean[:, :1].clamp(min=1e-9)).numpy()
    found = []
    for k, X_WB in enumerate(body_transforms(tree, postures, fit.geometry).numpy()):
        own = sticks([body.parent for body in tree.bodies], X_WB, ends)
        feet = own[:, :, 2].min()
        own -= np.array([X_WB[0, 0, 3], X_WB[0, 1, 3], feet])
        found.append(SMALL * own + np.array([-0.5, 0.3 + (k + 1) * ASIDE_M, 0.0]))
    return np.concatenate(found)


def _serve(pictures: Queue, found: Queue, pipe: Connection, given: bytes, rest: tuple[Any, ...]) -> None:
    torch.set_num_threads(1)
    cutoff_hz, labels, where = rest
    fit, prior, plates, postures = from_bytes(given)
    try:
        server, address = open_page(where.port, where.host)
    except ConfigError as error:
        keys = ("code", "message", "place", "found", "remedy")
        pipe.send(("failed", {key: getattr(error, key) for key in keys}))
        return
    corners = tuple(None if plate.corners is None else plate.corners.numpy() for plate in plates)
    board = Board(server, Ground(corners, tuple(plate.name for plate in plates)), fit.model.tree.names, prior)
    place = {label: k for k, label in enumerate(fit.attachment.labels)}
    drawings = {name: drawn(fit, some) for name, some in postures.items()}
    show = Show(board, fit, [place.get(label, -1) for label in labels], cutoff_hz, drawings)
    pipe.send(("open", address))
    while multiprocessing.parent_process() is None or multiprocessing.parent_process().is_alive():  # type: ignore[union-attr]
        _turn(show, pictures, found)


def _turn(show: Show, pictures: Queue, found: Queue) -> None:
    """Draw once, as soon as there is a picture: what was found, and the newest."""
    newest = deque[Picture](maxlen=1)
    with suppress(queue.Empty):
        newest.append(pictures.get(timeout=PATIENCE_S))
        newest.extend(_waiting(pictures))
    for one in _waiting(found):
        show.found(from_bytes(one))
    if newest:
        show.picture(newest[0])
    else:
        show.wait()


def _waiting(some: Queue) -> list[Any]:
    """Everything that waits in a queue."""
    out = []
    while True:
        try:
            out.append(some.get_nowait())
        except queue.Empty:
            return out
