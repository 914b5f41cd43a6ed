"""Frames out of order: neighbours in each other's place, and places where all markers leap on together.

Two frames that are exchanged back let every marker move evenly again. Where frames are missing or stand elsewhere, all
markers leap in one step, however little, as no contact of a body makes them.
"""

import warnings
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from torchid.errors import Note

EVENER = 0.2
"""Share of its unevenness that an exchange leaves where the two frames stood wrongly. Calibrated: of 75 public
recordings no pair comes below 0.38, the noise of a static trial; exchanged on purpose, pairs of all but static trials
lie below 0.1."""
UNEVEN = 10.0
"""Unevenness of the frames as they stand, over its median in the recording, from which an exchange is asked about: two
exchanged frames of a path of step s are uneven by 18 s^2, and noise alone, summed over five markers or more, by less
than twice its median. Derived."""
LEAP = (25.0, 10.0)
"""Leap of most markers over their own median, and over their medians within ``BESIDE`` frames on either side, at which
frames are missing. Calibrated: of 75 public recordings none leaps over 17 times its median; with a frame taken out,
three of four walks do over 25 times."""
BESIDE = (4, 13)
"""Frames before and after a leap, further than it reaches itself, that show how unevenly markers move there."""
MOST = 0.2
"""The leap that four of five markers exceed counts: impacts move feet alone."""
MARKERS = (5, 8)
"""With fewer markers noise may do it; more tell nothing new."""
OFTEN = 0.5
"""Share of the frames in which a marker must be seen to be asked."""
PIECE = 4096
"""Frames that are looked at together."""
LISTED = 8
"""Frames that a note names."""


def frames_out_of_order(position: Float[np.ndarray, "frames markers 3"], source: str) -> list[Note]:
    """What to say of pairs of neighbouring frames in the wrong order and of places where frames are missing.

    Nothing is changed.

    Args:
        position: markers [m], NaN where not seen.
    """
    often = np.flatnonzero(np.isfinite(position[:: 1 + len(position) // PIECE, :, 0]).mean(axis=0) > OFTEN)
    if len(often) < MARKERS[0] or len(position) < 4:
        return []
    asked = often[np.unique(np.linspace(0, len(often) - 1, MARKERS[1]).astype(int))]
    pairs, joints = _exchanged(position, asked), _joints(position, asked)
    text = "{} pairs of frames stand in each other's place, by the paths of all markers ({}); left as they are"
    notes = [Note("markers.order", text.format(len(pairs), _listed(pairs)), source)] if pairs else []
    joints = [k for k in joints if all(abs(k - pair) > BESIDE[0] for pair in pairs)]
    text = "all markers leap on together between {} pairs of frames ({}): frames are missing there, or stand elsewhere"
    return notes + ([Note("markers.order", text.format(len(joints), _listed(joints)), source)] if joints else [])


def _listed(found: list[int]) -> str:
    """Frames and those after them, as users count."""
    return ", ".join(f"{k + 1} and {k + 2}" for k in found[:LISTED]) + (", ..." if len(found) > LISTED else "")


def _exchanged(position: np.ndarray, asked: np.ndarray) -> list[int]:
    """Frames that stand in the place of the next."""
    first, last = position[:4, asked], position[:-5:-1, asked]
    usual = _usual(position, asked)
    found = [0] if _wrong_at_the_start(first, usual) else []
    found += [
        start + 1 + k for start, part in _pieces(position, asked) for k in np.flatnonzero(_wrong(part, usual)).tolist()
    ]
    return found + ([len(position) - 2] if _wrong_at_the_start(last, usual) else [])


def _usual(position: np.ndarray, asked: np.ndarray) -> float:
    """Median unevenness of a marker in the recording's windows of four frames [m^2], 0 where there is none."""
    parts = [np.diff(part, axis=0) for _, part in _pieces(position, asked)]
    bends = np.concatenate([_bend(move[:-2], move[1:-1], move[2:]).sum(axis=2) for move in parts])
    known = np.isfinite(bends).sum(axis=1)
    each = np.nansum(bends, axis=1)[known > 0] / known[known > 0]
    return float(np.median(each)) if len(each) else 0.0


def _joints(position: np.ndarray, asked: np.ndarray) -> list[int]:
    """Frames from which all markers leap to the next, beside their other steps."""
    off = np.concatenate([_leap(part) for _, part in _pieces(position, asked)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of frames without markers
        level = np.nanmedian(off, axis=0)
        leaps = of_most(off / np.where(level > 0.0, level, np.nan))
        found = []
        for k in np.flatnonzero(leaps > LEAP[0]).tolist():
            sides = [off[max(0, k - BESIDE[1]) : max(0, k - BESIDE[0])], off[k + BESIDE[0] + 1 : k + BESIDE[1] + 1]]
            if not any(map(len, sides)):
                continue  # too short to tell a leap from the rest
            beside = np.fmax.reduce([np.nanmedian(side, axis=0) for side in sides if len(side)])
            largest = leaps[k] >= leaps[max(0, k - 1) : k + 2].max()
            if largest and of_most((off[k] / beside)[None])[0] > LEAP[1]:
                found.append(k + 1)
    return found


def of_most(leaps: np.ndarray) -> np.ndarray:
    """What most of the markers exceed in each frame (frames, markers), 0 where too few are seen."""
    count, ranked = (~np.isnan(leaps)).sum(axis=1), np.sort(leaps, axis=1)  # what is not seen comes last
    at = MOST * np.maximum(count - 1, 0)
    ends = np.stack([np.floor(at), np.ceil(at)], axis=1).astype(int)
    lower, upper = np.nan_to_num(np.take_along_axis(ranked, ends, axis=1)).T
    enough = np.isfinite(leaps).sum(axis=1) >= MARKERS[0]
    return np.where(enough, lower + (at % 1.0) * (upper - lower), 0.0)


def _leap(part: np.ndarray) -> np.ndarray:
    """By how much each step but the first and the last differs from the mean of its neighbours."""
    move = np.diff(part, axis=0)
    return np.linalg.norm(move[1:-1] - (move[:-2] + move[2:]) / 2.0, axis=-1)


def _pieces(position: np.ndarray, asked: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Some frames after the other, three of them twice, with where they begin."""
    for start in range(0, len(position) - 3, PIECE):
        yield start, position[start : start + PIECE + 3, asked]


def _wrong(part: np.ndarray, usual: float) -> np.ndarray:
    """For every frame with one before and two after it, whether it and the next are in the wrong order."""
    move = np.diff(part, axis=0)
    before, between, after = move[:-2], move[1:-1], move[2:]
    return _evener(_bend(before, between, after), _bend(before + between, -between, between + after), usual)


def _wrong_at_the_start(four: np.ndarray, usual: float) -> bool:
    """Whether the first two of four frames are in the wrong order."""
    one, two, three = np.diff(four, axis=0)[:, None]
    return bool(_evener(_bend(one, two, three), _bend(-one, one + two, three), usual).all())


def _evener(as_read: np.ndarray, exchanged: np.ndarray, usual: float) -> np.ndarray:
    """Whether the markers (windows, markers, 3) together move evenly after an exchange, and not before it."""
    known = np.asarray(np.isfinite(as_read).all(axis=2))
    before, after = (np.where(known[..., None], x, 0.0).sum(axis=(1, 2)) for x in (as_read, exchanged))
    count = known.sum(axis=1)
    return (count >= MARKERS[0]) & (after < EVENER * before) & (before > UNEVEN * usual * count)


def _bend(before: np.ndarray, between: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Squared second differences of a path of three moves."""
    return (between - before) ** 2 + (after - between) ** 2
