"""Whether the residual holds more than noise, by a model of the noise that no residual has entered.

Every band of the residual has an expectation (``expected``). What exceeds it is structure, whatever its name.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.observation.noise_budget import NoiseBudget, energy
from torchid.observation.trial import TrialObservation
from torchid.regressor.whitening import BAND_EDGES_HZ

SHARE = 0.4
"""Part of a band's residual that noise does not explain, from which on it matters: two thirds as much as the noise.
Below, fits to other people's models and slightly coloured noise go as far."""
P_VALUE = 0.01
ENOUGH = 30
"""Coefficients below which a band tells nothing."""
LEAST = 1e-150
"""Energy that noise has at least; its square is a number still."""
KINDS = ("force", "moment")


@dataclass(frozen=True)
class Adequacy:
    """What remains when all that is named is taken out."""

    significant: bool
    p_value: float
    share_of_residual: float
    description: str
    beyond: bool = False
    """It lies where no cause was told, above the filter, or in what one named force leaves out of itself."""
    alone: bool = False
    """Too little to tell, and no other trial that could agree."""


@dataclass(frozen=True)
class Energy:
    """Of the cosine coefficients of one trial: measured and expected, by kind and band."""

    trial: str
    left: Float[Tensor, "kinds bands"]
    noise: Float[Tensor, "kinds bands"]
    spread: Float[Tensor, "kinds bands"]
    """Half the variance of the energy of such noise."""
    count: Float[Tensor, " bands"]


def assess_adequacy(
    observed: Sequence[TrialObservation], left: Sequence[Float[Tensor, "frames 6"]], others: int = 0
) -> Adequacy:
    """Judge the residuals of the extended model.

    Args:
        watched: trials.
        left: residual of each about the root's origin.
        others: number of trials that could agree beside them.
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
            if float(count[b]) < ENOUGH:
                continue
            tried += 1
            # Of channels as loud as they are (Satterthwaite, Biometrics Bulletin 2 (1946)).
            n, ratio = float(freedom[k, b]), float(total[k, b] / noise[k, b])
            p, share = float(scipy.stats.chi2.sf(n * ratio, n)), max(0.0, 1.0 - 1.0 / ratio)
            if worst is None or share > worst[1]:
                worst = p, share, kind, b
    if worst is None:
        return _untold(len(observed) + others)
    p, share, kind, b = min(1.0, worst[0] * tried), *worst[1:]
    significant = p < P_VALUE and share > SHARE
    return Adequacy(significant, p, share, _described(found, kind, b, share) if significant else "")


def _untold(trials: int) -> Adequacy:
    """Too few frames for any band. A single trial of 27 found a clock to be 18 ms off with certainty."""
    said = "cannot be told: too few seconds on plates"
    if trials == 1:
        said += ", and no other trial could agree with what forces tell"
    return Adequacy(False, float("nan"), float("nan"), said, alone=trials == 1)


def _described(found: Sequence[Energy], kind: str, b: int, share: float) -> str:
    k = KINDS.index(kind)
    excess = {e.trial: float(e.left[k, b] / e.noise[k, b]) for e in found if float(e.count[b]) > 0.0}
    trial = max(excess, key=lambda name: excess[name])
    low, high = (0.0, *BAND_EDGES_HZ)[b], (*BAND_EDGES_HZ, float("inf"))[b]
    return (
        f"{100.0 * share:.0f} % of the residual {kind} between {low:g} and {high:g} Hz is more than the noise of "
        f"plates and markers; most in {trial}, {excess[trial]:.1f} times what noise makes"
    )


def _energy(observed: TrialObservation, noise: NoiseBudget, left: Float[Tensor, "frames 6"]) -> Energy:
    chance = (noise.motion + noise.plates).clamp(min=LEAST)
    parts = energy(observed.rows, left)[0], chance, chance.square() / noise.count.clamp(min=1.0)[:, None]
    own, noise_budget, spread = (x.unflatten(1, (2, 3)).sum(2).T for x in parts)
    return Energy(observed.rows.name, own, noise_budget, spread, noise.count)
