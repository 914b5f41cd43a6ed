"""Geometry found anew while the subject moves: standing alone tells little of where the joints are."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.errors import TorchidError
from torchid.geometry.fit import fit_geometry
from torchid.geometry.posture.initial_posture import evenly
from torchid.inertia.identify import Identified
from torchid.live.estimation.identifier import Identifier, LiveSubject
from torchid.live.estimation.pose import PostureFollower, Postures
from torchid.recording import Markers, Plate
from torchid.session.people import subject_prior

log = logging.getLogger(__name__)
FIRST_S, LAST_S = 5.0, 180.0
"""Choice. Seconds of known motion after which geometry is fitted first and, about doubled each time, at most: the first
squats halve the distance of markers that standing alone leaves, and an hour is not to be kept in memory."""
FRAMES = 150
"""Choice. Frames of the motion in a fit: it takes two seconds; twice as many bring markers of squats 0.1 mm nearer."""
BATCH = 96
"""Choice. Frames that are mended together, before the block that they belong to is complete: of a block of 200 frames a
tenth of the time that it takes to identify is spent so while its last frames are still to come. More than ``DENSE`` of
inverse kinematics, so that steps are those of a run."""
SLICE = 512
"""Choice. Frames that are identified anew between two blocks of the stream: a part of a second."""


@dataclass(frozen=True)
class MessagePiece:
    """What came with one message."""

    index: Int[Tensor, " frames"]
    """Numbers of the frames."""
    position: Float[Tensor, "frames markers 3"]
    """Of the stream's markers [m]."""
    postures: Postures
    """At these frames."""
    sample: Int[Tensor, " samples"]
    """Numbers of force samples."""
    wrench: Float[Tensor, "samples plates 6"]
    """Of the plates [N, N m]."""


class Refining:
    """An ``Identifier`` whose postures are mended, and whose geometry is fitted to more and more of the motion.

    A new geometry means other postures, so that all that came is followed and identified anew, beside the stream and a
    slice at a time; what is known by the old geometry stands until then. One that brings the markers no nearer to the
    model is dropped.
    """

    def __init__(
        self, subject: LiveSubject, labels: tuple[str, ...], rate_hz: float, plates: tuple[Plate, ...],
        force_rate_hz: float
    ) -> None:  # fmt: skip
        """Wait for frames.

        Args:
            labels: of the stream's markers.
        """
        self._stream = labels, rate_hz, plates, force_rate_hz
        self._by, self._next = ByGeometry(subject, *self._stream), None
        self._waiting: list[MessagePiece] = []
        self._unmended = 0
        self._past: list[MessagePiece] = []
        self._due = FIRST_S * rate_hz if subject.static is not None else math.inf
        self._known = self._fitted = 0
        self._newest = -1
        self.version = 0
        """Number of geometries that have been put in place of one before."""

    @property
    def subject(self) -> LiveSubject:
        """Return the subject, with its newest geometry."""
        return self._by.subject

    @property
    def identifier(self) -> Identifier:
        """Return what identifies by that geometry."""
        return self._by.identifier

    @property
    def busy(self) -> bool:
        """Return whether there is something to do although nothing has come."""
        return self._next is not None

    def put(self, piece: MessagePiece) -> None:
        """Take in what came.

        Args:
            piece: frames with postures that are nearly right, and samples.
        """
        self._waiting.append(piece)
        self._unmended += len(piece.index)
        if len(piece.index):
            self._newest = max(self._newest, int(piece.index.max()))

    def work(self) -> bool:
        """Mend what waits, identify from every block that is complete, and go on with a new geometry where one is due.

        Returns:
            Whether there was a block.
        """
        done = (self._newest + 1 >= self.identifier.due or self._unmended >= BATCH) and self._mend()
        if self._next is not None:
            self._go_on(self._next)
        elif self._known >= self._due:
            self._begin()
        return done

    def finish(self) -> Identified:
        """Identify from the frames that are left, by the geometry of all that came.

        Raises:
            DataError: as ``Identifier.finish``.
        """
        self._mend()
        while self._next is not None:
            self._go_on(self._next)
        if math.isfinite(self._due) and self._known > self._fitted:
            self._begin()
        while self._next is not None:
            self._go_on(self._next)
        return self.identifier.finish()

    def _mend(self) -> bool:
        """Mend all postures that wait, in one batch, and identify from what is complete."""
        waiting, self._waiting, self._unmended = self._waiting, [], 0
        if waiting:
            piece = self._by.take(joined(waiting))
            if math.isfinite(self._due):
                self._past.append(piece)
                self._known += int(piece.postures.known.sum())
        return self.identifier.work()

    def _begin(self) -> None:
        """Fit the geometry, and be ready to identify anew."""
        self._due, self._fitted = 2.0 * self._known, self._known
        try:
            self._next = ByGeometry(refined(self.subject, self._past, self._stream[0]), *self._stream)
        except TorchidError as error:
            log.warning("geometry stays as it was: %s", error)
            self._forget()

    def _go_on(self, anew: "ByGeometry") -> None:
        """Identify some frames anew; the last ones settle whether the new geometry is the better one."""
        frames = 0
        while len(anew.past) < len(self._past) and frames < SLICE:
            piece = anew.take(self._past[len(anew.past)])
            anew.past.append(piece)
            frames += len(piece.index)
        anew.identifier.work()
        if len(anew.past) < len(self._past):
            return
        self._next = None
        before_m, after_m = _distances(self._past, anew.past)
        if after_m < before_m:
            log.info("markers are %.1f mm from the refined model, %.1f before", 1e3 * after_m, 1e3 * before_m)
            self._by, self._past, self.version = anew, anew.past, self.version + 1
            self.identifier.watched = []  # of the past
        self._forget()

    def _forget(self) -> None:
        """Give up the past after the last fit."""
        if self._due > LAST_S * self._stream[1]:
            self._due, self._past = math.inf, []


class ByGeometry:
    """What is found by one geometry."""

    def __init__(
        self, subject: LiveSubject, labels: tuple[str, ...], rate_hz: float, plates: tuple[Plate, ...],
        force_rate_hz: float
    ) -> None:  # fmt: skip
        """Begin with nothing; arguments are those of ``Refining``."""
        self.subject, self._labels, self._rate = subject, labels, rate_hz
        self.identifier = Identifier(subject, labels, rate_hz, plates, force_rate_hz)
        self._follower = PostureFollower(subject.fit, labels)
        self.past: list[MessagePiece] = []
        """What was taken again, from the stream's beginning on."""

    def take(self, piece: MessagePiece) -> MessagePiece:
        """Hand a piece to the identifier, and return it with postures by this geometry.

        Args:
            piece: with postures that are nearly right.
        """
        if len(piece.index):
            markers = Markers(self._labels, piece.index.to(piece.position) / self._rate, piece.position)
            piece = replace(piece, postures=self._follower.mended(markers, piece.postures.q))
        self.identifier.put(piece.index, piece.position, piece.postures, piece.sample, piece.wrench)
        return piece


def joined(pieces: Sequence[MessagePiece]) -> MessagePiece:
    """Return all that came with several messages as one.

    Args:
        pieces: one at least.
    """
    some = [piece for piece in pieces if len(piece.index)]
    some = some or list(pieces[:1])
    return MessagePiece(
        torch.cat([one.index for one in some]), torch.cat([one.position for one in some]),
        Postures(torch.cat([one.postures.q for one in some]), torch.cat([one.postures.error for one in some])),
        torch.cat([one.sample for one in pieces]), torch.cat([one.wrench for one in pieces]),
    )  # fmt: skip


def _distances(before: Sequence[MessagePiece], after: Sequence[MessagePiece]) -> list[float]:
    """Root mean square distances of markers from two models, in frames that are known by both [m]."""
    errors = torch.stack([torch.cat([one.postures.error.reshape(-1) for one in some]) for some in (before, after)])
    return errors[:, torch.isfinite(errors).all(0)].square().mean(1).sqrt().tolist()


def refined(subject: LiveSubject, past: Sequence[MessagePiece], labels: tuple[str, ...]) -> LiveSubject:
    """Return the subject with geometry and prior from its standing trial and some of what came since.

    Args:
        past: frames of the stream.
        labels: of the stream's markers.

    Raises:
        TorchidError: as ``fit_geometry``.
    """
    known = [piece.position[piece.postures.known] for piece in past if len(piece.index)]
    position = torch.cat(known)
    position = position[evenly(len(position), FRAMES)]
    missing = position.new_full((len(position), 1, 3), torch.nan)
    place = {label: k for k, label in enumerate(labels)}
    attached = subject.fit.attachment.labels
    column = [place.get(label, len(labels)) for label in attached]
    moving = Markers(attached, torch.arange(len(position)).to(position), torch.cat([position, missing], 1)[:, column])
    options = subject.config.geometry
    fit = fit_geometry(subject.fit.model, subject.fit.attachment, {"live": moving}, subject.static, options)
    return replace(subject, fit=fit, prior=subject_prior(subject.config.model, subject.config.subject, fit))
