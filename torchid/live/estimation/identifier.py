"""From postures and forces of a stream to inertial parameters, a block of frames at a time, a stated delay later."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.config import Config
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import SHORTEST, WrenchTrial, predict
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked
from torchid.inertia.identify import Identified
from torchid.io.resample import to_clock
from torchid.live.estimation.estimator import Estimator, Gatherer
from torchid.live.estimation.instruments import InstrumentRows
from torchid.live.estimation.pose import Postures
from torchid.live.estimation.watch import Notice, Watch, WatchedBlock
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

BLOCK_S = 1.0
"""Choice. Frames whose rows are taken together: a second holds what a body does most slowly, and is soon over."""
MOST = 16
"""Choice. Blocks that are worked off at once where more have come: the context is a ninth of the work then."""
LAG_PERIODS = 3.0
"""Derived. How many periods of the filter's cut-off a frame waits for its successors: the spline's memory falls by e in
0.27 of a period (its slowest poles are those of 1 / (1 + (f / f0)^6), ``Smoother``), so that 2e-5 of it is left."""
BRIDGED_S = 0.04
"""Choice. Postures that are missing for no longer are taken on a straight line between their neighbours: a quarter of
the period of 6 Hz, in which the straight line is wrong by less than the filter takes away."""
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

    def __init__(self, subject: LiveSubject, rate_hz: float, plates: tuple[Plate, ...], force_rate_hz: float) -> None:
        """Wait for frames."""
        self._subject, self._rate, self._plates, self._force_rate = subject, rate_hz, plates, force_rate_hz
        names = subject.fit.model.tree.names
        box = com_boxes(subject.prior) if subject.config.inertia.com_boxes else None
        mass = subject.mass if math.isinf(subject.half_life_s) else None  # that of standing is the mass of then
        options, prior = hold_unseen(subject.config.inertia, subject.prior, subject.fit)
        self.estimator = Estimator(names, prior, options, mass, box, subject.half_life_s)
        self._block, self._context = round(BLOCK_S * rate_hz), round(CONTEXT_S * rate_hz)
        self._lag = round(LAG_PERIODS / subject.cutoff_hz * rate_hz)
        dofs, markers = len(subject.fit.model.tree.dofs), len(subject.fit.attachment.labels)
        self._q, self._error = Timeline((dofs,)), Timeline((markers,))
        self._wrench = Timeline((len(plates), 6))
        self._gatherer, self._next = Gatherer(), 0
        self.forces: Reconstructed | None = None
        """Of the last block, where it could be used."""
        self.instruments = InstrumentRows(subject.prior)
        """What the newest rows say of clock and gains."""
        self._watch = Watch(subject.fit.attachment.labels, [plate.name for plate in plates])
        self.watched: list[tuple[float, tuple[Notice, ...]]] = []
        """What was wrong in each of the last blocks, by its end [s]."""

    def put(
        self, index: Int[Tensor, " frames"], postures: Postures, sample: Int[Tensor, " samples"],
        wrench: Float[Tensor, "samples plates 6"],
    ) -> None:  # fmt: skip
        """Take in what came.

        Args:
            postures: at these frames.
            sample: numbers of force samples.
            wrench: of the plates [N, N m].
        """
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
        """Identify from the frames that are left, and from all rows together.

        Raises:
            DataError: as ``Estimator.finished``.
        """
        self.watched = []
        if self._q.stop > self._next:
            self._advance(self._q.stop, self._q.stop)
        self._take(None)
        return self.estimator.finished()

    def _advance(self, stop: int, known: int) -> None:
        """Rows of the frames up to ``stop``, from all that is known up to another."""
        first = max(self._q.start, self._next - self._context)
        followed, read = self._followed(slice(first, known))
        blocks = [slice(a, min(a + self._block, stop)) for a in range(self._next, stop, self._block)]
        inner = [slice(block.start - first, block.stop - first) for block in blocks]
        rows = None if followed is None else followed.wrench
        self._take(None if rows is None else rows.frames(slice(inner[0].start, inner[-1].stop)))
        plates = read if rows is None else rows.motion.smoother(torch.nan_to_num(read))
        for block, part in zip(blocks, inner, strict=True):
            self.forces = None if rows is None else self._reconstructed(rows.frames(part))
            contact = None if followed is None or followed.contact is None else followed.contact.frames(part)
            if rows is not None:
                self.instruments.add(rows, plates, part)
            seen = WatchedBlock(self._error.get(block), contact, read[part, :, 2], self.instruments.found())
            self.watched.append((block.stop / self._rate, self._watch.after(seen)))
        self._next = stop
        kept = self._next - self._context
        for line in (self._q, self._error):
            line.forget(kept)
        self._wrench.forget(round(kept / self._rate * self._force_rate))

    def _take(self, rows: WrenchTrial | None) -> None:
        """Add the rows of all frames since the last ones; None where there are none."""
        done = self._gatherer.close() if rows is None else self._gatherer.add(rows)
        self.estimator.add(done, self._gatherer.open, self._q.stop / self._rate)

    def _followed(self, part: slice) -> tuple[Followed | None, Float[Tensor, "frames plates 6"]]:
        """A window as a trial of its own, None where no posture or no force in it is known; and what plates read."""
        nothing = None, self._q.get(part).new_zeros(part.stop - part.start, len(self._plates), 6)
        if part.stop - part.start <= SHORTEST or not self._plates:
            return nothing
        q, error = _bridged(self._q.get(part), self._error.get(part), round(BRIDGED_S * self._rate))
        seen = torch.isfinite(error).any(1)
        if not bool(seen.any()):
            return nothing
        time = torch.arange(part.start, part.stop, dtype=torch.float64) / self._rate
        forces = self._forces(time)
        if forces is None:
            return nothing
        trial = Trial("live", Markers((), time, q.new_zeros(len(q), 0, 3)), forces)
        who = self._subject
        short = None if who.weight is None else short_of(who.fit, trial, who.weight, who.prior.mean, who.config.contact)
        found = follow(
            who.fit, trial, Tracked(time, _held(q, seen), error, seen), Following.of(who.config, who.cutoff_hz), short
        )
        assert found.wrench is not None
        # Beside a gap, as at an end, a filter knows one side only.
        beside = dilate(~seen, round(ENDS / found.motion.smoother.cutoff_hz * self._rate))
        return replace(found, wrench=replace(found.wrench, used=found.wrench.used & ~beside)), forces.wrench

    def _reconstructed(self, rows: WrenchTrial) -> Reconstructed | None:
        """Forces of a block; None before anything is identified, and where a foot was off the plates."""
        fit = self.estimator.fit
        if fit is None or not bool(rows.used.any()):
            return None
        predicted = wrench_about(predict(rows, fit.phi), -rows.motion.q[:, :3])
        return Reconstructed(rows.motion.time[rows.used], rows.wrench[rows.used], predicted[rows.used])

    def _forces(self, time: Float[Tensor, " frames"]) -> Forces | None:
        """Samples of a window on the clock of its frames."""
        ends = (float(time[0]) * self._force_rate, float(time[-1]) * self._force_rate)
        part = slice(max(0, round(ends[0])), round(ends[1]) + 1)
        wrench = self._wrench.get(part)
        if not bool(torch.isfinite(wrench).any()):
            return None
        own = torch.arange(part.start, part.stop, dtype=torch.float64) / self._force_rate
        return to_clock(Forces(own, wrench, self._plates), time)


def _bridged(q: Tensor, error: Tensor, longest: int) -> tuple[Tensor, Tensor]:
    """Coordinates and distances with short gaps on straight lines; where an angle changes its turn, it stays a gap."""
    seen = torch.isfinite(error).any(1)
    index = torch.arange(len(q))
    before = torch.where(seen, index, -1).cummax(0).values
    after = torch.where(seen, index, len(q)).flip(0).cummin(0).values.flip(0)
    short = ~seen & (before >= 0) & (after < len(q)) & (after - before <= longest + 1)
    at = short.nonzero()[:, 0]
    a, b = before[at], after[at]
    near = ((q[b] - q[a]).abs() < math.pi).all(1)
    at, a, b = at[near], a[near], b[near]
    q, error = q.clone(), error.clone()
    q[at] = torch.lerp(q[a], q[b], ((at - a).to(q) / (b - a).to(q))[:, None])
    error[at] = error[a]
    return q, error


def _held(q: Float[Tensor, "frames dofs"], seen: Tensor) -> Float[Tensor, "frames dofs"]:
    """Coordinates, those of frames that are not seen as in the seen frame before, or the first one."""
    index = torch.arange(len(q))
    last = torch.where(seen, index, -1).cummax(0).values
    return q[torch.where(last < 0, int(seen.nonzero()[0]), last)]
