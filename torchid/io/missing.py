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
PIECE = 8192
"""Frames that are looked at together."""
MOVING = 0.05
"""Median speed of the other markers [m/s] above which a still marker is suspect."""


def missing_samples(
    position: Float[np.ndarray, "frames markers 3"], source: str
) -> tuple[Bool[np.ndarray, "frames markers"], list[Note]]:
    """Mask of exact zeros, codes and infinities among positions (frames, markers, 3) in m."""
    zero, code, unseen = (np.zeros(position.shape[:2], bool) for _ in range(3))
    for start in range(0, len(position), PIECE):
        part = slice(start, start + PIECE)
        zero[part], code[part], unseen[part] = _disguises(position[part])
    notes: list[Note] = []
    for mask, code_name, text in ((zero, "zeros", "at exactly (0, 0, 0)"), (code, "codes", "at impossible places")):
        if mask.any():
            where = f"{mask.sum()} points of {mask.any(axis=0).sum()} markers {text} taken as missing"
            notes.append(Note(f"markers.{code_name}", where, source))
    never = (unseen | zero | code).all(axis=0)
    if never.any():
        notes.append(Note("markers.never_seen", f"{never.sum()} markers are not seen in any frame", source))
    return zero | code, notes


def _disguises(position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masks (frames, markers) of zeros, codes and NaN."""
    unseen = np.isnan(position).any(axis=-1)
    with np.errstate(invalid="ignore"):
        zero = (position == 0.0).all(axis=-1)
        code = ~np.isfinite(position).all(axis=-1) & ~unseen
        code |= (np.abs(position) > FAR).any(axis=-1)
        equal = (position[..., 0] == position[..., 1]) & (position[..., 1] == position[..., 2])
        code |= equal & (np.abs(position[..., 0]) > CODE)
    return np.asarray(zero), np.asarray(code), np.asarray(unseen)


def held_samples(
    position: Float[np.ndarray, "frames markers 3"], rate: float, labels: tuple[str, ...], source: str
) -> tuple[Bool[np.ndarray, "frames markers"], list[Note]]:
    """Mask of samples that repeat the one before for over ``HELD_FRAMES`` frames while others move.

    The first sample of a run is not part of the mask: it was measured.
    """
    frames, markers = len(position), position.shape[1]
    held = np.zeros((frames, markers), bool)
    if frames < 2 or markers < 3:
        return held, []
    for start in range(0, frames - 1, PIECE):
        held[start + 1 : start + PIECE + 1] = _suspect(position[start : start + PIECE + 1], rate)
    for k in range(markers):
        held[1:, k] = _long_runs(held[1:, k], HELD_FRAMES)
    if not held.any():
        return held, []
    names = [f"{label} ({int(n)})" for label, n in zip(labels, held.sum(axis=0), strict=True) if n]
    text = f"held at a constant place while others move, taken as missing (frames): {', '.join(names[:12])}"
    return held, [Note("markers.held", text, source)]


def _suspect(position: np.ndarray, rate: float) -> np.ndarray:
    """Mask (frames - 1, markers) of samples on the very place of the one before while the median marker moves."""
    step = np.diff(position, axis=0)
    speed = np.linalg.norm(step, axis=-1) * rate
    seen = np.isfinite(speed)
    padded = np.where(seen, speed, np.inf)
    still = (step == 0.0).all(axis=-1)
    middle = (seen.sum(axis=1) - 1) // 2
    median = np.take_along_axis(np.sort(padded, axis=1), np.maximum(middle, 0)[:, None], axis=1)[:, 0]
    return still & (np.isfinite(median) & (median > MOVING))[:, None]


def _long_runs(mask: np.ndarray, longer_than: int) -> np.ndarray:
    """The mask restricted to runs of more than so many entries."""
    index = np.arange(len(mask))
    before = np.maximum.accumulate(np.where(~mask, index, -1))
    after = np.minimum.accumulate(np.where(~mask, index, len(mask))[::-1])[::-1]
    return mask & (after - before - 1 > longer_than)
