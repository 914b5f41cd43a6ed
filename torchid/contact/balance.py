"""What the plates miss of the weight: a frame whose vertical force falls short is no measured contact."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.options import ContactOptions
from torchid.conventions import GRAVITY
from torchid.runs import spread

ALWAYS = 0.98
"""Share of the loaded frames from which on a lack is that of the whole trial."""
KNOWN = 0.95
"""Level of what plates seem to bear too much that stands for the error of the balance."""


@dataclass(frozen=True)
class Weight:
    """What a subject weighs, from standing on plates."""

    mass: float
    """[kg]"""
    sd: float
    """Of the mass [kg]: of the plates' gains, which standing does not show."""
    trials: tuple[str, ...]
    """That it was read in."""


def falls_short(
    vertical: Float[Tensor, " frames"],
    needed: Float[Tensor, " frames"],
    weight: Weight,
    rate_hz: float,
    options: ContactOptions,
) -> Bool[Tensor, " frames"]:
    """Frames of a run in which a share of the weight is missing.

    Args:
        vertical: force of all plates [N], smoothed as the motion is.
        needed: mass times gravity and the vertical acceleration of the centre of mass [N].
        weight: from standing.
        options: how much may be missing, and for how long.
    """
    missing = (needed - vertical) / (GRAVITY * weight.mass) - weight.sd / weight.mass
    bearing = vertical > 0.5 * GRAVITY * weight.mass
    if not bool(bearing.any()):
        return missing > options.missing_share
    # No plate bears more than there is: what it seems to bear too much tells how well the acceleration is known.
    share = max(options.missing_share, float((-missing[bearing]).quantile(KNOWN)))
    width = max(1, round(options.shortest_s * rate_hz)) | 1
    padded = torch.nn.functional.pad(missing[None, None], (width // 2, width // 2), mode="replicate")
    lasting = torch.nn.functional.avg_pool1d(padded, width, stride=1)[0, 0]
    short = spread(lasting > share, missing > 0.5 * share)
    # Where a share is missing throughout, no contact comes or goes: that is for the diagnosis.
    loaded = vertical > options.loaded_n
    return short if float((missing > share)[loaded].double().mean()) < ALWAYS else torch.zeros_like(short)
