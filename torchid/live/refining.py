"""Geometry found anew while the subject moves: standing alone tells little of where the joints are."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.errors import TorchidError
from torchid.experiment.stages import subject_prior
from torchid.geometry.fit import fit_geometry
from torchid.geometry.posture.initial_posture import evenly
from torchid.inertia.identify import Identified
from torchid.live.identifier import Identifier, Subject
from torchid.live.pose import Follower, Postures
from torchid.recording import Markers, Plate

log = logging.getLogger(__name__)
FIRST_S, LAST_S = 5.0, 160.0
"""Choice. Seconds of known motion after which geometry is fitted first and, doubling from fit to fit, last: the first
squats halve the distance of markers that standing alone leaves, and an hour is not to be kept in memory."""
FRAMES = 150
"""Choice. Frames of the motion in a fit: it takes two seconds, and twice as many move no marker by a millimetre."""
SLICE = 512
"""Choice. Frames that are identified anew between two messages: the stream's own block is never half a second late."""
MORE = 1.25
"""Choice. So many times the frames of the last fit are worth another one when the stream ends."""


@dataclass(frozen=True)
class Piece:
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
    """An ``Identifier`` whose geometry is fitted to more and more of the motion.

    A new geometry means other postures, so that all that came is followed and identified anew, beside the stream and a
    slice at a time; what is known by the old geometry stands until then. One that brings the markers no nearer to the
    model is dropped.
    """

    def __init__(
        self, subject: Subject, labels: tuple[str, ...], rate_hz: float, plates: tuple[Plate, ...], force_rate_hz: float
    ) -> None:  # fmt: skip
        """Wait for frames.

        Args:
            subject: geometry and prior to begin with.
            labels: of the stream's markers.
            rate_hz: frames per second.
            plates: force plates.
            force_rate_hz: samples per second.
        """
        self._labels, self._rate, self._stream = labels, rate_hz, (rate_hz, plates, force_rate_hz)
        self.subject, self.identifier = subject, Identifier(subject, *self._stream)
        self.version = 0
        """Number of geometries that have been put in place of one before."""
        self._due = FIRST_S * rate_hz if subject.static is not None else math.inf
        self._past: list[Piece] = []
        self._known = self._fitted = 0
        self._next: _Anew | None = None
        self._follower: Follower | None = None

    @property
    def busy(self) -> bool:
        """Return whether there is something to do although nothing has come."""
        return self._next is not None

    def put(self, piece: Piece, version: int) -> None:
        """Take in what came.

        Args:
            piece: frames and samples.
            version: of the geometry that the postures are of.
        """
        if version != self.version and self._follower is not None and len(piece.index):
            piece = replace(piece, postures=self._follower(self._markers(piece)))
        self.identifier.put(piece.index, piece.postures, piece.sample, piece.wrench)
        if math.isfinite(self._due):
            self._past.append(piece)
            self._known += int(piece.postures.known.sum())

    def work(self) -> bool:
        """Identify from every block that is complete, and go on with a new geometry where one is due.

        Returns:
            Whether there was a block.
        """
        done = self.identifier.work()
        if self._next is not None:
            self._go_on(SLICE)
        elif self._known >= self._due:
            self._begin()
        return done

    def finish(self) -> Identified:
        """Identify from the frames that are left, by the geometry of all that came.

        Raises:
            DataError: as ``Identifier.finish``.
        """
        if self._next is None and math.isfinite(self._due) and self._known > MORE * self._fitted:
            self._begin()
        while self._next is not None:
            self._go_on(SLICE)
        return self.identifier.finish()

    def _begin(self) -> None:
        """Fit the geometry, and be ready to identify anew."""
        self._due, self._fitted = 2.0 * self._due, self._known
        try:
            subject = refined(self.subject, self._past, self._labels)
        except TorchidError as error:
            log.warning("geometry stays as it was: %s", error)
            return
        self._next = _Anew(Identifier(subject, *self._stream), subject, Follower(subject.fit, self._labels))

    def _go_on(self, frames: int) -> None:
        """Identify some frames anew; the last ones settle whether the new geometry is the better one."""
        anew, stop = self._next, 0
        assert anew is not None
        while anew.done < len(self._past) and stop < frames:
            piece = self._past[anew.done]
            anew.put(piece, self._markers(piece))
            stop += len(piece.index)
        anew.identifier.work()
        if anew.done < len(self._past):
            return
        self._next = None
        if anew.after < anew.before:
            log.info("markers are %.1f mm from the refined model, %.1f before", 1e3 * anew.after, 1e3 * anew.before)
            self.subject, self.identifier, self._follower = anew.subject, anew.identifier, anew.follower
            self.version, self._past = self.version + 1, anew.past
            self.identifier.watched = []  # of the past
        if self._due > LAST_S * self._rate:
            self._due, self._past = math.inf, []

    def _markers(self, piece: Piece) -> Markers:
        return Markers(self._labels, piece.index.to(piece.position) / self._rate, piece.position)


class _Anew:
    """A new geometry, and how far it has come in the past."""

    def __init__(self, identifier: Identifier, subject: Subject, follower: Follower) -> None:
        self.identifier, self.subject, self.follower = identifier, subject, follower
        self.past: list[Piece] = []
        self._square, self._count = torch.zeros(2, dtype=torch.float64), 0

    @property
    def done(self) -> int:
        return len(self.past)

    @property
    def before(self) -> float:
        return math.sqrt(float(self._square[0]) / max(self._count, 1))

    @property
    def after(self) -> float:
        return math.sqrt(float(self._square[1]) / max(self._count, 1))

    def put(self, piece: Piece, markers: Markers) -> None:
        old = piece.postures
        if len(piece.index):
            piece = replace(piece, postures=self.follower(markers))
            both = torch.isfinite(old.error) & torch.isfinite(piece.postures.error)
            errors = torch.stack([old.error[both], piece.postures.error[both]])
            self._square, self._count = self._square + errors.square().sum(1), self._count + int(both.sum())
        self.past.append(piece)
        self.identifier.put(piece.index, piece.postures, piece.sample, piece.wrench)


def refined(subject: Subject, past: Sequence[Piece], labels: tuple[str, ...]) -> Subject:
    """Return the subject with geometry and prior from its standing trial and some of what came since.

    Args:
        subject: with a standing trial.
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
    return replace(subject, fit=fit, prior=subject_prior(subject.config, fit))
