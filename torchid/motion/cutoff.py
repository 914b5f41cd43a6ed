"""A cut-off frequency from the data: where the signal sinks into its own noise floor."""

import numpy as np
import scipy.signal
from jaxtyping import Float
from torch import Tensor

LOWEST, HIGHEST = 4.0, 20.0
"""Bounds [Hz]: below, steps of walking are lost; above, skin and soft tissue ring (Winter 2009, section 3.4)."""


def choose_cutoff(position: Float[Tensor, "frames markers 3"], rate_hz: float) -> float:
    """Cut-off [Hz] above which the typical marker holds noise only.

    The Welch spectrum of each coordinate is compared with its floor, the median of the uppermost third of the band;
    the cut-off is where the power falls to three times the floor, in the median over coordinates. A signal without a
    floor (filtered before) keeps the upper bound.

    Args:
        position: marker trajectories [m]; coordinates with gaps are left out.
        rate_hz: frames per second.
    """
    x = position.detach().cpu().numpy().reshape(len(position), -1)
    x = x[:, np.isfinite(x).all(axis=0)]
    if len(x) < 32 or x.shape[1] == 0:
        return min(6.0, HIGHEST)
    frequency, power = scipy.signal.welch(x, rate_hz, nperseg=min(len(x), 256), axis=0, detrend="linear")
    floor = np.median(power[2 * len(power) // 3 :], axis=0)
    above = power > 3.0 * floor
    last = len(power) - 1 - np.argmax(above[::-1], axis=0)
    return float(np.clip(np.median(frequency[last]), LOWEST, HIGHEST))
