"""A posture as sticks from joint to joint."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def sticks(
    parents: Sequence[int], X_WB: Float[np.ndarray, "bodies 4 4"], ends: Float[np.ndarray, "bodies 3"]
) -> Float[np.ndarray, "sticks 2 3"]:
    """Return sticks from every joint to the next, and from the last ones to where their body ends [m].

    Args:
        parents: of the bodies, -1 for the root.
        X_WB: poses of the bodies.
        ends: far end of every body, in its axes [m].
    """
    above = np.asarray(parents)
    origin, child = X_WB[:, :3, 3], np.flatnonzero(above >= 0)
    last = np.setdiff1d(np.arange(len(above)), above)
    tips = np.einsum("bij,bj->bi", X_WB[last, :3, :3], ends[last]) + origin[last]
    return np.concatenate([np.stack([origin[above[child]], origin[child]], 1), np.stack([origin[last], tips], 1)])
