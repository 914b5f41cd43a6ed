"""The noise that a model leaves: of forces band by band, of each trial against the others, and of markers."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.noise import Noise
from torchid.diagnosis.evidence.per_trial import TrialPosterior, trial_posteriors
from torchid.diagnosis.evidence.spectra import TrialSpectra
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics
from torchid.dynamics.whitening import BlockSpectrum, Whitening, estimate_whitening
from torchid.observation.marker_bands import BANDS

ROUNDS = 2
"""Resolution. Number of estimates of the noise before any effect is chosen; one less afterwards."""
COMMON = 60.0
"""Estimator. Values of all trials that speak for the noise of each, a choice: as many as a second of walking has, which
tells little of its own."""


def estimate_noise(model: LinearModel, chosen: Sequence[Candidate]) -> Noise:
    """Return the noise of what a model with the chosen effects leaves; estimated without them, it would hold them.

    Args:
        model: model whose noise is where the estimate begins; better without the columns of what is not chosen.
        chosen: its effects.
    """
    for _ in range(ROUNDS - bool(chosen)):
        theta, left, lost = _left_by(list(trial_posteriors(model.statistics, chosen)), model, model.statistics.trials)
        trials = _relative(left, lost, model)
        scaled = [(_scaled(b, s.rsqrt()), s[:0]) for some, s in zip(left, trials[:, None], strict=True) for b in some]
        forces = _at_least(estimate_whitening(scaled, sum(lost)), model.rows, trials)
        model = model.with_noise(Noise(forces, _dispersion(model, theta), trials))
    return model.noise


def unseen_noise(model: LinearModel, chosen: Sequence[Candidate], beside: Statistics) -> Noise:
    """Return the noise of trials that it was not estimated on: each is as loud as the model leaves it.

    Args:
        model: model of these trials, under a noise that gives each a loudness of one.
        chosen: its effects.
        beside: statistics of the trials that the model was fitted to, and of these behind them.
    """
    n = len(model.rows)
    posteriors = list(trial_posteriors(beside, chosen))[-n:]
    _, left, lost = _left_by(posteriors, model, beside.trials[-n:])
    return replace(model.noise, trials=_loudness(left, lost, model)[0].exp())


def _left_by(
    posteriors: Sequence[TrialPosterior], model: LinearModel, statistics: Sequence[TrialStatistics]
) -> tuple[list[Tensor], list[list[BlockSpectrum]], list[float]]:
    """Return parameters of each trial, what they leave of its forces, and the degrees of freedom that those gave
    them."""
    theta = [model.prior.theta(one.z(len(model.prior.mean))) for one in posteriors]
    # What markers determine takes nothing from the forces.
    cameras = model.statistics_without_forces.trials
    each = zip(posteriors, statistics, cameras, strict=True)
    lost = [one.lost(own) - one.lost(seen) for one, own, seen in each]
    left = [[_left(b, x[own.terms.live]) for b in own.forces] for own, x in zip(model.rows, theta, strict=True)]
    return theta, left, lost


def _left(block: BlockSpectrum, theta: Float[Tensor, " params"]) -> BlockSpectrum:
    """Return the residual of a block, which no column is to explain further."""
    return BlockSpectrum(block.Y[:, :0], block.F - theta @ block.Y, block.frequency)


def _scaled(block: BlockSpectrum, by: Tensor) -> BlockSpectrum:
    """Return a block with its forces times a factor."""
    return replace(block, F=by * block.F)


def _relative(
    left: Sequence[Sequence[BlockSpectrum]], lost: Sequence[float], model: LinearModel
) -> Float[Tensor, " trials"]:
    """Return the loudness of each trial, one in their middle."""
    found, free = _loudness(left, lost, model)
    return torch.exp(found - (free * found).sum() / free.sum())


def _loudness(
    left: Sequence[Sequence[BlockSpectrum]], lost: Sequence[float], model: LinearModel
) -> tuple[Float[Tensor, " trials"], Float[Tensor, " trials"]]:
    """Return the logarithm of each trial's variance against ``Noise.forces``, and the degrees of freedom it rests on.

    Logarithms are drawn to what the trials have in common: a trial with a thousand times the energy of another must not
    outweigh it.

    Args:
        left: residuals, means included.
        lost: degrees of freedom that the fit took from each trial.
        model: model whose rows and noise they are.
    """
    rows, forces = model.rows, model.noise.forces
    precision = torch.linalg.inv(forces.covariance)
    energy, free = precision.new_zeros(len(left)), precision.new_zeros(len(left))
    for k, blocks in enumerate(left):
        for block in blocks:
            F = block.F[:, 1:]
            energy[k] += torch.einsum("ik,kij,jk->", F, precision[block.band[1:]], F)
            free[k] += F.numel()
    least = torch.stack([_expected(own, forces, n) for own, n in zip(rows, free, strict=True)])
    free = (free - free.new_tensor(lost)).clamp(min=1.0)
    # Logarithms are averaged: the loudest trial must not stand for most of what the others leave.
    own = torch.maximum(energy / free, least).clamp(min=1e-12).log()
    return torch.lerp(own, (free * own).sum() / free.sum(), COMMON / (free + COMMON)), free


def _expected(rows: TrialSpectra, forces: Whitening, free: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """Return the variance against ``Noise.forces`` that plates' and markers' noise alone would leave."""
    if rows.noise_budget is None:
        return torch.zeros_like(free)
    noise = rows.noise_budget.motion + rows.noise_budget.plates
    return (noise / torch.diagonal(forces.covariance, dim1=1, dim2=2)).sum() / free.clamp(min=1.0)


def _at_least(forces: Whitening, rows: Sequence[TrialSpectra], trials: Float[Tensor, " trials"]) -> Whitening:
    """Return the covariance with no band quieter than plates and markers are.

    A trial may have fewer rows than the model has parameters; what it leaves then says nothing of its noise.
    """
    some = [(own.noise_budget, s) for own, s in zip(rows, trials, strict=True) if own.noise_budget is not None]
    if not some:
        return forces
    count = torch.stack([one.count for one, _ in some]).sum(0).clamp(min=1.0)
    energy = torch.stack([(one.motion + one.plates) / s for one, s in some]).sum(0)
    lacks = energy / count[:, None] - torch.diagonal(forces.covariance, dim1=1, dim2=2)
    return Whitening(forces.covariance + torch.diag_embed(lacks.clamp(min=0.0)))


def _dispersion(model: LinearModel, theta: Sequence[Tensor]) -> Float[Tensor, " bands"]:
    """Return the variance of markers over the one that weighs them; one where no camera is at hand."""
    energy = count = least = torch.zeros(BANDS, dtype=theta[0].dtype)
    for own, x in zip(model.rows, theta, strict=True):
        if own.terms.markers is not None:
            energy = energy + own.terms.markers.left(x[model.design.marker_columns])
            count = count + own.terms.markers.count
            least = least + own.terms.markers.count * own.terms.markers.least
    return torch.where(count > 0.0, torch.maximum(energy, least) / count.clamp(min=1.0), 1.0).clamp(min=1e-6)
