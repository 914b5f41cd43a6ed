"""Where and when the data suggest that something comes and goes: what is worth columns.

A proposal is no verdict. Each one stands among the others that could have been made (``odds``), so that looking for it
is paid for.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.marker_swaps import propose_swaps
from torchid.diagnosis.candidates.missing_motion import loosest_joints
from torchid.effects.effect import Effect
from torchid.effects.joints import MissingDof
from torchid.effects.place import Interval, Place
from torchid.effects.session import MovingGround
from torchid.observation.trial import TrialObservation
from torchid.regressor.rows import measured

WINDOWS = 2
"""Intervals proposed for each trial."""
CLOCK_HZ = 20.0
"""At which ends of intervals are looked for."""
SHORTEST_S = 0.2
LONGEST = 0.7
"""Part of a trial; what lasts longer is not an interval."""
PEAKS = 3
"""Frequencies proposed for ground that moves."""
AROUND, NEAR = 40, 5
"""Steps of the grid of frequencies to compare with, and that count as the same peak."""


def propose(effect: Effect, observed: Sequence[TrialObservation]) -> tuple[Place, ...]:
    """Places of an effect: all it names, those of its intervals, or those worth a closer look."""
    views = [w.view for w in observed]
    if effect.name == "marker_swap":
        return tuple(place for w in observed if w.response is not None for place in propose_swaps(w.response))
    if isinstance(effect, MissingDof):
        return loosest_joints(effect, observed)
    if isinstance(effect, MovingGround):
        return _shakes(effect, observed)
    if not effect.intermittent:
        return effect.places(views)
    found, places = [window for w in observed for window in windows(w)], effect.places(views)
    share = 1.0 / (len(places) * len(observed))
    return tuple(replace(place, when=(own,), odds=share * odds) for place in places for own, odds in found)


def unexplained(observed: TrialObservation) -> Float[Tensor, "frames 6"]:
    """Residual of the identified model, zero where frames are not used."""
    rows = observed.rows
    return torch.where(rows.used[:, None], measured(rows) - observed.needed(observed.phi.reshape(-1)), 0.0)


def _shakes(effect: MovingGround, observed: Sequence[TrialObservation]) -> tuple[Place, ...]:
    """Frequencies at which the residual forces of all trials stand out of their neighbours."""
    places = effect.places([w.view for w in observed])
    frequency = torch.tensor([place.grid["frequency_hz"] for place in places], dtype=torch.float64)
    power = torch.zeros_like(frequency)
    for w in observed:
        phase = 2.0 * torch.pi * frequency[:, None] * w.rows.motion.time
        force = unexplained(w)[:, :3]
        force = force - force.mean(0)
        power += (torch.cos(phase) @ force).square().sum(1) + (torch.sin(phase) @ force).square().sum(1)
    around = torch.nn.functional.pad(power[None], (AROUND, AROUND), mode="reflect")[0].unfold(0, 2 * AROUND + 1, 1)
    height = power / around.median(1).values.clamp(min=1e-12)
    best = []
    for _ in range(PEAKS):
        best.append(int(height.argmax()))
        height[max(0, best[-1] - NEAR) : best[-1] + NEAR + 1] = 0.0
    return tuple(replace(places[k], odds=1.0 / len(places)) for k in best)


def windows(observed: TrialObservation) -> list[tuple[Interval, float]]:
    """Intervals in which the residual's mean stands out most, with the odds of each among all there are.

    The scan statistic |sum of residuals|^2 / length over all pairs of ends, forces and moments each on the scale of
    their own scatter.
    """
    rows = observed.rows
    left = unexplained(observed)
    group = max(1, round(rows.rate / CLOCK_HZ))
    bins = len(left) // group
    bands = left[: bins * group].unflatten(0, (bins, group)).mean(1)
    scale = bands.abs().median(0).values.clamp(min=1e-9)
    bands = (bands - bands.median(0).values) / scale
    found, clock = [], group / rows.rate
    for _ in range(WINDOWS):
        a, b = _strongest(bands, round(SHORTEST_S / clock), int(LONGEST * bins))
        if b <= a:
            break
        t0 = float(rows.motion.time[0])
        found.append((Interval(rows.name, t0 + a * clock, t0 + b * clock), 2.0 / bins**2))
        bands[a:b] = 0.0
    return found


def _strongest(x: Float[Tensor, "bins 6"], shortest: int, longest: int) -> tuple[int, int]:
    statistics = torch.cat([x.new_zeros(1, 6), x.cumsum(0)])
    length = torch.arange(len(statistics))[None] - torch.arange(len(statistics))[:, None]
    power = (statistics[None] - statistics[:, None]).square().sum(2) / length.clamp(min=1)
    power[(length < shortest) | (length > longest)] = 0.0
    return divmod(int(power.argmax()), len(statistics)) if float(power.max()) > 0.0 else (0, 0)
