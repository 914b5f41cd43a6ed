"""Reliability of a noisy column: at each frequency, the part of its energy that is not noise.

A column with noise of its own predicts too much, the more the faster, and is found too small (regression calibration;
Carroll et al. 2006, Measurement Error in Nonlinear Models). The part is smooth in frequency: band by band, too little
would be left in the lower half of a band and too much in the upper one.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

STEP_HZ = 0.1
"""Resolution. Step between the frequencies at which reliability is estimated [Hz]."""
NEAR = 0.05
"""Estimator. Standard deviation of the neighbourhood over which energies are averaged, as a part of the frequency."""
COEFFICIENTS = 5.0
"""Estimator. Standard deviation of the neighbourhood at least, as a number of coefficients: some twenty are
averaged."""


@dataclass(frozen=True)
class Reliability:
    """Part of each channel to believe, 0 to 1, as a function of frequency."""

    part: Float[Tensor, "places *channels"]
    """Values from zero frequency on, ``STEP_HZ`` apart."""

    def __call__(self, frequency: Float[Tensor, " kept"]) -> Float[Tensor, "kept *channels"]:
        """Return the part at some frequencies of a block; it is one at the first of them, the block's mean, which is
        weight.

        Args:
            frequency: frequencies of the block's coefficients [Hz], zero first.
        """
        at = (frequency / STEP_HZ).clamp(max=len(self.part) - 1.000001)
        below = at.long()
        share = (at - below).view(-1, *[1] * (self.part.dim() - 1))
        found = torch.lerp(self.part[below], self.part[below + 1], share)
        found[0] = 1.0
        return found


def estimate_reliability(
    frequency: Float[Tensor, " coefficients"],
    energy: Float[Tensor, "coefficients *channels"],
    noise: Float[Tensor, "coefficients *channels"],
) -> Reliability:
    """Return the reliability by the coefficients of all blocks of a trial.

    Args:
        frequency: frequency of each coefficient [Hz].
        energy: square of each coefficient.
        noise: square that is expected of noise in it, in the same unit.
    """
    top = float(frequency.max())
    place = torch.arange(int(top / STEP_HZ) + 2).to(frequency) * STEP_HZ
    width = NEAR * place + COEFFICIENTS * top / len(frequency)
    near = torch.exp(-0.5 * ((frequency - place[:, None]) / width[:, None]).square())
    noise, energy = (torch.tensordot(near, x, 1) for x in (noise, energy))
    return Reliability((1.0 - noise / energy.clamp(min=1e-300)).clamp(min=0.0))
