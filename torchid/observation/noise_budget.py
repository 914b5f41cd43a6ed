"""Expected energy of the markers' and plates' noise in the wrench, band by band, and the reliability of a noisy column.

Plates' noise is what their unloaded channels show; markers' noise is what a label does from one frame to the next
beyond what a person can. Draws of both pass the same chain as the recording (postures, filter, inverse dynamics).
"""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BAND_EDGES_HZ, band_of, coefficients, cosine_matrix, frequencies
from torchid.observation.reliability import Reliability, estimate_reliability

WHITE = 256
"""Resolution. Number of draws of white noise: their mean is 3 % uncertain in a band of eight coefficients."""
SCARCE = 0.05
"""Estimator. Chance of a residual that is as small as this beside the noise that is expected in it, the usual 5 %."""


@dataclass(frozen=True)
class NoiseBudget:
    """Energy of cosine coefficients in one trial, about the root's origin [N^2, N^2 m^2]; means of blocks are left
    out."""

    motion: Float[Tensor, "bands 6"]
    """Energy of the wrench that the markers' noise seems to need."""
    plates: Float[Tensor, "bands 6"]
    """Energy of the plates' noise behind the filter."""
    count: Float[Tensor, " bands"]
    """Number of coefficients in each band."""
    reliability: Reliability
    """Part of the wrench needed by the found motion that the true motion needs."""
    there: Float[Tensor, "bands 6"]
    """Part of the expected noise, 0 to 1, that the residual of the identified body has room for: markers that slide are
    no noise."""


def make_noise_budget(
    rows: WrenchTrial,
    needed: Float[Tensor, "frames 6"],
    noise_draws: Sequence[Float[Tensor, "frames 6"]],
    scatter: Float[Tensor, " 6"],
    left: Float[Tensor, "frames 6"],
) -> NoiseBudget:
    """Return the noise budget of one trial that cameras have seen.

    Args:
        rows: motion and measured wrench of the trial.
        needed: wrench that the found motion needs, about the root's origin [N, N m].
        noise_draws: what draws of the markers' noise add to it [N, N m].
        scatter: standard deviation of the plates' noise per frame, before the filter [N, N m].
        left: residual of the identified body about the root's origin [N, N m].
    """
    motion = torch.stack([energy(rows, x)[0] for x in noise_draws]).mean(0)
    read = passed(rows)[:, None] * scatter.square()
    frequency, own, *noise = zip(*_squares(rows, needed, *noise_draws), strict=True)
    mean = torch.stack([torch.cat(x) for x in noise]).mean(0)
    reliability = estimate_reliability(torch.cat(frequency), torch.cat(own), mean)
    own, count = energy(rows, left)
    room = own / (motion + read).clamp(min=1e-300) / _least(count)[:, None]
    return NoiseBudget(motion, read, count, reliability, room.clamp(max=1.0))


def _least(count: Float[Tensor, " bands"]) -> Float[Tensor, " bands"]:
    """Return the value below which the mean of ``count`` squares of unit normals falls with the chance ``SCARCE``."""
    found = scipy.stats.chi2.ppf(SCARCE, count.clamp(min=1.0).cpu().numpy()) / count.clamp(min=1.0).cpu().numpy()
    return torch.as_tensor(found).to(count)


def loudness(
    rows: WrenchTrial, needed: Float[Tensor, "frames 6"], noise_draws: Sequence[Float[Tensor, "frames 6"]]
) -> float:
    """Return the energy that noise adds to the needed force or moment, whichever is more, over the energy of the true
    one.

    Args:
        rows: motion and measured wrench of a trial.
        needed: wrench that the found motion needs, about the root's origin [N, N m].
        noise_draws: what draws of the markers' noise add to it [N, N m].
    """
    noise = torch.stack([energy(rows, x)[0] for x in noise_draws]).mean(0).sum(0).view(2, 3).sum(1)
    true = energy(rows, needed)[0].sum(0).view(2, 3).sum(1) - noise
    return float((noise / true.clamp(min=1e-300)).max())


def passed(rows: WrenchTrial) -> Float[Tensor, " bands"]:
    """Return the energy that the filter leaves of white noise of unit variance, the mean over ``WHITE`` draws.

    All draws serve every channel, so that chance does not favour one of them. The seed is the trial's name.

    Args:
        rows: trial whose filter and blocks are meant.
    """
    generator = torch.Generator().manual_seed(zlib.crc32(rows.name.encode()))
    white = torch.randn(len(rows.used), WHITE, generator=generator, dtype=torch.float64).to(rows.wrench)
    return energy(rows, rows.motion.smoother(white))[0].mean(1)


def _squares(rows: WrenchTrial, *several: Float[Tensor, "frames _"]) -> Iterator[tuple[Tensor, ...]]:
    """Yield frequencies [Hz] of a block's cosine coefficients but for the mean, and squares of the coefficients of
    each."""
    for part in rows.blocks():
        frames = part.stop - part.start
        kept = coefficients(rows, frames)
        C = cosine_matrix(frames, kept).to(several[0])
        yield frequencies(frames, kept, rows.rate)[1:].to(C), *((C @ x[part]).square()[1:] for x in several)


def energy(
    rows: WrenchTrial, x: Float[Tensor, "frames some"]
) -> tuple[Float[Tensor, "bands some"], Float[Tensor, " bands"]]:
    """Return the energy of the used frames' cosine coefficients in each band, and their number; means are left out.

    Args:
        rows: trial whose blocks of used frames are meant.
        x: columns on the clock of the trial.
    """
    found, count = x.new_zeros(len(BAND_EDGES_HZ) + 1, x.shape[1]), x.new_zeros(len(BAND_EDGES_HZ) + 1)
    for frequency, square in _squares(rows, x):
        band = band_of(frequency)
        found.index_add_(0, band, square)
        count.index_add_(0, band, torch.ones_like(square[:, 0]))
    return found, count
