"""Markers that step to another place within a frame and stay there, as nothing that is measured on a person can.

Labels that are exchanged from a frame on do so, and so do all markers where a piece of a file was lost.
"""

import numpy as np
from jaxtyping import Bool, Float

from torchid.errors import Note

LISTED = 8
"""Steps that a note names."""


def steps(stream: Float[np.ndarray, "frames components"], bound: float) -> Float[np.ndarray, " frames"]:
    """How far the path leaps from each frame to the next beside the steps before and after it, 0 up to ``bound``.

    A lasting acceleration within the bound of a frame changes a step by as much from the one before. NaN are gaps; a
    step needs a sample more on either side.
    """
    found = np.zeros(len(stream))
    move = np.diff(stream, axis=0)
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.linalg.norm(move[1:-1] - (move[:-2] + move[2:]) / 2.0, axis=1)
    found[1 : 1 + len(off)] = np.nan_to_num(off, nan=0.0)
    # The moves beside a step differ from their neighbours by half of it.
    beside = np.maximum(np.append(found[1:], 0.0), np.append(0.0, found[:-1]))
    return np.where((found > bound) & (found >= beside), found, 0.0)


def marker_steps(
    position: Float[np.ndarray, "frames markers 3"],
    spikes: Bool[np.ndarray, "frames markers"],
    among: Bool[np.ndarray, " markers"],
    bound: float,
    labels: tuple[str, ...],
    source: str,
) -> list[Note]:
    """What to say of markers that step and stay.

    Args:
        position: [m], NaN where missing.
        spikes: samples that leap away and back, which are no steps.
        among: markers to look at; the others are known to move evenly.
        bound: change of a step from one frame to the next [m] that no body makes.
        labels: one per marker.
        source: the file.
    """
    found: dict[int, list[str]] = {}
    furthest = 0.0
    for k in np.flatnonzero(among):
        size = steps(np.where(spikes[:, k, None], np.nan, position[:, k]), bound)
        furthest = max(furthest, float(size.max(initial=0.0)))
        for frame in np.flatnonzero(size):
            found.setdefault(int(frame), []).append(labels[k])
    if not found:
        return []
    places = [f"{_named(names)} (frame {frame + 2})" for frame, names in sorted(found.items())[:LISTED]]
    more = f", and {len(found) - LISTED} more frames" if len(found) > LISTED else ""
    count = sum(map(len, found.values()))
    text = f"{count} times a marker steps to another place, up to {furthest:.2g} m within a frame, and stays"
    text += f", as no body moves; left: {', '.join(places)}{more}; labels are exchanged there, or frames are missing"
    return [Note("markers.steps", text, source)]


def _named(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
