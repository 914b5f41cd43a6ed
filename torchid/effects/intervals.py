"""Intervals of a trial in which something comes and goes, as its residual suggests them.

A proposal is no verdict: each one stands among the others that could have been made (``Place.odds``), so that looking
for it is paid for.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.evidence import TrialEvidence
from torchid.effects.place import Interval, Place

WINDOWS = 2
"""Proposal. Intervals proposed for each trial."""
CLOCK_HZ = 20.0
"""Resolution. Rate of the averages among which ends of intervals are looked for [Hz]."""
SHORTEST_S, LONGEST = 0.2, 0.7
"""Proposal. Length of an interval [s], and part of a trial: what lasts longer is not an interval."""


def in_intervals(places: Sequence[Place], observed: Sequence[TrialEvidence]) -> tuple[Place, ...]:
    """Every place in each of the intervals that the residuals of the trials suggest, with the odds of both."""
    if not places:
        return ()
    found = [window for one in observed for window in windows(one)]
    share = 1.0 / (len(places) * len(observed))
    return tuple(replace(place, when=(own,), odds=share * odds) for place in places for own, odds in found)


def windows(observed: TrialEvidence) -> list[tuple[Interval, float]]:
    """Intervals in which the residual's mean stands out most, with the odds of each among all there are.

    The scan statistic is |sum of residuals|^2 / length over all pairs of ends, forces and moments each on the scale of
    their own scatter.
    """
    left, scene, rate = observed.residual(), observed.view.scene, observed.rate_hz
    group = max(1, round(rate / CLOCK_HZ))
    bins = len(left) // group
    bands = left[: bins * group].unflatten(0, (bins, group)).mean(1)
    scale = bands.abs().median(0).values.clamp(min=1e-9)
    bands = (bands - bands.median(0).values) / scale
    found, clock = [], group / rate
    for _ in range(WINDOWS):
        a, b = _strongest(bands, round(SHORTEST_S / clock), int(LONGEST * bins))
        if b <= a:
            break
        t0 = float(scene.time[0])
        found.append((Interval(scene.trial, t0 + a * clock, t0 + b * clock), 2.0 / bins**2))
        bands[a:b] = 0.0
    return found


def _strongest(x: Float[Tensor, "bins 6"], shortest: int, longest: int) -> tuple[int, int]:
    """First bin and end (exclusive) of the interval with the largest statistic; twice zero where there is none."""
    sums = torch.cat([x.new_zeros(1, 6), x.cumsum(0)])
    length = torch.arange(len(sums))[None] - torch.arange(len(sums))[:, None]
    power = (sums[None] - sums[:, None]).square().sum(2) / length.clamp(min=1)
    power[(length < shortest) | (length > longest)] = 0.0
    return divmod(int(power.argmax()), len(sums)) if float(power.max()) > 0.0 else (0, 0)
