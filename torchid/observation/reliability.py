"""What of a noisy column is to be believed: at each frequency, the part of its energy that is not noise.

A column with noise of its own predicts too much, the more the faster, and is found too small (regression calibration;
Carroll et al. 2006, Measurement Error in Nonlinear Models, chapter 4). The part is smooth in frequency: band
by band, too little would be left in the lower half of a band and too much in the upper one.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

STEP_HZ = 0.1
"""Between places at which it is told."""
NEAR = 0.05
"""Standard deviation of the neighbourhood, as a part of the frequency ..."""
COEFFICIENTS = 5.0
"""... and in coefficients: some twenty are averaged."""


@dataclass(frozen=True)
class Reliability:
    """Part of each channel to believe."""

    part: Float[Tensor, "places *channels"]
    """From zero frequency on, ``STEP_HZ`` apart."""

    def __call__(self, frequency: Float[Tensor, " kept"]) -> Float[Tensor, "kept *channels"]:
        """At some frequencies; the mean of a block, which comes first, is weight, and stays."""
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
    """From the coefficients of all blocks of a trial.

    Args:
        frequency: of each [Hz].
        energy: its square.
        noise: what is expected of noise in it.
    """
    top = float(frequency.max())
    place = torch.arange(int(top / STEP_HZ) + 2).to(frequency) * STEP_HZ
    width = NEAR * place + COEFFICIENTS * top / len(frequency)
    near = torch.exp(-0.5 * ((frequency - place[:, None]) / width[:, None]).square())
    noise, energy = (torch.tensordot(near, x, 1) for x in (noise, energy))
    return Reliability((1.0 - noise / energy.clamp(min=1e-300)).clamp(min=0.0))
