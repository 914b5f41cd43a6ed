"""Noise of single markers, from what they do from one frame to the next beyond what a person can."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.dynamics.whitening import QUIET, cosine_matrix
from torchid.runs import runs

WINDOW = 64
"""Resolution. Number of frames whose energy is one piece of evidence on the noise."""
NEAR_HZ = (6.0, 10.0)
"""Estimator. Band beside the quiet one in which noise is looked at [Hz]: cameras' own filters cut above it, and the
noise of markers that were low-passed shows here."""
SEEN_LONG = 25
"""Resolution. Number of frames in a row that tell a marker's noise; the edges of gaps do not."""
ALIKE = 1.5
"""Estimator. Ratio up to which two estimates of a variance are taken for one: both rest on some ten coefficients of
each window, and scatter by as much."""
LEFT = 0.05
"""Resolution. Least share of a marker's noise that postures are assumed to leave."""


def marker_scatter(
    error: Float[Tensor, "markers 3 frames"],
    seen: Bool[Tensor, "markers frames"],
    kept: Float[Tensor, " markers"],
    rate_hz: float,
) -> Float[Tensor, "2 markers"]:
    """Noise of each marker's coordinates below ``NEAR_HZ`` (first row) and above (second row) [m].

    Both are standard deviations of the white noise that has as much energy in a band as is found there. Skin that
    trembles, or a filter of the cameras' own, leaves less above. A marker is looked at where it is seen longest, and
    takes the median of the others where it is hardly seen.

    Args:
        error: measured minus modelled places [m].
        kept: share of each marker's noise that postures leave.
    """
    bands = QUIET, (min(NEAR_HZ[0] / rate_hz, QUIET[0]), min(NEAR_HZ[1] / rate_hz, QUIET[1]))
    found = error.new_full((len(seen), 2), float("nan"))
    for k, own in enumerate(seen):
        start, stop = max(runs(own), key=lambda run: run[1] - run[0], default=(0, 0))
        if stop - start >= SEEN_LONG:
            found[k] = found.new_tensor([usual_variance(error[k, :, start:stop].T, band) for band in bands])
    quiet, near = torch.where(found.isnan(), found.nanmedian(0).values, found).nan_to_num().unbind(1)
    # Means of both where they agree: the larger of two is 8 % too large.
    alike = ~(near > ALIKE * quiet)
    both = torch.where(alike, 0.5 * (quiet + near), torch.stack([near, quiet])).sqrt()
    # Postures have taken their share of the noise, which is larger where few markers hold a limb.
    return both / kept.clamp(min=LEFT).sqrt()


def usual_variance(x: Float[Tensor, "frames 3"], band: tuple[float, float]) -> float:
    """Return the variance of white noise that has in a band what is there most of the time [m^2].

    The median over windows holds where a limb is lost for some frames, which fills every band of the whole. It is
    divided by the median of a chi-square variable over its mean (Wilson & Hilferty, PNAS 17:684 (1931)).

    Args:
        x: error of one marker [m].
        band: edges as parts of the frame rate.
    """
    length = min(WINDOW, len(x))
    first = round(2.0 * band[0] * length)
    # At a high frame rate, or in a short run, a narrow band may hold less than one coefficient.
    last = max(first + 1, round(2.0 * band[1] * length))
    C = cosine_matrix(length, last).to(x)[first:]
    energy = (C @ x.unfold(0, length, length).mT).square().flatten(1).mean(1)
    return float(energy.quantile(0.5)) / (1.0 - 2.0 / (9.0 * 3.0 * (last - first))) ** 3
