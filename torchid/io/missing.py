"""Missing markers under all their disguises become NaN, and each repair is said."""

import numpy as np
from jaxtyping import Bool, Float

from torchid.errors import Note

FAR = 100.0
"""No laboratory is that large [m]; such coordinates are codes for a missing marker."""
CODE = 10.0
"""Three equal coordinates above this size [m] are a code as well (such as -16512 mm)."""
HELD_FRAMES = 10
"""A marker that stays on the very same number for longer is held by the recording system, not seen."""
MOVING = 0.05
"""Median speed of the other markers [m/s] above which a still marker is suspect."""


def mark_missing(
    position: Float[np.ndarray, "frames markers 3"], source: str
) -> tuple[Float[np.ndarray, "frames markers 3"], list[Note]]:
    """Positions (frames, markers, 3) in m with exact zeros, codes and infinities turned into NaN."""
    notes: list[Note] = []
    with np.errstate(invalid="ignore"):
        zero = (position == 0.0).all(axis=-1)
        code = ~np.isfinite(position).all(axis=-1) & ~np.isnan(position).any(axis=-1)
        code |= (np.abs(position) > FAR).any(axis=-1)
        equal = (position[..., 0] == position[..., 1]) & (position[..., 1] == position[..., 2])
        code |= equal & (np.abs(position[..., 0]) > CODE)
    for mask, code_name, text in ((zero, "zeros", "at exactly (0, 0, 0)"), (code, "codes", "at impossible places")):
        if mask.any():
            where = f"{mask.sum()} points of {mask.any(axis=0).sum()} markers {text} taken as missing"
            notes.append(Note(f"markers.{code_name}", where, source))
    never = (np.isnan(position).any(axis=-1) | zero | code).all(axis=0)
    if never.any():
        notes.append(Note("markers.never_seen", f"{never.sum()} markers are not seen in any frame", source))
    return np.where((zero | code)[..., None], np.nan, position), notes


def held_samples(position: Float[np.ndarray, "frames markers 3"], rate: float) -> Bool[np.ndarray, "frames markers"]:
    """Mask (frames, markers) of samples that repeat the one before for over ``HELD_FRAMES`` frames while others move.

    The first sample of a run is not part of the mask: it was measured.
    """
    if len(position) < 2 or position.shape[1] < 3:
        return np.zeros(position.shape[:2], bool)
    step = np.diff(position, axis=0)
    speed = np.linalg.norm(step, axis=-1) * rate
    seen = np.isfinite(speed)
    padded = np.where(seen, speed, np.inf)
    still = (step == 0.0).all(axis=-1)
    middle = (seen.sum(axis=1) - 1) // 2
    median = np.take_along_axis(np.sort(padded, axis=1), np.maximum(middle, 0)[:, None], axis=1)[:, 0]
    suspect = still & (np.isfinite(median) & (median > MOVING))[:, None]
    return np.concatenate([np.zeros((1, position.shape[1]), bool), _long_runs(suspect, HELD_FRAMES)])


def _long_runs(mask: np.ndarray, longer_than: int) -> np.ndarray:
    """The mask restricted to runs along axis 0 of more than so many entries."""
    index = np.arange(len(mask))[:, None]
    before = np.maximum.accumulate(np.where(~mask, index, -1), axis=0)
    after = np.minimum.accumulate(np.where(~mask, index, len(mask))[::-1], axis=0)[::-1]
    return mask & (after - before - 1 > longer_than)


def mask_held(
    position: Float[np.ndarray, "frames markers 3"], rate: float, labels: tuple[str, ...], source: str
) -> tuple[Float[np.ndarray, "frames markers 3"], list[Note]]:
    """Positions with held samples turned into NaN, and what was masked."""
    held = held_samples(position, rate)
    if not held.any():
        return position, []
    names = [f"{label} ({int(n)})" for label, n in zip(labels, held.sum(axis=0), strict=True) if n]
    text = f"held at a constant place while others move, taken as missing (frames): {', '.join(names[:12])}"
    return np.where(held[..., None], np.nan, position), [Note("markers.held", text, source)]
