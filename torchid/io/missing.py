"""Missing markers under all their disguises become NaN, and frames that repeat the one before are said."""

import numpy as np
from jaxtyping import Bool, Float

from torchid.errors import InputError, Note

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
