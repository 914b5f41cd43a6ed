"""From postures and forces of a stream to inertial parameters, a block of frames at a time, a stated delay later."""

import logging
import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.config import Config
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import WrenchTrial, predict
from torchid.extension.open_geometry import widened
from torchid.geometry.result import GeometryFit
from torchid.inertia.identify import Identified
from torchid.live.estimation.estimator import Estimator, Gatherer
from torchid.live.estimation.instruments import InstrumentRows
from torchid.live.estimation.pose import Postures, too_far
from torchid.live.estimation.stretches import FEWEST_S, STRETCH_S, Stretches, counted, noise_of, outcome_of
from torchid.live.estimation.watch import Notice, Watch, WatchedBlock
from torchid.live.estimation.window import Window
from torchid.live.exercises.guidance import Guide
from torchid.live.sources.timeline import Timeline
from torchid.model.model import InertialPrior
from torchid.recording import Forces, Markers, Plate, Trial
from torchid.runs import dilate
from torchid.session import Followed
from torchid.session.fitting import com_boxes
from torchid.session.following import ENDS, Following, follow
from torchid.session.standing import Weight, short_of
from torchid.session.unseen import hold_unseen

log = logging.getLogger(__name__)
BLOCK_S = 1.0
"""Choice. Frames whose rows are taken together: a second holds what a body does most slowly, and is soon over."""
MOST = 16
"""Choice. Blocks that are worked off at once where more have come: the context is a ninth of the work then."""
LAG_PERIODS = 3.0
"""Derived. How many periods of the filter's cut-off a frame waits for its successors: the spline's memory falls by e in
0.27 of a period (its slowest poles are those of 1 / (1 + (f / f0)^6), ``Smoother``), so that 2e-5 of it is left."""
TAKEN_FOR_EXACT = "motion and geometry are taken for exact: no stretch of %.0f s has %.0f s with both feet on plates"
"""Wording. Of a stream without such a stretch."""
CONTEXT_S = 2.0
"""Choice. What is looked at before a block: a step, in which either foot is down once."""


@dataclass(frozen=True)
class LiveSubject:
    """What is known of a subject before the stream begins."""

    config: Config
    """Options of contact, filter and fit."""
    fit: GeometryFit
    """Geometry and places of the markers."""
    prior: InertialPrior
    """Of the segments' inertia."""
    mass: tuple[float, float] | None
    """Total mass and its standard deviation [kg], where standing or the record has told it."""
    weight: Weight | None
    """What the subject weighs, where standing on plates has told it."""
    cutoff_hz: float
    """Of the filter of motion and forces."""
    static: Markers | None = None
    """Standing trial from which geometry is refined while the subject moves; None keeps the geometry."""
    half_life_s: float = math.inf
    """Time after which a row counts half, for a body that changes; infinite: all count alike."""
    guide: Guide | None = None
    """Exercises from which it is told what to do next; None gives no advice."""


@dataclass(frozen=True)
class Reconstructed:
    """Total force on the subject as measured, and as the identified dynamics have it, through the same filter."""

    time: Float[Tensor, " frames"]
    """On the stream's uniform clock [s]."""
    measured: Float[Tensor, "frames 6"]
    """About the world's origin [N, N m]."""
    predicted: Float[Tensor, "frames 6"]


class Identifier:
    """Smooths, finds contacts and identifies, over a window that moves with the stream.

    A window is a small trial, and goes through the very stages of a run. Its inner frames, a block, have had all the
    time that the filter remembers on either side.
    """

    def __init__(
        self, subject: LiveSubject, labels: tuple[str, ...], rate_hz: float, plates: tuple[Plate, ...],
        force_rate_hz: float
    ) -> None:  # fmt: skip
        """Wait for frames.

        Args:
            labels: of the stream's markers.
        """
        self._labels = labels
        self._subject, self._rate, self._plates, self._force_rate = subject, rate_hz, plates, force_rate_hz
        names = subject.fit.model.tree.names
        box = com_boxes(subject.prior) if subject.config.inertia.com_boxes else None
        mass = subject.mass if math.isinf(subject.half_life_s) else None  # that of standing is the mass of then
        options, prior = hold_unseen(subject.config.inertia, subject.prior, subject.fit)
        self._mass = mass
        self.estimator = Estimator(names, prior, options, mass, box, subject.half_life_s)
        self._block, self._context = round(BLOCK_S * rate_hz), round(CONTEXT_S * rate_hz)
        self._length = round(STRETCH_S * rate_hz)
        self._lag = round(LAG_PERIODS / subject.cutoff_hz * rate_hz)
        dofs, markers = len(subject.fit.model.tree.dofs), len(subject.fit.attachment.labels)
        self._q, self._error, self._position = Timeline((dofs,)), Timeline((markers,)), Timeline((len(labels), 3))
        self._wrench = Timeline((len(plates), 6))
        self._gatherer, self._next = Gatherer(), 0
        self._stretches, self._stretch, self._used = Stretches(), 0, Timeline(())
        self.forces: Reconstructed | None = None
        """Of the last block, where it could be used."""
        self.instruments = InstrumentRows(subject.prior)
        """What the newest rows say of clock and gains."""
        self._watch = Watch(subject.fit.attachment.labels, [plate.name for plate in plates])
        self.watched: list[tuple[float, tuple[Notice, ...]]] = []
        """What was wrong in each of the last blocks, by its end [s]."""

    def put(
        self, index: Int[Tensor, " frames"], position: Float[Tensor, "frames seen 3"], postures: Postures,
        sample: Int[Tensor, " samples"], wrench: Float[Tensor, "samples plates 6"],
    ) -> None:  # fmt: skip
        """Take in what came.

        Args:
            position: of the stream's markers [m].
            postures: at these frames.
            sample: numbers of force samples.
            wrench: of the plates [N, N m].
        """
        self._position.put(index, position)
        self._q.put(index, postures.q)
        self._error.put(index, postures.error)
        if self._plates:
            self._wrench.put(sample, wrench)

    def work(self) -> bool:
        """Identify from every block that is complete; blocks that wait are worked off together.

        Returns:
            Whether there was one.
        """
        begun, self.watched = self._next, []
        while (count := (self._q.stop - self._lag - self._next) // self._block) > 0:
            stop = self._next + min(count, MOST) * self._block
            self._advance(stop, stop + self._lag)
        return self._next > begun

    @property
    def due(self) -> int:
        """Return the number of frames with which the next block is complete."""
        return self._next + self._block + self._lag

    @property
    def newest(self) -> int:
        """Return the number of the newest frame, -1 before the first."""
        return self._q.stop - 1

    def finish(self) -> Identified:
        """Identify from the frames that are left, and from all rows together, as a run does: the noise of the motion is
        taken out, and deviations hold what markers leave open of the geometry.

        Raises:
            DataError: as ``Estimator.finished``.
        """
        self.watched = []
        if self._q.stop > self._next:
            self._advance(self._q.stop, self._q.stop)
        self._take(None)
        self._keep(slice(self._stretch, self._q.stop))
        who, each = self._subject, (self._follow(one, f"stretch_{k}") for k, one in enumerate(self._stretches.kept))
        some = outcome_of(who.config, who.fit, who.prior, who.cutoff_hz, [one for one in each if one is not None])
        times = counted(some, self._gatherer.frames)
        found = self.estimator.finished(noise_of(some, times))
        if not times:
            log.warning(TAKEN_FOR_EXACT, STRETCH_S, FEWEST_S)
        return widened(replace(some, identified=found), self._mass, counted=times * self.estimator.share)

    def _advance(self, stop: int, known: int) -> None:
        """Rows of the frames up to ``stop``, from all that is known up to another."""
        first = max(self._q.start, self._next - self._context)
        followed, read = self._followed(slice(first, known))
        blocks = [slice(a, min(a + self._block, stop)) for a in range(self._next, stop, self._block)]
        inner = [slice(block.start - first, block.stop - first) for block in blocks]
        rows = None if followed is None else followed.wrench
        new = None if rows is None else rows.frames(slice(inner[0].start, inner[-1].stop))
        used = torch.zeros(stop - self._next) if new is None else new.used
        self._used.put(torch.arange(self._next, stop), used.to(torch.float64))
        self._take(new)
        plates = read if rows is None else rows.motion.smoother(torch.nan_to_num(read))
        for block, part in zip(blocks, inner, strict=True):
            self.forces = None if rows is None else self._reconstructed(rows.frames(part))
            contact = None if followed is None or followed.contact is None else followed.contact.frames(part)
            if rows is not None:
                self.instruments.add(rows, plates, part)
            seen = WatchedBlock(self._error.get(block), contact, read[part, :, 2], self.instruments.found())
            self.watched.append((block.stop / self._rate, self._watch.after(seen)))
        self._next = stop
        while self._next - self._stretch >= self._length:
            self._keep(slice(self._stretch, self._stretch + self._length))
            self._stretch += self._length
        kept = min(self._next - self._context, self._stretch)
        for line in (self._q, self._error, self._position, self._used):
            line.forget(kept)
        self._wrench.forget(round(kept / self._rate * self._force_rate))

    def _keep(self, stretch: slice) -> None:
        """Keep a stretch that is over, where enough of it counts."""
        if float(torch.nan_to_num(self._used.get(stretch)).sum()) >= FEWEST_S * self._rate:
            self._stretches.add(self._window(stretch))

    def _take(self, rows: WrenchTrial | None) -> None:
        """Add the rows of all frames since the last ones; None where there are none."""
        done = self._gatherer.close() if rows is None else self._gatherer.add(rows)
        self.estimator.add(done, self._gatherer.open, self._q.stop / self._rate)

    def _followed(self, part: slice) -> tuple[Followed | None, Float[Tensor, "frames plates 6"]]:
        """A window as a trial of its own, None where no posture or no force in it is known; and what plates read."""
        found = self._follow(self._window(part), "live")
        if found is None:
            return None, self._q.get(part).new_zeros(part.stop - part.start, len(self._plates), 6)
        trial, followed = found
        assert trial.forces is not None
        return followed, trial.forces.wrench

    def _window(self, part: slice) -> Window:
        """What came in some frames, but for markers that are astray."""
        time = torch.arange(part.start, part.stop, dtype=torch.float64) / self._rate
        forces = self._forces(part) if self._plates else None
        error, position, fit = self._error.get(part), self._position.get(part), self._subject.fit
        for label, away in zip(fit.attachment.labels, (error > too_far(fit)).unbind(1), strict=True):
            if label in self._labels:  # as where labels are exchanged: nothing is to be learnt from these
                position[away, self._labels.index(label)] = torch.nan
        return Window(time, self._q.get(part), error, position, forces)

    def _follow(self, window: Window, name: str) -> tuple[Trial, Followed] | None:
        """A window as a trial; None where no posture or no force in it is known."""
        known = window.trial(name, self._labels, self._rate)
        if known is None:
            return None
        (trial, tracked), who = known, self._subject
        short = None if who.weight is None else short_of(who.fit, trial, who.weight, who.prior.mean, who.config.contact)
        found = follow(who.fit, trial, tracked, Following.of(who.config, who.cutoff_hz), short)
        assert found.wrench is not None
        # Beside a gap, as at an end, a filter knows one side only.
        beside = dilate(~tracked.observable, round(ENDS / found.motion.smoother.cutoff_hz * self._rate))
        return trial, replace(found, wrench=replace(found.wrench, used=found.wrench.used & ~beside))

    def _reconstructed(self, rows: WrenchTrial) -> Reconstructed | None:
        """Forces of a block; None before anything is identified, and where a foot was off the plates."""
        fit = self.estimator.fit
        if fit is None or not bool(rows.used.any()):
            return None
        predicted = wrench_about(predict(rows, fit.phi), -rows.motion.q[:, :3])
        return Reconstructed(rows.motion.time[rows.used], rows.wrench[rows.used], predicted[rows.used])

    def _forces(self, part: slice) -> Forces:
        """Samples of some frames, on their own clock."""
        first, last = (round(k / self._rate * self._force_rate) for k in (part.start, part.stop - 1))
        time = torch.arange(max(0, first), last + 1, dtype=torch.float64) / self._force_rate
        return Forces(time, self._wrench.get(slice(max(0, first), last + 1)), self._plates)
