"""What is ordinary among the places of an effect, and no discovery at any of them.

Skin slides under every marker, and where the arms are raised in one trial only, each marker of an arm sits elsewhere in
that trial. A marker that was knocked must stand out from what all the others do: against places whose parameters
scatter by chance, a few of them far, as Student's t has it (Lange, Little & Taylor, JASA 84 (1989)). How far is what
makes most of the places together likeliest, so that where cameras are all that errs, hardly anything is ordinary. Told
apart from noise alone, two or three markers were "moved" at 1.00 in three of four sessions with 8 mm of skin motion.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

FREEDOM = 3.0
"""Degrees, of Student's t: the least whose variance is finite."""
OUTLIERS = 0.2
"""Part of the places that may be anything: whatever is wrong at one shows at its neighbours, which share their bodies'
postures."""
SCALES = torch.logspace(-4.0, 0.0, 33, dtype=torch.float64)
"""Of the ordinary, against the prior of what is named, that are tried."""
WIDTHS = torch.logspace(-1.0, 4.0, 41, dtype=torch.float64)
"""Variances against the square of the scale of which Student's t is the mixture: beyond a hundred scales nothing is
ordinary, so that where cameras are all that errs, the tail of nothing does not reach markers that were moved."""


def background_evidence(told: Float[Tensor, "places n n"], left: Float[Tensor, "places n"]) -> Float[Tensor, " places"]:
    """Log evidence that each place has what is ordinary, over that it has nothing; zero where nothing is likelier.

    Args:
        told: information that the data hold of the parameters at each place, in units of their priors.
        left: moment of the same: what they would be estimated at is told^-1 left.
    """
    value, vector = torch.linalg.eigh(told)
    power = torch.einsum("pij,pi->pj", vector, left).square()
    value, widths = value.clamp(min=0.0), WIDTHS.to(told)
    scale = _scale(value, power)
    # Inverse gamma in the logarithm of the width, on a grid.
    weight = torch.log_softmax(-0.5 * FREEDOM * (widths.log() + 1.0 / widths), 0)
    return torch.logsumexp(_evidence(value, power, scale.square() * widths) + weight, 1).clamp(min=0.0)


def _scale(value: Float[Tensor, "places n"], power: Float[Tensor, "places n"]) -> Float[Tensor, ""]:
    """Likeliest of the ordinary, of most places: what stands out, and all that it drags along, is none of it."""
    scales = SCALES.to(value)
    most = math.log(1.0 - OUTLIERS) + _evidence(value, power, scales.square())
    out = math.log(OUTLIERS) + _evidence(value, power, scales.new_ones(1))
    return scales[torch.logaddexp(most, out).sum(0).argmax()]


def _evidence(
    value: Float[Tensor, "places n"], power: Float[Tensor, "places n"], variance: Float[Tensor, " tried"]
) -> Float[Tensor, "places tried"]:
    """Log evidence of parameters with such variances against their priors, over none."""
    variance = variance[:, None]
    grown = variance * value[:, None] + 1.0
    return 0.5 * (power[:, None] * variance / grown - grown.log()).sum(2)
