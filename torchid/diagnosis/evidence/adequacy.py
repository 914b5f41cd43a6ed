"""Test of whether the residual holds more than noise, by a model of the noise that no residual has entered.

Every band of the residual has an expectation (``observation.noise_budget``). What exceeds it is structure, whatever its
name.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.options import AdequacyOptions
from torchid.dynamics.whitening import BAND_EDGES_HZ
from torchid.observation.noise_budget import NoiseBudget, energy
from torchid.observation.trial import TrialObservation

LEAST = 1e-150
"""Resolution. Energy that noise has at least; its square is still a number."""
KINDS = ("force", "moment")
"""Kinds of residual, in the order of the rows of ``Energy``."""


@dataclass(frozen=True)
class Adequacy:
    """Assessment of what remains when all that is named is taken out."""

    significant: bool
    """True if more remains than noise."""
    p_value: float
    """Chance of such a residual in the worst band, times the number of bands that were tried; NaN where it cannot be
    told."""
    share_of_residual: float
    """Part of that band's residual energy that noise does not explain, 0 to 1; NaN where it cannot be told."""
    description: str
    """Sentence on what remains; empty if that is noise."""
    beyond: bool = False
    """True if it lies where forces were not asked for causes: above the filter, or in what one named force leaves of
    itself."""


@dataclass(frozen=True)
class Energy:
    """Energy of the cosine coefficients of one trial [N^2, N^2 m^2], measured and expected, by kind and band."""

    trial: str
    """Name of the trial."""
    left: Float[Tensor, "kinds bands"]
    """Energy of the residual."""
    noise: Float[Tensor, "kinds bands"]
    """Energy that plates' and markers' noise is expected to have."""
    spread: Float[Tensor, "kinds bands"]
    """Half the variance of the energy of such noise."""
    count: Float[Tensor, " bands"]
    """Number of coefficients of one channel."""


def assess_adequacy(
    observed: Sequence[TrialObservation],
    left: Sequence[Float[Tensor, "frames 6"]],
    options: AdequacyOptions = AdequacyOptions(),
) -> Adequacy:
    """Return the assessment of the residuals of the extended model.

    The energy of a band, of channels as loud as they are, is compared with a chi-square variable of the same mean and
    variance (Satterthwaite, Biometrics Bulletin 2:110 (1946)).

    Args:
        observed: trials.
        left: residual of each about the root's origin [N, N m].
        options: thresholds from which on a residual is structure.
    """
    found = [_energy(w, w.noise_budget, r) for w, r in zip(observed, left, strict=True) if w.noise_budget is not None]
    if not found:
        return Adequacy(False, float("nan"), float("nan"), "cannot be told: no camera shows the noise")
    count = torch.stack([e.count for e in found]).sum(0)
    total = torch.stack([e.left for e in found]).sum(0)
    noise = torch.stack([e.noise for e in found]).sum(0)
    freedom = noise.square() / torch.stack([e.spread for e in found]).sum(0)
    worst, tried = None, 0
    for k, kind in enumerate(KINDS):
        for b in range(len(count)):
            if float(count[b]) < options.coefficients:
                continue
            tried += 1
            # Channels are as loud as they are (Satterthwaite, Biometrics Bulletin 2:110 (1946)).
            n, ratio = float(freedom[k, b]), float(total[k, b] / noise[k, b])
            p, share = float(scipy.stats.chi2.sf(n * ratio, n)), max(0.0, 1.0 - 1.0 / ratio)
            if worst is None or share > worst[1]:
                worst = p, share, kind, b
    if worst is None:
        return Adequacy(False, float("nan"), float("nan"), "cannot be told: too few seconds on plates")
    p, share, kind, b = min(1.0, worst[0] * tried), *worst[1:]
    significant = p < options.p_value and share > options.band_part
    return Adequacy(significant, p, share, _described(found, kind, b, share) if significant else "")


def _described(found: Sequence[Energy], kind: str, b: int, share: float) -> str:
    """Return a sentence on the band that noise explains least."""
    k = KINDS.index(kind)
    excess = {e.trial: float(e.left[k, b] / e.noise[k, b]) for e in found if float(e.count[b]) > 0.0}
    trial = max(excess, key=lambda name: excess[name])
    low, high = (0.0, *BAND_EDGES_HZ)[b], (*BAND_EDGES_HZ, float("inf"))[b]
    return (
        f"{100.0 * share:.0f} % of the residual {kind} between {low:g} and {high:g} Hz is more than the noise of "
        f"plates and markers; most in {trial}, {excess[trial]:.1f} times what noise makes"
    )


def _energy(observed: TrialObservation, noise: NoiseBudget, left: Float[Tensor, "frames 6"]) -> Energy:
    """Return the energy of one trial's residual and of its noise."""
    chance = (noise.motion + noise.plates).clamp(min=LEAST)
    parts = energy(observed.rows, left)[0], chance, chance.square() / noise.count.clamp(min=1.0)[:, None]
    own, noise_budget, spread = (x.unflatten(1, (2, 3)).sum(2).T for x in parts)
    return Energy(observed.rows.name, own, noise_budget, spread, noise.count)
