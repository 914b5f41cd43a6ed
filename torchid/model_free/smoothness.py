"""What markers still show of quick motion: a filter takes away what nothing gives back."""

import math

import torch

from torchid.recording import Markers

BAND_HZ = 12.0, 20.0
"""Estimator. Frequencies that are looked at [Hz]: above what gait and exercises need, below what a camera's noise alone
shows."""
SMOOTH_MM = 0.01
"""Estimator. Content in that band below which markers of a moving person were low-passed [mm]: as recorded they had
0.03 to 1.2 in four laboratories, 0.0016 to 0.0025 where filtered before publication, 0.008 at most after 4 Hz."""
RECORDED_MM = 0.03
"""Estimator. The least of that content in markers as recorded [mm]; see ``SMOOTH_MM``."""
MOVING_MM = 20.0
"""Estimator. Scatter of a marker's place from which on a person moves [mm]."""
LONGEST_S = 40.0
"""Resolution. Seconds from the beginning that are looked at."""
FEWEST_S = 0.5
"""Choice. Seconds that all markers of a trial must be seen together."""


def smooth(markers: Markers) -> bool:
    """Return whether a moving person's markers have less quick motion than cameras record.

    Args:
        markers: of one trial.
    """
    moving, content = quickness(markers)
    return moving > MOVING_MM and content < SMOOTH_MM


def quickness(markers: Markers) -> tuple[float, float]:
    """Return how far the typical marker moves, and its content in ``BAND_HZ``, both [mm]; zero and NaN of too short
    a recording.

    Args:
        markers: of one trial; those that are seen throughout are looked at.
    """
    markers = markers.frames(slice(0, round(LONGEST_S * markers.rate)))
    whole = torch.isfinite(markers.position).all(2).all(0)
    x, rate = markers.position[:, whole].flatten(1), markers.rate
    low, high = BAND_HZ[0], min(BAND_HZ[1], 0.45 * rate)
    if len(x) < FEWEST_S * rate or not x.shape[1] or high <= low:
        return 0.0, math.nan
    line = torch.linspace(0.0, 1.0, len(x)).to(x)[:, None]
    window = torch.hann_window(len(x), periodic=False).to(x)[:, None]
    spectrum = torch.fft.rfft((x - x[0] - line * (x[-1] - x[0])) * window, dim=0)
    frequency = torch.fft.rfftfreq(len(x), 1.0 / rate).to(x)
    some = spectrum[(frequency >= low) & (frequency < high)]
    content = some.abs().square().mean(0).sqrt().median() / window.square().sum().sqrt()
    return 1e3 * float(x.std(0).median()), 1e3 * float(content)
