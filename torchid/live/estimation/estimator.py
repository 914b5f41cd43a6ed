"""Inertial parameters from rows as they come, in information form."""

import logging
import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import BLOCK, SHORTEST, WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, accumulate, estimate_whitening, initial_whitening, spectrum
from torchid.errors import DataError
from torchid.inertia.fit import InertiaFit, fit_inertia
from torchid.inertia.identify import Identified, determined, identify_spectra
from torchid.inertia.options import IdentifyOptions, of_whitened_rows
from torchid.inertia.reliability import NoiseGram, calibrated, reliability
from torchid.model.model import InertialPrior
from torchid.runs import runs


class Gatherer:
    """Rows of the frames since the last one that could not be used, in blocks of at most ``BLOCK`` frames.

    A block of a second would hold its mean and little that is slow: the stream would weigh the same frames otherwise
    than a run does, and find other masses where the model is not exact.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self._rows: list[tuple[Tensor, Tensor]] = []
        self._frames, self._begun_s = 0, 0.0
        self._rate = self._cutoff_hz = 1.0
        self.frames = 0
        """Number of all frames in blocks that are complete."""

    def add(self, rows: WrenchTrial) -> list[tuple[float, BlockSpectrum]]:
        """Take in frames that follow the last ones, and return the blocks that are complete, by their middle [s]."""
        self._rate, self._cutoff_hz = rows.rate, rows.motion.smoother.cutoff_hz
        done: list[tuple[float, BlockSpectrum]] = []
        for start, stop in runs(rows.used):
            done += self.close() if start > 0 else []
            while start < stop:
                end = min(stop, start + BLOCK - self._frames)
                self._take(rows, slice(start, end))
                done += self.close() if self._frames == BLOCK else []
                start = end
        return done + ([] if bool(rows.used[-1]) else self.close())

    @property
    def open(self) -> BlockSpectrum | None:
        """Return the block that still grows; None where it is too short to count."""
        if self._frames < SHORTEST:
            return None
        Y, F = (torch.cat(part, -1) for part in zip(*self._rows, strict=True))
        return spectrum(Y, F, self._rate, self._cutoff_hz)

    def close(self) -> list[tuple[float, BlockSpectrum]]:
        """End the block that grows, and return it where it counts."""
        block, middle_s = self.open, self._begun_s + 0.5 * self._frames / self._rate
        self.frames += 0 if block is None else self._frames
        self._rows, self._frames = [], 0
        return [] if block is None else [(middle_s, block)]

    def _take(self, rows: WrenchTrial, part: slice) -> None:
        if not self._frames:
            self._begun_s = float(rows.motion.time[part.start])
        self._rows.append(rows.rows(part))
        self._frames += part.stop - part.start


log = logging.getLogger(__name__)
EAGER = 8
"""Choice. Blocks up to which the noise is estimated anew with every one; ..."""
GROWTH = 1.25
"""Choice. ... later whenever there are so many times as many: all sums are then made anew, so that they take, over a
session, five times the work of a single pass."""


class Estimator:
    """The inertial fit of a stream: physical parameters after every block of rows, with the noise that they show.

    The state is the sum of all whitened rows, to which new ones are added: the estimate is the batch solution at any
    moment (Simon, Optimal State Estimation (2006), section 11.2), and with the prior its covariance is positive
    definite whatever comes. Memory grows by the blocks' spectra alone, 60 kB for a second of rows.
    """

    def __init__(
        self, names: tuple[str, ...], prior: InertialPrior, options: IdentifyOptions, mass: tuple[float, float] | None,
        com_box: Float[Tensor, "bodies 2 3"] | None = None, half_life_s: float = math.inf,
    ) -> None:  # fmt: skip
        """Begin with the prior alone.

        Args:
            mass: total mass and its standard deviation [kg]; None where nothing but the prior tells it.
            com_box: as for ``fit_inertia``.
            half_life_s: time after which a row counts half, for a body that changes.
        """
        self._names, self.prior, self._mass, self._box = names, prior, mass, com_box
        self._options = of_whitened_rows(options)
        self._lenient = replace(self._options, refuse=False, base_parameters=False)
        self._half_life_s, self._now_s = half_life_s, 0.0
        self.blocks: list[BlockSpectrum] = []
        self.times: list[float] = []
        """Middle of each block [s]."""
        self.whitening, self._refreshed = initial_whitening(prior.mean), 0
        self._growing: BlockSpectrum | None = None
        self._done: NormalEquations | None = None
        self.sums: NormalEquations | None = None
        """Of all rows, those of the growing run included, as far as they count at present."""
        self.fit: InertiaFit | None = None

    def add(
        self, blocks: Sequence[tuple[float, BlockSpectrum]], growing: BlockSpectrum | None = None, now_s: float = 0.0
    ) -> None:  # fmt: skip
        """Take in rows, and find the physical parameters that they ask for.

        Args:
            blocks: runs of frames in the frequency domain, complete, each with its middle [s].
            growing: a run that is not complete, in the place of the one that was given before.
            now_s: time of the newest rows [s].
        """
        if not blocks and growing is None and self._growing is None:
            return
        if self._done is not None and math.isfinite(self._half_life_s):
            self._done = self._done.faded(0.5 ** ((now_s - self._now_s) / self._half_life_s))
        self._now_s, self._growing = now_s, growing
        new = slice(len(self.blocks), None)
        self.times += [time_s for time_s, _ in blocks]
        self.blocks += [block for _, block in blocks]
        self._done = _sum(self._done, self._sums(new))
        self._fit()

    def finished(self, noise: NoiseGram | None = None) -> Identified:
        """Return what all rows find; with a half-life, what those find that count.

        Args:
            noise: of the motion in the regressors of all rows, which is taken out in proportion; None: the motion is
                taken for exact.

        Raises:
            DataError: there are no rows, or the fit is not accepted.
        """
        if not self.blocks:
            raise DataError(
                "live.no_rows", "no frame had all contact on the plates and a known posture",
                found="no rows", remedy="Stand and move with both feet on the plates",
            )  # fmt: skip
        if math.isinf(self._half_life_s):
            return identify_spectra(
                [self.blocks], self._names, self.prior, self._options, self._mass, self._box, noise
            )  # fmt: skip
        assert self.sums is not None
        seen, R = self.sums, None
        if noise is not None:
            every = accumulate(self.blocks, self.whitening)
            R = reliability([every], noise(self.whitening), self.prior.covariance)
        sums = seen if R is None else calibrated(seen, R)
        fit = fit_inertia(
            sums, self.prior, self._names, self._options, mass=self._mass, com_box=self._box, as_seen=seen
        )
        return Identified(fit, self.whitening, int(seen.rows), sums, R)

    @property
    def share(self) -> float:
        """Return the share of all rows that counts; 1 without a half-life."""
        every = sum(block.F.numel() for block in self.blocks)
        return 1.0 if self.sums is None or math.isinf(self._half_life_s) else float(self.sums.rows) / every

    def _fit(self) -> None:
        """Find the parameters anew, with the noise estimated anew where there is much more than the last time."""
        self._total()
        if self.sums is None:
            return
        count = len(self.blocks)
        if self.fit is not None and (count <= EAGER or count >= GROWTH * self._refreshed):
            self._refresh(self.fit)
        try:
            self.fit = fit_inertia(
                self.sums, self.prior, self._names, self._lenient, mass=self._mass, com_box=self._box
            )
        except DataError as error:  # the fit stays that of the blocks before
            log.warning("after %d blocks: %s", count, error)

    def _refresh(self, fit: InertiaFit) -> None:
        """Noise from the residuals of all blocks that count, and all sums under it."""
        phi, growing = fit.phi.reshape(-1), self._growing
        count = [block for block, time_s in zip(self.blocks, self.times, strict=True) if self._weight(time_s) >= 0.5]
        every = count if growing is None else [*count, growing]
        if every:  # of a body that has changed, old rows tell no noise
            self.whitening = estimate_whitening(((block, phi) for block in every), determined(fit))
        self._done, self._refreshed = self._sums(slice(0, None)), len(self.blocks)
        self._total()

    def _weight(self, time_s: float) -> float:
        return 0.5 ** ((self._now_s - time_s) / self._half_life_s)

    def _sums(self, part: slice) -> NormalEquations | None:
        """Sums of some blocks, as far as they count."""
        blocks, times = self.blocks[part], self.times[part]
        if not blocks:
            return None
        if math.isinf(self._half_life_s):
            return accumulate(blocks, self.whitening)
        own = [
            accumulate([block], self.whitening).faded(self._weight(t)) for block, t in zip(blocks, times, strict=True)
        ]
        return sum(own[1:], own[0])

    def _total(self) -> None:
        """Sums of what is complete and of what grows."""
        self.sums = _sum(self._done, None if self._growing is None else accumulate([self._growing], self.whitening))


def _sum(first: NormalEquations | None, second: NormalEquations | None) -> NormalEquations | None:
    if first is None or second is None:
        return second if first is None else first
    return first + second
