"""Vibration above the cut-off: what the filter hides from every other look at the forces.

A motor on the body or beside the plates makes one line in the spectrum of the raw force, at the same frequency in every
trial. Noise of plates has no lines; those of a gait, which come in combs, are nobody's vibration.
"""

from collections.abc import Sequence
from dataclasses import replace

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.unexplained import P_VALUE, Structure
from torchid.diagnosis.watched import Watched
from torchid.regressor.whitening import QUIET

WIDTH_HZ, STEP_HZ, AROUND_HZ = 0.3, 0.1, 1.5
"""Of a line, between lines that are tried, and to either side of what a line is compared with."""
LONG_S = 3.0
"""Of a block of used frames that shows lines of that width."""
TRIALS = 3
"""That must show a line, and all of them must: two trials of walking share one of theirs by chance."""
LINE = 3.0
"""Times what is beside it that a line must have in every trial: two thirds of it are then not noise. In 48 sessions
without any the highest was 1.8, in one with a motor of 9 N it was 18."""
COMB = 2
"""Lines up to which they are a machine's and one of its harmonics; more are a gait's."""


def with_vibration(rest: Structure, watched: Sequence[Watched]) -> Structure:
    """What remains, with a line that stands above the cut-off in every trial."""
    spectra = [s for w in watched if (s := _spectrum(w)) is not None]
    if len(spectra) < TRIALS:
        return rest
    first = 1.2 * max(w.rows.motion.smoother.cutoff_hz for w in watched) + WIDTH_HZ
    at = torch.arange(first, min(QUIET[0] * w.rows.rate for w in watched), STEP_HZ, dtype=torch.float64)
    if len(at) < 2 * round(AROUND_HZ / STEP_HZ):
        return rest
    peak = torch.stack([_peaks(frequency, power, at) for frequency, power in spectra])
    height, k = peak.min(0).values.max(0)
    p = min(1.0, len(at) * float(scipy.stats.chi2.sf(_FREE * peak[:, k], _FREE).prod()))
    if float(height) < LINE or p > P_VALUE or _lines(peak.min(0).values) > COMB:
        return rest
    share = 1.0 - 1.0 / float(height)
    said = (
        f"a vibration of {float(at[k]):.1f} Hz, above what the filter leaves, stands out of the raw forces of every "
        f"trial, at least {float(height):.1f} times what is beside it"
    )
    if rest.significant:
        return replace(rest, description=f"{rest.description}; and {said}")
    return Structure(True, p, share, said)


_FREE = 3.0 * WIDTH_HZ * LONG_S
"""Degrees of freedom of a line's power, at least: three components, both quadratures, half of them under a window."""


def _spectrum(watched: Watched) -> tuple[Float[Tensor, " kept"], Float[Tensor, " kept"]] | None:
    """Power of the raw force over the longest block, under a Hann window; None where that is short."""
    part = max(watched.rows.blocks(), key=lambda p: p.stop - p.start, default=slice(0, 0))
    frames, rate = part.stop - part.start, watched.rows.rate
    if frames < LONG_S * rate:
        return None
    x = watched.raw[part]
    window = torch.hann_window(frames, dtype=x.dtype, device=x.device)
    power = torch.fft.rfft((x - x.mean(0)) * window[:, None], dim=0).abs().square().sum(1)
    return torch.fft.rfftfreq(frames, 1.0 / rate, dtype=x.dtype, device=x.device), power


def _peaks(
    frequency: Float[Tensor, " kept"], power: Float[Tensor, " kept"], at: Float[Tensor, " lines"]
) -> Float[Tensor, " lines"]:
    """Power of each line against the median of those around it."""
    near = (frequency[None] - at.to(frequency)[:, None]).abs() <= 0.5 * WIDTH_HZ + 1e-9
    line = (near * power).sum(1) / near.sum(1).clamp(min=1)
    n = round(AROUND_HZ / STEP_HZ)
    around = torch.nn.functional.pad(line[None], (n, n), mode="reflect")[0].unfold(0, 2 * n + 1, 1)
    return line / around.median(1).values.clamp(min=1e-300)


def _lines(peak: Float[Tensor, " lines"]) -> int:
    """How many stand out, those that touch counted once."""
    out = (peak > 0.5 * LINE).to(torch.int64)
    return int((out.diff() > 0).sum() + out[0])
