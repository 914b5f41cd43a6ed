"""Runs of used frames as they grow: the blocks of a run, although its end is not known yet."""

import torch
from torch import Tensor

from torchid.dynamics.rows import BLOCK, SHORTEST, WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, spectrum
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
        self._rows, self._frames = [], 0
        return [] if block is None else [(middle_s, block)]

    def _take(self, rows: WrenchTrial, part: slice) -> None:
        if not self._frames:
            self._begun_s = float(rows.motion.time[part.start])
        self._rows.append(rows.rows(part))
        self._frames += part.stop - part.start
