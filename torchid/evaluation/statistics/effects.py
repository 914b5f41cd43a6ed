"""How large a difference is, and within which interval it lies: Welch's interval, widened by what the body adds.

The interval of a difference of means is d +- t(f) sqrt(SE^2 + s^2), with the standard error SE between units and the
degrees of freedom f of Welch (1947, Biometrika 34:28), and s the standard deviation of the difference over draws of the
body, in which an error that both conditions share has cancelled. The standardised difference is Hedges' g, with its
large-sample interval (Hedges & Olkin 1985, Statistical Methods for Meta-Analysis, eq. 5.15).
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy import stats
from scipy.optimize import root_scalar
from torch import Tensor

COVERAGE = 0.95
"""Choice. Of all intervals and bands."""
LIKELY = 4096
"""Choice. Intervals into which a distribution is cut: bounds of effects are then right to 1e-3 of themselves."""


@dataclass(frozen=True)
class Estimate:
    """A number of every column with its interval."""

    value: Float[Tensor, " columns"]
    sd: Float[Tensor, " columns"]
    """Standard error and draws together."""
    low: Float[Tensor, " columns"]
    high: Float[Tensor, " columns"]


def mean_of(
    units: Float[Tensor, "units columns"],
    draws: Float[Tensor, "draws units columns"] | None,
    coverage: float = COVERAGE,
) -> Estimate:
    """Mean over units.

    Args:
        units: NaN where a unit has no value.
        draws: the same with other bodies.

    Returns:
        The interval is NaN where there is one unit, which does not say how units scatter.
    """
    value, variance, freedom = _moments(units)
    body = _scatter(None if draws is None else draws.nanmean(1), value)
    return _interval(value, variance, body, freedom, coverage)


def difference_of(
    units: Float[Tensor, "units columns"],
    second: Bool[Tensor, " units"],
    draws: Float[Tensor, "draws units columns"] | None,
    coverage: float = COVERAGE,
) -> Estimate:
    """Mean of the second condition's units minus that of the first's.

    Args:
        units: NaN where a unit has no value.
        draws: the same with other bodies, each body the same in both conditions.
    """
    (a, va, fa), (b, vb, fb) = _moments(units[~second]), _moments(units[second])
    total = va + vb
    freedom = total.square() / (va.square() / fa.clamp(min=1.0) + vb.square() / fb.clamp(min=1.0)).clamp(min=1e-300)
    shift = None if draws is None else draws[:, second].nanmean(1) - draws[:, ~second].nanmean(1)
    return _interval(b - a, total, _scatter(shift, a), freedom, coverage)


def hedges(
    units: Float[Tensor, "units columns"], second: Bool[Tensor, " units"], coverage: float = COVERAGE
) -> Estimate:
    """Difference of means over the pooled standard deviation between units, corrected for few units.

    Args:
        units: NaN where a unit has no value.
    """
    (a, va, fa), (b, vb, fb) = _moments(units[~second]), _moments(units[second])
    na, nb = fa + 1.0, fb + 1.0
    pooled = ((fa * va * na + fb * vb * nb) / (fa + fb)).sqrt()
    g = (1.0 - 3.0 / (4.0 * (fa + fb) - 1.0)) * (b - a) / pooled
    sd = ((na + nb) / (na * nb) + g.square() / (2.0 * (na + nb))).sqrt()
    reach = float(stats.norm.ppf(0.5 + 0.5 * coverage)) * sd
    return Estimate(g, sd, g - reach, g + reach)


def hedges_paired(values: Float[Tensor, "subjects columns"], coverage: float = COVERAGE) -> Estimate:
    """Mean of paired differences over their standard deviation, corrected for few subjects.

    The interval is exact for normal differences: sqrt(n) mean / sd has a non-central t distribution with the
    non-centrality sqrt(n) times the effect (Cumming & Finch 2001, Educ Psychol Meas 61:532).

    Args:
        values: differences, NaN where a subject has none.

    Returns:
        NaN where fewer than three subjects have a value, of whom the correction leaves nothing; ``sd`` is what the
        interval's width would be made of by the normal distribution.
    """
    mean, variance, freedom = _moments(values)
    t = mean / variance.sqrt()
    bounds = [
        [_noncentrality(float(x), float(f), p) for x, f in zip(t, freedom, strict=True)]
        for p in (0.5 + 0.5 * coverage, 0.5 - 0.5 * coverage)
    ]
    scale = (1.0 - 3.0 / (4.0 * freedom - 1.0)) / (freedom + 1.0).sqrt()
    scale = torch.where(freedom > 1.0, scale, torch.nan)
    low, high = (scale * values.new_tensor(bound) for bound in bounds)
    return Estimate(scale * t, (high - low) / (2.0 * float(stats.norm.ppf(0.5 + 0.5 * coverage))), low, high)


def _noncentrality(t: float, freedom: float, chance: float) -> float:
    """Non-centrality with which a t is not exceeded by this chance; NaN where t is none.

    P(T <= t) = E Phi(t s - c) over the scatter s of a standard deviation: scipy's own distribution is NaN at large t.
    """
    if not (math.isfinite(t) and freedom >= 1.0):
        return math.nan
    size = _scatter_of_sd(freedom)
    reach = 10.0 + 10.0 * abs(t)
    return float(root_scalar(lambda c: stats.norm.cdf(t * size - c).mean() - chance, bracket=[-reach, reach]).root)


@cache
def _scatter_of_sd(freedom: float) -> np.ndarray:
    """A sample's standard deviation over the true one, at the middles of ``LIKELY`` equally likely intervals."""
    return np.sqrt(stats.chi2.ppf((np.arange(LIKELY) + 0.5) / LIKELY, freedom) / freedom)


def _moments(units: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, squared standard error and degrees of freedom of every column."""
    known = torch.isfinite(units)
    count = known.sum(0).to(units.dtype)
    mean = torch.where(known, units, 0.0).sum(0) / count
    squares = torch.where(known, units - mean, 0.0).square().sum(0)
    variance = torch.where(count > 1.0, squares / (count - 1.0).clamp(min=1.0) / count, torch.nan)
    return mean, variance, count - 1.0


def _scatter(draws: Float[Tensor, "draws columns"] | None, like: Tensor) -> Tensor:
    """Variance over draws, zero without any."""
    return torch.zeros_like(like) if draws is None else draws.var(0)


def _interval(value: Tensor, variance: Tensor, body: Tensor, freedom: Tensor, coverage: float) -> Estimate:
    """Interval of a value whose variance between units is told by ``freedom`` and that of the body is known."""
    total = variance + body
    # Satterthwaite: a part of the variance is known better than the other.
    better = torch.where(variance > 0.0, freedom * (total / variance.clamp(min=1e-300)).square(), torch.inf)
    better = better.clamp(min=1.0, max=1e6)
    t = value.new_tensor(stats.t.ppf(0.5 + 0.5 * coverage, better.cpu().numpy()))
    sd = total.sqrt()
    return Estimate(value, sd, value - t * sd, value + t * sd)
