"""Evidence of what is ordinary among the places of an effect, and no discovery at any of them.

Skin slides under every marker, and where the arms are raised in one trial only, each marker of an arm sits elsewhere in
that trial. A marker that was knocked must stand out from what all the others do: against places whose parameters
scatter by chance, a few of them far, as Student's t has it (Lange, Little & Taylor, JASA 84:881 (1989)). The scale is
the one that makes most of the places together likeliest, so that where cameras are all that errs, hardly anything is
ordinary.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.evidence.spread import eigen_powers, evidence_of_variances

FREEDOM = 3.0
"""Estimator. Degrees of freedom of Student's t: the least whole number whose variance is finite, a choice."""
OUTLIERS = 0.2
"""Estimator. Part of the places that may be anything, a choice: whatever is wrong at one shows at its neighbours, which
share their bodies' postures."""
SCALES = torch.logspace(-4.0, 0.0, 33, dtype=torch.float64)
"""Resolution. Scales of the ordinary that are tried, against the prior of what is named."""
WIDTHS = torch.logspace(-1.0, 4.0, 41, dtype=torch.float64)
"""Resolution. Variances, against the square of the scale, of which Student's t is the mixture. Beyond a hundred scales
nothing is ordinary, so that where cameras are all that errs, its tail does not reach markers that were moved."""


def background_evidence(told: Float[Tensor, "places n n"], left: Float[Tensor, "places n"]) -> Float[Tensor, " places"]:
    """Return the log evidence that each place has what is ordinary, over having nothing [nat]; at least zero.

    Args:
        told: information that the data hold of the parameters at each place, in units of their priors.
        left: moment of the same: the parameters would be estimated as told^-1 left.
    """
    (value, power), widths = eigen_powers(told, left), WIDTHS.to(told)
    scale = _scale(value, power)
    # Inverse gamma in the logarithm of the width, on a grid.
    weight = torch.log_softmax(-0.5 * FREEDOM * (widths.log() + 1.0 / widths), 0)
    return torch.logsumexp(evidence_of_variances(value, power, scale.square() * widths) + weight, 1).clamp(min=0.0)


def _scale(value: Float[Tensor, "places n"], power: Float[Tensor, "places n"]) -> Float[Tensor, ""]:
    """Return the scale that is likeliest for most places: what stands out, and all that it drags along, is none of
    it."""
    scales = SCALES.to(value)
    most = math.log(1.0 - OUTLIERS) + evidence_of_variances(value, power, scales.square())
    out = math.log(OUTLIERS) + evidence_of_variances(value, power, scales.new_ones(1))
    return scales[torch.logaddexp(most, out).sum(0).argmax()]
