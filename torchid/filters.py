"""Zero-lag low-pass filters for uniformly sampled signals; one of them serves kinematics and forces alike."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.interpolate
import scipy.linalg
import scipy.signal
import torch
from jaxtyping import Float
from torch import Tensor

FilterKind = Literal["spline", "butterworth"]
ORDER = 3
"""Of the differences that the spline penalises: accelerations stay free at the ends of a trial."""
HALF_POWER = (np.sqrt(2.0) - 1.0) ** (1.0 / (2 * ORDER))
"""Ratio of the -3 dB frequency of 1 / (1 + (f / f0)^6) to f0."""
LEAST = 1e-12
"""Weight of a missing sample."""
TOGETHER = 2
"""Columns of a signal that are filtered and differentiated together, at least ..."""
ENTRIES = 1 << 17
"""... and as many as have no more samples than that: of short trials, one by one takes twice as long."""
BUTTERWORTH_PASS = 0.802
"""A 2nd-order Butterworth run both ways has -3 dB at this part of its design cut-off: (2^0.5 - 1)^0.25."""


@dataclass(frozen=True)
class Smoother:
    """A low-pass filter with -3 dB at ``cutoff_hz``.

    ``spline``: least squares with a penalty on third differences (Woltring 1986, quintic spline; Eilers 2003), whose
    response 1 / (1 + (f/f0)^6) is that of a 3rd-order Butterworth run both ways, but whose ends are natural and whose
    missing samples simply carry no weight. ``butterworth``: 2nd order, both ways, odd padding.
    """

    cutoff_hz: float
    rate_hz: float
    kind: FilterKind = "spline"

    def __call__(
        self, x: Float[Tensor, "frames *channels"], weight: Float[Tensor, " frames"] | None = None
    ) -> Float[Tensor, "frames *channels"]:
        """Filtered signal; samples of weight zero are bridged (their values are not read)."""
        if self.cutoff_hz >= 0.45 * self.rate_hz:
            return x
        flat = x.detach().cpu().numpy().reshape(len(x), -1)
        w = np.ones(len(x)) if weight is None else weight.detach().cpu().numpy()
        out = self._spline(flat, w) if self.kind == "spline" or w.min() <= 0.0 else self._butterworth(flat)
        return torch.as_tensor(out, dtype=x.dtype, device=x.device).reshape(x.shape)

    def response(self, frequency_hz: Float[Tensor, " some"]) -> Float[Tensor, " some"]:
        """Part of the amplitude that passes, away from ends and gaps."""
        if self.cutoff_hz >= 0.45 * self.rate_hz:
            return torch.ones_like(frequency_hz)
        spline = self.kind == "spline"
        f0, order = self.cutoff_hz / (HALF_POWER if spline else BUTTERWORTH_PASS), 2 * ORDER if spline else 4
        return 1.0 / (1.0 + (frequency_hz / f0) ** order)

    def _spline(self, x: np.ndarray, weight: np.ndarray) -> np.ndarray:
        known = weight[:, None] > 0.0
        if len(x) <= 2 * ORDER:
            return np.where(known, x, 0.0)
        f0 = self.cutoff_hz / HALF_POWER
        penalty = (2.0 * np.sin(np.pi * min(f0 / self.rate_hz, 0.5))) ** (-2.0 * ORDER)
        factor, out = _factor(penalty * _difference_bands(len(x)), weight), np.empty_like(x)
        for few in _groups(x):
            own = np.where(known, x[:, few], 0.0)
            mean = weight @ own / max(weight.sum(), LEAST)
            right = weight[:, None] * (own - mean)
            out[:, few] = scipy.linalg.cho_solve_banded((factor, False), right, overwrite_b=True, check_finite=False)
            out[:, few] += mean
        return out

    def _butterworth(self, x: np.ndarray) -> np.ndarray:
        design = min(self.cutoff_hz / BUTTERWORTH_PASS, 0.49 * self.rate_hz)
        sos = scipy.signal.butter(2, design, fs=self.rate_hz, output="sos")
        pad = min(len(x) - 1, int(3 * self.rate_hz / self.cutoff_hz))
        return scipy.signal.sosfiltfilt(sos, x, axis=0, padlen=pad).copy()


def _factor(bands: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Of the normal equations. A long gap leaves the solution to the penalty alone: a parabola between its sides.

    Where rounding errors are more than the penalty says of one, it is drawn to the signal's mean, by no more than it
    takes.
    """
    least = LEAST
    while True:
        own = bands.copy()
        own[-1] += np.where(weight > 0.0, weight, least)
        try:
            return scipy.linalg.cholesky_banded(own, overwrite_ab=True, check_finite=False)
        except np.linalg.LinAlgError:
            assert least < 1.0, "the penalty is positive semi-definite"
            least *= 10.0


def _groups(x: np.ndarray) -> Iterator[slice]:
    """A few columns at a time: the intermediates of a spline take several times the memory of its signal."""
    step = max(TOGETHER, ENTRIES // len(x))
    return (slice(k, k + step) for k in range(0, x.shape[1], step))


def _difference_bands(n: int) -> np.ndarray:
    """Upper bands (ORDER + 1, n) of D'D for differences of order ORDER."""
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((ORDER + 1, n))
    for i in range(ORDER + 1):
        for j in range(i, ORDER + 1):
            bands[ORDER - (j - i), j : n - ORDER + j] += stencil[i] * stencil[j]
    return bands


def differentiate(
    x: Float[Tensor, "frames *channels"], rate_hz: float
) -> tuple[Float[Tensor, "frames *channels"], Float[Tensor, "frames *channels"]]:
    """First and second time derivative of the quintic spline through the samples."""
    flat = x.detach().cpu().numpy().reshape(len(x), -1)
    time = np.arange(len(x)) / rate_hz
    found = np.empty((2, *flat.shape))
    for few in _groups(flat):
        spline = scipy.interpolate.make_interp_spline(time, flat[:, few], k=5)
        for k in (0, 1):
            found[k][:, few] = spline.derivative(k + 1)(time)
    first, second = (torch.as_tensor(y, dtype=x.dtype, device=x.device).reshape(x.shape) for y in found)
    return first, second
