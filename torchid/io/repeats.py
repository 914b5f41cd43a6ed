"""Frames that repeat the one before: a recording that nobody measured at the rate that it claims."""

import numpy as np
from jaxtyping import Float

from torchid.errors import InputError, Note

REPEATED = 0.4
"""Share of frames that repeat the one before in every marker from which a recording is doubled: a system that loses
frames now and then holds a few of a hundred."""
STILL = 0.98
"""And from which nothing moves at all."""
FEWEST = 20
"""Frames below which nothing is said."""
QUANTA = 5.0
"""So many of the smallest steps in the recording must the middle marker move on a side of a copied frame: slower
motion may stand still in whole numbers."""
PIECE = 8192
"""Frames that are looked at together."""
LISTED = 8
"""Frames that a note names."""


def frame_repeats(position: Float[np.ndarray, "frames markers 3"], source: str) -> list[Note]:
    """What to say of single frames that are copies; a recording of motion most of whose frames are is refused.

    Noise and motion never repeat every coordinate: of the public recordings none has one such frame.

    Args:
        position: markers [m], NaN where not seen.

    Raises:
        InputError: ``markers.still`` and ``markers.doubled``.
    """
    seen = np.asarray(np.isfinite(position).any(axis=(1, 2)))
    pairs = seen[1:] & seen[:-1]
    if pairs.sum() < FEWEST:
        return []
    same = (position[1:] == position[:-1]) | (np.isnan(position[1:]) & np.isnan(position[:-1]))
    copied = same.all(axis=(1, 2)) & pairs
    share = float(copied.sum() / pairs.sum())
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
    frames = _in_motion(position, np.flatnonzero(copied) + 1)
    if not frames:
        return []
    listed = ", ".join(str(k + 1) for k in frames[:LISTED]) + (", ..." if len(frames) > LISTED else "")
    text = f"{len(frames)} frames repeat the one before in every marker amid motion ({listed}); left as they are: a"
    return [Note("markers.repeated", f"{text} frame was lost there, or the file was put together wrongly", source)]


def _in_motion(position: np.ndarray, frames: np.ndarray) -> list[int]:
    """Those frames on one side of which the middle marker moves by more than the recording's smallest steps."""
    if not len(frames):
        return []
    least = QUANTA * _smallest_step(position)
    return [k for k in frames.tolist() if max(_pace(position, k - 2), _pace(position, k)) > least]


def _pace(position: np.ndarray, k: int) -> float:
    """Distance [m] that the middle marker moves from frame k to the next, 0 where that is not known."""
    if not 0 <= k < len(position) - 1:
        return 0.0
    moved = np.linalg.norm(position[k + 1] - position[k], axis=-1)
    return float(np.median(moved[np.isfinite(moved)])) if np.isfinite(moved).any() else 0.0


def _smallest_step(position: np.ndarray) -> float:
    """Smallest change [m] of a coordinate from one frame to the next."""
    smallest = np.inf
    for start in range(0, len(position) - 1, PIECE):
        step = np.abs(np.diff(position[start : start + PIECE + 1], axis=0))
        smallest = min(smallest, float(np.min(step, where=step > 0.0, initial=np.inf)))
    return smallest
