"""Noise as it is: coloured, and different for forces and moments. Whitening in the frequency domain.

A cosine transform along a block's frames is one orthogonal mix of its rows, under which the linear model stays exact.
Filtered samples are far from independent (treating them so gave 54 % false alarms at a nominal 5 %); their cosine
coefficients nearly are. Coefficients above the filter's cut-off carry nothing and are dropped, so that a block of
512 frames shrinks to about sixty rows. Within a band the six channels share one covariance, estimated from the
residuals: it holds the plates' noise and what marker noise does to the regressor.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import scipy.fft
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import WrenchTrial

BAND_EDGES_HZ = (0.15, 0.4, 0.8, 1.3, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0)
"""Upper edges of the bands [Hz]; about equal ratios, each with enough coefficients in a minute of motion."""
BEYOND = 1.2
"""Coefficients up to this many cut-offs are kept."""
FLOOR = (0.5, 0.1)
"""Least noise of a force [N] and moment [N m] channel per coefficient: no plate is better."""
KEPT = 30_000
"""Frames of a trial up to which its spectra are kept in memory."""
TOGETHER = 3000
"""Rows whose products are summed at once."""
SHRINK = 10.0
"""Equivalent observations by which a band's covariance is drawn to its diagonal and to its neighbours."""
NEARNESS = 0.1
"""Weight of a band in its neighbour's level, of the next one this squared and so on. The mean of a short block stands
alone in the lowest band: at the level of all bands together, 28 kg m/s^2 of a runner's total mass went unnoticed."""


@lru_cache(maxsize=16)
def cosine_matrix(frames: int, kept: int) -> Float[Tensor, "kept frames"]:
    """First rows of the orthonormal DCT-II."""
    k = torch.arange(kept, dtype=torch.float64)[:, None]
    t = torch.arange(frames, dtype=torch.float64)[None]
    C = torch.cos(math.pi * (t + 0.5) * k / frames) * math.sqrt(2.0 / frames)
    C[0] /= math.sqrt(2.0)
    return C


QUIET = (0.2, 0.3)
"""Parts of the frame rate at which nobody moves and filters against aliases still let noise through."""


def white_scatter(
    x: Float[Tensor, "frames *channels"], band: tuple[float, float] = QUIET
) -> Float[Tensor, "*channels"]:
    """Standard deviation of the white noise of each channel, from a band (parts of the frame rate) of nothing else.

    The coefficients are those of ``cosine_matrix`` by a fast transform: here they are of a whole recording.
    """
    first, last = (round(2.0 * f * len(x)) for f in band)
    coefficients = torch.as_tensor(scipy.fft.dct(x.detach().cpu().numpy(), norm="ortho", axis=0)[first:last]).to(x)
    return (coefficients.square().median(0).values / 0.4549).sqrt()


@dataclass(frozen=True)
class BlockSpectrum:
    """Rows of one block in the frequency domain."""

    Y: Float[Tensor, "6 params kept"]
    F: Float[Tensor, "6 kept"]
    frequency: Float[Tensor, " kept"]

    @cached_property
    def band(self) -> Int[Tensor, " kept"]:
        """Of each coefficient."""
        return band_of(self.frequency)


@dataclass(frozen=True)
class Whitening:
    """Covariance of the six channels in each band."""

    covariance: Float[Tensor, "bands 6 6"]

    def __call__(self, block: BlockSpectrum) -> tuple[Float[Tensor, "rows params"], Float[Tensor, " rows"]]:
        """Rows of unit variance."""
        L = torch.linalg.cholesky(self.covariance)[block.band]
        both = torch.cat([block.Y.permute(2, 0, 1), block.F.T[:, :, None]], dim=2)
        white = torch.linalg.solve_triangular(L, both, upper=False)
        flat = white.reshape(-1, white.shape[2])
        return flat[:, :-1], flat[:, -1]

    def log_determinant(self, band: Int[Tensor, " kept"]) -> float:
        """Of the covariance of these coefficients."""
        return float(torch.logdet(self.covariance)[band].sum())


@dataclass(frozen=True)
class Spectra:
    """Blocks of a trial in the frequency domain, made anew in every pass: an hour of them would take 700 MB."""

    trial: WrenchTrial
    extra: Float[Tensor, "6 more frames"] | None = None
    """Columns behind those of the inertial parameters, about the root's origin."""

    def __iter__(self) -> Iterator[BlockSpectrum]:
        extra = self.extra
        return (
            block_spectrum(self.trial, part, None if extra is None else extra[:, :, part])
            for part in self.trial.blocks()
        )


def spectra(trial: WrenchTrial, extra: Float[Tensor, "6 more frames"] | None = None) -> Iterable[BlockSpectrum]:
    """All blocks of a trial in the frequency domain; those of a trial of usual length are kept."""
    several = Spectra(trial, extra)
    return list(several) if len(trial.used) <= KEPT else several


def block_spectrum(trial: WrenchTrial, part: slice, extra: Float[Tensor, "6 more own"] | None = None) -> BlockSpectrum:
    """One block in the frequency domain, with columns in its frames behind those of the inertial parameters."""
    Y, F = trial.rows(part)
    return spectrum(Y if extra is None else torch.cat([Y, extra], 1), F, trial.rate, trial.motion.smoother.cutoff_hz)


def spectrum(
    Y: Float[Tensor, "6 params frames"], F: Float[Tensor, "6 frames"], rate_hz: float, cutoff_hz: float
) -> BlockSpectrum:
    """Rows of frames in the frequency domain.

    Args:
        Y: regressor.
        F: wrench.
        cutoff_hz: of the filter that both have gone through.
    """
    frames = F.shape[1]
    kept = _kept(frames, rate_hz, cutoff_hz)
    C = cosine_matrix(frames, kept).to(F)
    return BlockSpectrum(Y @ C.T, F @ C.T, frequencies(frames, kept, rate_hz).to(F.device))


def column_spectra(trial: WrenchTrial, extra: Float[Tensor, "6 more frames"]) -> list[Float[Tensor, "6 more kept"]]:
    """Columns alone, block after block."""
    found = []
    for part in trial.blocks():
        frames = part.stop - part.start
        found.append(extra[:, :, part] @ cosine_matrix(frames, coefficients(trial, frames)).to(extra).T)
    return found


def coefficients(trial: WrenchTrial, frames: int) -> int:
    """Number of those of a block that the filter lets live."""
    return _kept(frames, trial.rate, trial.motion.smoother.cutoff_hz)


def _kept(frames: int, rate_hz: float, cutoff_hz: float) -> int:
    cutoff = min(cutoff_hz * BEYOND, 0.5 * rate_hz)
    return max(1, min(frames, math.ceil(2.0 * cutoff * frames / rate_hz)))


def frequencies(frames: int, kept: int, rate: float) -> Float[Tensor, " kept"]:
    """Of the coefficients [Hz]."""
    return 0.5 * rate * torch.arange(kept, dtype=torch.float64) / frames


def band_of(frequency: Float[Tensor, " kept"]) -> Int[Tensor, " kept"]:
    """Band of each frequency [Hz]."""
    return torch.bucketize(frequency, torch.tensor(BAND_EDGES_HZ).to(frequency))


def initial_whitening(like: Tensor) -> Whitening:
    """Before any residual is known: 10 N and 3 Nm in every band."""
    diagonal = like.new_tensor([10.0] * 3 + [3.0] * 3).square()
    return Whitening(torch.diag(diagonal).expand(len(BAND_EDGES_HZ) + 1, 6, 6).clone())


def estimate_whitening(fitted: Iterable[tuple[BlockSpectrum, Float[Tensor, " params"]]], lost: float) -> Whitening:
    """Covariance per band from the residuals.

    Args:
        fitted: blocks of the fit data, each with the parameters at which its residual is taken.
        lost: degrees of freedom that the fit took from the residuals, shared by the bands in proportion.
    """
    count, scatter, n = len(BAND_EDGES_HZ) + 1, torch.zeros(()), torch.zeros(())
    for block, phi in fitted:
        if not n.dim():
            scatter, n = phi.new_zeros(count, 6, 6), phi.new_zeros(count)
        # The mean of a block (k = 0) is left out: estimated from its own misfit it would excuse a wrong total mass.
        band, residual = block.band[1:], (block.F - phi @ block.Y)[:, 1:]
        scatter.index_add_(0, band, torch.einsum("ik,jk->kij", residual, residual))
        n.index_add_(0, band, torch.ones_like(band, dtype=n.dtype))
    free = (n * (1.0 - lost / (6.0 * n.sum()).clamp(min=1.0))).clamp(min=1e-9)
    return Whitening(_shrunk(scatter, free) + torch.diag(n.new_tensor([FLOOR[0]] * 3 + [FLOOR[1]] * 3).square()))


def _shrunk(scatter: Tensor, n: Tensor) -> Tensor:
    """Each band drawn to the diagonal of itself and the nearest bands that hold anything."""
    own = scatter / n.clamp(min=1e-9)[:, None, None]
    index = torch.arange(len(n), device=n.device)
    near = NEARNESS ** (index[:, None] - index).abs()
    level = (near.to(n) @ torch.diagonal(scatter, dim1=1, dim2=2)) / (near.to(n) @ n)[:, None]
    share = (n / (n + SHRINK))[:, None, None]
    return share * own + (1.0 - share) * torch.diag_embed(level)


def accumulate(blocks: Iterable[BlockSpectrum], whitening: Whitening) -> NormalEquations:
    """Whitened sums of all blocks."""
    total: NormalEquations | None = None
    for some in _together(whitening(block) for block in blocks):
        own = NormalEquations.from_rows(*(torch.cat(rows) for rows in zip(*some, strict=True)))
        total = own if total is None else total + own
    assert total is not None, "the caller makes sure that some frames are used"
    return total


def _together(blocks: Iterable[tuple[Tensor, Tensor]]) -> Iterator[list[tuple[Tensor, Tensor]]]:
    """Rows of several blocks, as many as make a product quick."""
    some, rows = [], 0
    for block in blocks:
        some.append(block)
        rows += len(block[1])
        if rows >= TOGETHER:
            yield some
            some, rows = [], 0
    if some:
        yield some
