"""Neighbouring frames that stand in each other's place: exchanged back, every marker moves evenly again."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from torchid.errors import Note

EVENER = 0.2
"""Share of its unevenness that an exchange leaves where the two frames stood wrongly. Calibrated: of 75 public
recordings no pair comes below 0.38, the noise of a static trial; exchanged on purpose, pairs of all but static trials
lie below 0.1."""
MARKERS = (5, 8)
"""With fewer markers noise may do it; more tell nothing new."""
OFTEN = 0.5
"""Share of the frames in which a marker must be seen to be asked."""
PIECE = 4096
"""Frames that are looked at together."""
LISTED = 8
"""Frames that a note names."""


def exchanged_frames(position: Float[np.ndarray, "frames markers 3"], source: str) -> list[Note]:
    """What to say of pairs of neighbouring frames that are in the wrong order; they are left.

    Args:
        position: markers [m], NaN where not seen.
        source: the file.
    """
    often = np.flatnonzero(np.isfinite(position[:: 1 + len(position) // PIECE, :, 0]).mean(axis=0) > OFTEN)
    if len(often) < MARKERS[0] or len(position) < 4:
        return []
    asked = often[np.unique(np.linspace(0, len(often) - 1, MARKERS[1]).astype(int))]
    first, last = position[:4, asked], position[:-5:-1, asked]
    found = [0] if _wrong_at_the_start(first) else []
    found += [k for start, part in _pieces(position, asked) for k in start + 1 + np.flatnonzero(_wrong(part))]
    found += [len(position) - 2] if _wrong_at_the_start(last) else []
    if not found:
        return []
    listed = ", ".join(f"{k + 1} and {k + 2}" for k in found[:LISTED]) + (", ..." if len(found) > LISTED else "")
    text = f"{len(found)} pairs of frames stand in each other's place, by the paths of all markers ({listed}); left"
    return [Note("markers.order", f"{text} as they are", source)]


def _pieces(position: np.ndarray, asked: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Some frames after the other, three of them twice, with where they begin."""
    for start in range(0, len(position) - 3, PIECE):
        yield start, position[start : start + PIECE + 3, asked]


def _wrong(part: np.ndarray) -> np.ndarray:
    """For every frame with one before and two after it, whether it and the next are in the wrong order."""
    move = np.diff(part, axis=0)
    before, between, after = move[:-2], move[1:-1], move[2:]
    return _evener(_bend(before, between, after), _bend(before + between, -between, between + after))


def _wrong_at_the_start(four: np.ndarray) -> bool:
    """Whether the first two of four frames are in the wrong order."""
    one, two, three = np.diff(four, axis=0)[:, None]
    return bool(_evener(_bend(one, two, three), _bend(-one, one + two, three)).all())


def _evener(as_read: np.ndarray, exchanged: np.ndarray) -> np.ndarray:
    """Whether the markers (windows, markers, 3) together move evenly after an exchange, and not before it."""
    known = np.isfinite(as_read).all(axis=2)
    before, after = (np.where(known[..., None], x, 0.0).sum(axis=(1, 2)) for x in (as_read, exchanged))
    return (known.sum(axis=1) >= MARKERS[0]) & (after < EVENER * before)


def _bend(before: np.ndarray, between: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Squared second differences of a path of three moves."""
    return (between - before) ** 2 + (after - between) ** 2
