"""Frames that repeat the one before: a recording that nobody measured at the rate that it claims."""

import numpy as np
from jaxtyping import Float

from torchid.errors import InputError

REPEATED = 0.4
"""Share of frames that repeat the one before in every marker from which a recording is doubled: a system that loses
frames now and then holds a few of a hundred."""
STILL = 0.98
"""And from which nothing moves at all."""
FEWEST = 20
"""Frames below which nothing is said."""


def refuse_repeats(position: Float[np.ndarray, "frames markers 3"], source: str) -> None:
    """Refuse a recording of motion most of whose frames are copies.

    Args:
        position: markers [m], NaN where not seen.
        source: the file.

    Raises:
        InputError: ``markers.still`` and ``markers.doubled``.
    """
    seen = np.asarray(np.isfinite(position).any(axis=(1, 2)))
    pairs = seen[1:] & seen[:-1]
    if pairs.sum() < FEWEST:
        return
    same = (position[1:] == position[:-1]) | (np.isnan(position[1:]) & np.isnan(position[:-1]))
    share = float(same.all(axis=(1, 2))[pairs].mean())
    if share > STILL:
        raise InputError(
            "markers.still", "no marker moves", source=source, place="markers",
            found=f"{share:.0%} of the frames are copies of the one before",
            remedy="Give the trial the role static, or export the motion again",
        )  # fmt: skip
    if share > REPEATED:
        raise InputError(
            "markers.doubled", "frames are copies of the one before", source=source, place="markers",
            found=f"{share:.0%} of the frames; the motion was measured at a lower rate than the file states",
            remedy="Export it at the rate at which it was measured",
        )  # fmt: skip
