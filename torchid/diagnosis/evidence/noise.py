"""Noise of forces and markers under a model, and the sums that it weighs."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.design import Design, Terms
from torchid.diagnosis.evidence.per_trial import TrialPosterior, trial_posteriors
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.spectra import TrialSpectra
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics
from torchid.observation.marker_bands import BANDS
from torchid.regressor.equations import NormalEquations
from torchid.regressor.whitening import BlockSpectrum, Whitening, accumulate, estimate_whitening

ROUNDS = 2
"""Estimates of the noise before any effect is chosen; one less afterwards."""
COMMON = 60.0
"""Values of all trials that speak for the noise of each: a second of walking tells little of its own."""


@dataclass(frozen=True)
class Noise:
    """Of forces: a covariance in each band; of markers: a factor of their variance in each of theirs."""

    forces: Whitening
    """Of a typical trial."""
    markers: Float[Tensor, " bands"]
    trials: Float[Tensor, " trials"]
    """Variance of each trial's forces against that: what a landing leaves must not hide what squats show."""

    def of(self, trial: int) -> Whitening:
        """Of the forces of one trial."""
        return Whitening(self.trials[trial] * self.forces.covariance)

    def typical(self, trials: int) -> "Noise":
        """Of trials that nobody has seen yet."""
        return replace(self, trials=self.trials.new_ones(trials))


def initial_noise(whitening: Whitening, trials: int) -> Noise:
    """Of the inertial fit, the same in all trials; markers as they scatter."""
    one = whitening.covariance.new_ones(())
    return Noise(whitening, one.expand(BANDS), one.expand(trials))


def summed(rows: Sequence[TrialSpectra], prior: Prior, design: Design, noise: Noise) -> Statistics:
    """Forces and markers of every trial under their noise."""
    return _together((standardised(own, prior, design, noise, k) for k, own in enumerate(rows)), design)


def unforced(rows: Sequence[TrialSpectra], prior: Prior, design: Design, noise: Noise) -> Statistics:
    """Markers of every trial alone."""
    seen = (replace(own, terms=replace(own.terms, unloaded=None)) for own in rows)
    return _together((_without_rows(own, prior, design, noise) for own in seen), design)


def _together(trials: Iterable[tuple[TrialStatistics, float]], design: Design) -> Statistics:
    found = list(trials)
    return Statistics(design.base, design.shared, tuple(raw for raw, _ in found), sum((c for _, c in found), start=0.0))


def standardised(
    rows: TrialSpectra, prior: Prior, design: Design, noise: Noise, trial: int
) -> tuple[TrialStatistics, float]:
    """Sums of one trial, and the log density of its rows but for what models of one noise differ in."""
    whitening = noise.of(trial)
    forces = accumulate(rows.forces, whitening)
    if rows.terms.noise_scores is not None:
        more = torch.einsum("bij,bijc->c", torch.linalg.inv(whitening.covariance), rows.terms.noise_scores)
        forces = replace(forces, moment=forces.moment + more)
    volume = sum(whitening.log_determinant(block.band) for block in rows.forces)
    return _standard(forces, volume, rows.terms, prior, design, noise)


def _without_rows(rows: TrialSpectra, prior: Prior, design: Design, noise: Noise) -> tuple[TrialStatistics, float]:
    """Of one trial, its rows of forces left out."""
    n = len(rows.terms.live)
    none = NormalEquations(prior.mean.new_zeros(n, n), prior.mean.new_zeros(n), 0.0, 0)
    return _standard(none, 0.0, rows.terms, prior, design, noise)


def _standard(
    forces: NormalEquations, volume: float, terms: Terms, prior: Prior, design: Design, noise: Noise
) -> tuple[TrialStatistics, float]:
    """With markers and idle plates; the Gram matrix and moment of the forces are used up."""
    gram, moment, k, square = forces.gram, forces.moment, design.marker_columns, forces.square
    if terms.markers is not None:
        weight, markers = noise.markers.reciprocal(), terms.markers
        gram[k, k] += (weight @ markers.gram.flatten(1)).view_as(gram[k, k])
        moment[k] += weight @ markers.moment
        square += float(weight @ markers.energy)
        volume += float(markers.count @ noise.markers.log())
    if terms.unloaded is not None:
        at = terms.unloaded.columns
        gram[at[:, None], at] += terms.unloaded.gram
        moment[at] += terms.unloaded.moment
    mean = prior.mean[terms.live]
    away = square - 2.0 * float(moment @ mean) + float(mean @ gram @ mean)
    return prior.standard(gram, moment, terms.live), -0.5 * (away + volume)


def estimate_noise(
    rows: Sequence[TrialSpectra],
    prior: Prior,
    design: Design,
    chosen: Sequence[Candidate],
    start: Noise,
    statistics: Statistics | None = None,
) -> Noise:
    """Of what the model with the chosen effects leaves: noise estimated without them would hold them.

    Args:
        rows: of every trial.
        prior: of all columns.
        design: better without what is not chosen.
        chosen: effects.
        start: noise to begin with.
        sums: of the same rows under it, where they are at hand.
    """
    noise = start
    for _ in range(ROUNDS - bool(chosen)):
        statistics = statistics or summed(rows, prior, design, noise)
        theta, left, lost = _left_by(
            list(trial_posteriors(statistics, chosen)), rows, statistics.trials, prior, design, noise
        )
        trials = _relative(left, lost, rows, noise.forces)
        scaled = [(_scaled(b, s.rsqrt()), s[:0]) for some, s in zip(left, trials[:, None], strict=True) for b in some]
        forces = _at_least(estimate_whitening(scaled, sum(lost)), rows, trials)
        noise, statistics = Noise(forces, _dispersion(rows, design, theta), trials), None
    return noise


def unseen_noise(
    rows: Sequence[TrialSpectra],
    prior: Prior,
    design: Design,
    chosen: Sequence[Candidate],
    noise: Noise,
    statistics: Statistics,
) -> Noise:
    """Of trials that the noise was not estimated on: each is as loud as the model leaves it.

    A held-out landing at the noise of squats would speak for or against anything.

    Args:
        rows: of these trials.
        prior: of all columns.
        design: of the chosen effects, and of what may stand for them.
        chosen: effects.
        noise: of the trials before them, under which ``sums`` are; it gives these a loudness of one.
        sums: of other trials, and of these behind them.
    """
    n = len(rows)
    _, left, lost = _left_by(
        list(trial_posteriors(statistics, chosen))[-n:], rows, statistics.trials[-n:], prior, design, noise
    )
    return replace(noise, trials=_loudness(left, lost, rows, noise.forces)[0].exp())


def _left_by(
    posterior: Sequence[TrialPosterior],
    rows: Sequence[TrialSpectra],
    raws: Sequence[TrialStatistics],
    prior: Prior,
    design: Design,
    noise: Noise,
) -> tuple[list[Tensor], list[list[BlockSpectrum]], list[float]]:
    """Parameters of each trial, what they leave of its forces, and how many degrees of freedom those gave them."""
    theta = [prior.theta(one.z(len(prior.mean))) for one in posterior]
    each = zip(posterior, rows, raws, strict=True)
    # What markers determine takes nothing from the forces: counted as lost, it made a short walk's noise infinite.
    lost = [one.lost(raw) - one.lost(_without_rows(own, prior, design, noise)[0]) for one, own, raw in each]
    left = [[_left(b, x[own.terms.live]) for b in own.forces] for own, x in zip(rows, theta, strict=True)]
    return theta, left, lost


def _left(block: BlockSpectrum, theta: Float[Tensor, " params"]) -> BlockSpectrum:
    """Residual of a block, which no column is to explain further."""
    return BlockSpectrum(block.Y[:, :0], block.F - theta @ block.Y, block.frequency)


def _scaled(block: BlockSpectrum, by: Tensor) -> BlockSpectrum:
    return replace(block, F=by * block.F)


def _relative(
    left: Sequence[Sequence[BlockSpectrum]], lost: Sequence[float], rows: Sequence[TrialSpectra], forces: Whitening
) -> Float[Tensor, " trials"]:
    """Loudness of each trial, one in their middle."""
    found, free = _loudness(left, lost, rows, forces)
    return torch.exp(found - (free * found).sum() / free.sum())


def _loudness(
    left: Sequence[Sequence[BlockSpectrum]], lost: Sequence[float], rows: Sequence[TrialSpectra], forces: Whitening
) -> tuple[Float[Tensor, " trials"], Float[Tensor, " trials"]]:
    """Logarithm of each trial's variance against ``forces``, drawn to what they have in common, and what it rests on.

    Args:
        left: residuals, means included.
        lost: degrees of freedom that the fit took from each trial.
        rows: of the trials.
        forces: some noise of all of them.
    """
    precision = torch.linalg.inv(forces.covariance)
    energy, free = precision.new_zeros(len(left)), precision.new_zeros(len(left))
    for k, blocks in enumerate(left):
        for block in blocks:
            F = block.F[:, 1:]
            energy[k] += torch.einsum("ik,kij,jk->", F, precision[block.band[1:]], F)
            free[k] += F.numel()
    least = torch.stack([_expected(own, forces, n) for own, n in zip(rows, free, strict=True)])
    free = (free - free.new_tensor(lost)).clamp(min=1.0)
    # By their logarithms: a landing's ten thousandfold energy must not stand for half of what a walk leaves.
    own = torch.maximum(energy / free, least).clamp(min=1e-12).log()
    return torch.lerp(own, (free * own).sum() / free.sum(), COMMON / (free + COMMON)), free


def _expected(rows: TrialSpectra, forces: Whitening, free: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """Variance against ``forces`` of what plates' and markers' noise alone would leave."""
    if rows.noise_budget is None:
        return torch.zeros_like(free)
    noise = rows.noise_budget.motion + rows.noise_budget.plates
    return (noise / torch.diagonal(forces.covariance, dim1=1, dim2=2)).sum() / free.clamp(min=1.0)


def _at_least(forces: Whitening, rows: Sequence[TrialSpectra], trials: Float[Tensor, " trials"]) -> Whitening:
    """No band is quieter than plates and markers are.

    A short walk has fewer rows than the model has parameters: left with nothing, its noise fell a thousandfold below
    that of the markers, and a tether had a million nats.
    """
    some = [(own.noise_budget, s) for own, s in zip(rows, trials, strict=True) if own.noise_budget is not None]
    if not some:
        return forces
    count = torch.stack([one.count for one, _ in some]).sum(0).clamp(min=1.0)
    energy = torch.stack([(one.motion + one.plates) / s for one, s in some]).sum(0)
    lacks = energy / count[:, None] - torch.diagonal(forces.covariance, dim1=1, dim2=2)
    return Whitening(forces.covariance + torch.diag_embed(lacks.clamp(min=0.0)))


def _dispersion(rows: Sequence[TrialSpectra], design: Design, theta: Sequence[Tensor]) -> Float[Tensor, " bands"]:
    """Of markers against the scatter that weighs them; one where none are at hand."""
    energy = count = least = torch.zeros(BANDS, dtype=theta[0].dtype)
    for own, x in zip(rows, theta, strict=True):
        if own.terms.markers is not None:
            energy = energy + own.terms.markers.left(x[design.marker_columns])
            count = count + own.terms.markers.count
            least = least + own.terms.markers.count * own.terms.markers.least
    return torch.where(count > 0.0, torch.maximum(energy, least) / count.clamp(min=1.0), 1.0).clamp(min=1e-6)
