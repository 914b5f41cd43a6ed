"""Vibration above the cut-off, which the filter hides from every other look at the forces.

A motor on the body or beside the plates makes one line in the spectrum of the raw force, at the same frequency in every
trial. Noise of plates has no lines; those of a gait, which come in combs, are nobody's vibration.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.options import AdequacyOptions
from torchid.dynamics.whitening import BEYOND, QUIET
from torchid.observation.trial import TrialObservation
from torchid.runs import runs

WIDTH_HZ, STEP_HZ, AROUND_HZ = 0.3, 0.1, 1.5
"""Resolution. Widths of a line, steps between lines that are tried, and distance to either side up to which a line is
compared [Hz]."""
LONG_S = 3.0
"""Resolution. Time of used frames on end that shows lines of that width [s]."""


@dataclass(frozen=True)
class _Power:
    """Spectrum of one trial's raw force, under a Hann window."""

    frequency: Float[Tensor, " kept"]
    """Frequencies [Hz]."""
    power: Float[Tensor, " kept"]
    """Power, summed over the three components [N^2]."""
    free: float
    """Degrees of freedom of a line's power, if only one component has any."""


def with_vibration(
    rest: Adequacy, observed: Sequence[TrialObservation], options: AdequacyOptions = AdequacyOptions()
) -> Adequacy:
    """Return what remains, with a line that stands above the cut-off in every trial that is long enough.

    Args:
        rest: adequacy of the model, below the cut-off.
        observed: fit trials.
        options: thresholds of a line.
    """
    spectra = [s for w in observed if (s := _spectrum(w)) is not None]
    first = BEYOND * max(w.rows.motion.smoother.cutoff_hz for w in observed) + WIDTH_HZ
    last = min(QUIET[0] * w.rows.rate for w in observed)
    if len(spectra) < options.vibration_trials or last - first < 2.0 * AROUND_HZ:
        return rest
    at = torch.arange(first, last, STEP_HZ, dtype=torch.float64)
    peak = torch.stack([_peaks(one, at) for one in spectra]).min(0).values
    height, hz = float(peak.max()), float(at[peak.argmax()])
    p = min(1.0, len(at) * math.prod(_chance(height, one.free) for one in spectra))
    lines = len(runs(peak > options.vibration_line_part * options.vibration_ratio))
    if height < options.vibration_ratio or p > options.p_value or lines > options.vibration_lines:
        return rest
    said = (
        f"a vibration of {hz:.1f} Hz, above what the filter leaves, stands out of the raw forces of every trial of "
        f"{LONG_S:g} s or more, at least {height:.1f} times what is beside it"
    )
    if rest.significant:
        return replace(rest, description=f"{rest.description}; and {said}")
    return Adequacy(True, p, 1.0 - 1.0 / height, said, beyond=True)


def _chance(height: float, free: float) -> float:
    """Return the chance that noise alone stands so high over its median."""
    return float(scipy.stats.chi2.sf(height * scipy.stats.chi2.median(free), free))


def _spectrum(observed: TrialObservation) -> _Power | None:
    """Return the spectrum of the longest run of used frames; None where that is short."""
    start, stop = max(runs(observed.rows.used), key=lambda run: run[1] - run[0], default=(0, 0))
    frames, rate = stop - start, observed.rows.rate
    if frames < LONG_S * rate:
        return None
    x = observed.raw[start:stop]
    window = torch.hann_window(frames, dtype=x.dtype, device=x.device)
    power = torch.fft.rfft((x - x.mean(0)) * window[:, None], dim=0).abs().square().sum(1)
    frequency = torch.fft.rfftfreq(frames, 1.0 / rate, dtype=x.dtype, device=x.device)
    # Both quadratures, but neighbours share half of what they hold under the window.
    return _Power(frequency, power, WIDTH_HZ * frames / rate)


def _peaks(one: _Power, at: Float[Tensor, " lines"]) -> Float[Tensor, " lines"]:
    """Return the power of each line over the median of those around it."""
    near = (one.frequency[None] - at.to(one.frequency)[:, None]).abs() <= 0.5 * WIDTH_HZ + 1e-9
    line = (near * one.power).sum(1) / near.sum(1).clamp(min=1)
    n = round(AROUND_HZ / STEP_HZ)
    around = torch.nn.functional.pad(line[None], (n, n), mode="reflect")[0].unfold(0, 2 * n + 1, 1)
    return (line / around.median(1).values.clamp(min=1e-300)).to(at)
