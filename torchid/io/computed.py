"""Points that a program computed from others, whatever they are called: they lack the noise that every marker has.

Told are axes of a frame, copies, points between two others, points fixed to three others, and values that are no
places. What is computed in another way, such as a joint centre beside nothing but markers, is told by its name alone
(``torchid.io.labels``): the marker of a knee keeps its distance from the computed centre just as exactly.
"""

from collections.abc import Iterator
from itertools import chain, combinations

import numpy as np
import torch
from jaxtyping import Bool, Float

from torchid.errors import Note
from torchid.io.labels import loose

EXACT = 2e-6
"""Lengths [m] that differ by less in every frame are the same number: single precision stores 2 m to 0.2 um, cameras
see a marker to some 20 um, and filters leave skin to move."""
STEPS = 3.0
"""Steps of the stored numbers by which axes may be off: each of three ends is half a step's diagonal away."""
MOVED = 0.02
"""Constant distances tell nothing of points that moved less [m]: averaged standing trials repeat to a micrometre."""
APART = 1e-3
"""Points nearer to each other [m] are no ends of a line or an axis."""
AWAY = 10.0
"""A point that is farther from the middle of the others [m] is not on the subject: angles read as lengths are."""
SEVERAL = 3
"""Frames that copies and values must show."""
STRAIGHT = 1e-9
"""Cosines this near to -1 are looked at as a line: off by 5 um in 100 mm, in one frame."""
NAMED = 12
"""Points that a note names."""
FRAMES, CELLS = 400, 2_000_000
"""So many frames and distances at most are looked at."""


def computed_points(labels: tuple[str, ...], position: Float[np.ndarray, "frames points 3"]) -> dict[str, str]:
    """Points without noise of their own, and what shows it.

    Args:
        labels: unique names of the points.
        position: in m, NaN where a point was not seen.

    Returns:
        From each such label to a few words for the user. Nothing is said of fixed points where most points are fixed
        to others, as in a simulation without noise: there they are markers.
    """
    if not labels or not len(position):
        return {}
    x = _sample(position)
    found = dict.fromkeys(_no_places(x), "no place in a room")
    with np.errstate(invalid="ignore", divide="ignore"):
        length = _lengths(x)
        found |= dict.fromkeys(_frames(x, length, _free(found, labels)), "axis of a frame")
        found |= {k: f"copy of {labels[other]}" for k, other in _copies(length, _free(found, labels))}
        ordered = _between(x, length, _free(found, labels))
        found |= {k: f"between {labels[a]} and {labels[b]}" for k, a, b in ordered}
        found |= dict.fromkeys(_fixed(x, length, _free(found, labels)), "fixed to three others")
    return {labels[k]: found[k] for k in sorted(found)}


def left_out_as_computed(
    labels: tuple[str, ...], position: Float[np.ndarray, "frames points 3"], wanted: frozenset[str], source: str
) -> tuple[tuple[str, ...], list[Note]]:
    """Labels of points that ``computed_points`` tells but for those ``wanted``, and a note that says why."""
    asked = {loose(name) for name in wanted}
    found = {label: why for label, why in computed_points(labels, position).items() if loose(label) not in asked}
    if not found:
        return (), []
    names = ", ".join(f"{label} ({why})" for label, why in list(found.items())[:NAMED])
    more = f", ... ({len(found)})" if len(found) > NAMED else ""
    text = f"{len(found)} points left out that move as if computed, without noise of their own: {names}{more}"
    return tuple(found), [Note("markers.computed", text, source)]


def _sample(position: Float[np.ndarray, "frames points 3"]) -> Float[np.ndarray, "some points 3"]:
    count = max(SEVERAL, min(FRAMES, CELLS // position.shape[1] ** 2))
    return position[np.unique(np.linspace(0, len(position) - 1, count).astype(int))]


def _lengths(x: Float[np.ndarray, "frames points 3"]) -> Float[np.ndarray, "frames points points"]:
    """Distances of all points from each other, each of its own difference: products would cost half the digits."""
    places = torch.from_numpy(x)
    return torch.cdist(places, places, compute_mode="donot_use_mm_for_euclid_dist").numpy()


def _free(found: dict[int, str], labels: tuple[str, ...]) -> list[int]:
    return [k for k in range(len(labels)) if k not in found]


def _no_places(x: Float[np.ndarray, "frames points 3"]) -> list[int]:
    """Values with two coordinates that are always zero (powers), and those far from all that is seen."""
    seen = np.asarray(np.isfinite(x[..., 0]))
    flat = ((x == 0.0) | ~seen[..., None]).all(axis=0).sum(axis=-1) == 2
    middle = torch.from_numpy(x).nanquantile(0.5, dim=1).numpy()
    near = (np.linalg.norm(x - middle[:, None], axis=-1) <= AWAY).sum(axis=0) >= seen.sum(axis=0) / 2
    return np.flatnonzero((flat | ~near) & (seen.sum(axis=0) >= SEVERAL)).tolist()


def _fullest(seen: Bool[np.ndarray, "frames points"], needed: Bool[np.ndarray, " frames"]) -> int:
    """The frame with most points among those in which one is seen."""
    return int(np.argmax(np.where(needed, seen.sum(axis=1), -1)))


def _frames(
    x: Float[np.ndarray, "frames points 3"], length: Float[np.ndarray, "frames points points"], free: list[int]
) -> set[int]:
    """Origins with three axes of one length at right angles, and the ends of these axes.

    Where more points lie on an origin than it has trios of axes, the first of them is a marker.
    """
    slack, found = max(EXACT, STEPS * _step(x)), set()
    for origin in free:
        if origin not in found:
            trios = list(_trihedra(x, length[:, origin], origin, free, slack))
            here = [k for k in free if k == origin or _same(length[:, origin, k])] if trios else []
            found |= {*(here[1:] if 3 * len(here) > len({*chain(*trios)}) else here), *chain(*trios)}
    return found


def _step(x: Float[np.ndarray, "frames points 3"]) -> float:
    """The smallest difference between two values of a coordinate [m], 0 where nothing changes."""
    steps = np.diff(np.sort(x, axis=0), axis=0)
    return float(steps[steps > 0.0].min()) if (steps > 0.0).any() else 0.0


def _trihedra(
    x: Float[np.ndarray, "frames points 3"],
    arms: Float[np.ndarray, "frames points"],
    origin: int,
    free: list[int],
    slack: float,
) -> Iterator[tuple[int, int, int]]:
    """Triples of points at equal distance and right angles about ``origin`` in every frame in which all are seen."""
    frame = _fullest(np.isfinite(arms), np.isfinite(arms[:, origin]))
    some = [k for k in free if arms[frame, k] > APART]
    long, ways = arms[frame, some], x[frame, some] - x[frame, origin]
    across = np.abs(ways @ ways.T) / long
    joined = np.triu((np.abs(long[:, None] - long) <= slack) & (np.maximum(across, across.T) <= slack), 1)
    for a, b in np.argwhere(joined):
        for c in np.flatnonzero(joined[a] & joined[b]):
            trio = some[a], some[b], some[c]
            if all(_square(x, arms, origin, ends, slack) for ends in combinations(trio, 2)):
                yield trio


def _square(
    x: Float[np.ndarray, "frames points 3"],
    arms: Float[np.ndarray, "frames points"],
    origin: int,
    ends: tuple[int, int],
    slack: float,
) -> bool:
    """Whether both ends are equally far from the origin, and at right angles, wherever they are seen."""
    a, b = ends
    across = np.abs(((x[:, a] - x[:, origin]) * (x[:, b] - x[:, origin])).sum(axis=-1)) / arms[:, a]
    off = np.maximum(np.abs(arms[:, a] - arms[:, b]), across)
    off = off[np.isfinite(off)]
    return len(off) > 0 and bool(off.max() <= slack)


def _same(apart: Float[np.ndarray, " frames"]) -> bool:
    """Whether two points are at one place wherever both are seen."""
    apart = apart[np.isfinite(apart)]
    return len(apart) >= SEVERAL and bool(apart.max() <= EXACT)


def _copies(length: Float[np.ndarray, "frames points points"], free: list[int]) -> Iterator[tuple[int, int]]:
    """Points that lie on another one, with that one; of two, the one that is seen less, or else stands later."""
    near = np.asarray((length <= EXACT).any(axis=0))
    for a, b in combinations(free, 2):
        if near[a, b] and _same(length[:, a, b]):
            fewer = np.isfinite(length[:, a, a]).sum() < np.isfinite(length[:, b, b]).sum()
            yield (a, b) if fewer else (b, a)


def _between(
    x: Float[np.ndarray, "frames points 3"], length: Float[np.ndarray, "frames points points"], free: list[int]
) -> Iterator[tuple[int, int, int]]:
    """Points that divide the line between two others in a fixed proportion, with those two."""
    for k in free:
        seen = np.isfinite(length[:, k])
        frame = _fullest(seen, seen[:, k])
        arms = length[frame, k, free]
        ways = (x[frame, free] - x[frame, k]) / np.where(arms > APART, arms, np.nan)[:, None]
        for a, b in np.argwhere(np.triu(ways @ ways.T < STRAIGHT - 1.0)):
            if _divides(x, k, free[a], free[b]):
                yield k, free[a], free[b]
                break


def _divides(x: Float[np.ndarray, "frames points 3"], k: int, a: int, b: int) -> bool:
    """Whether point k is the same part of the way from a to b in every frame."""
    line, part = x[:, b] - x[:, a], x[:, k] - x[:, a]
    share = (line * part).sum(axis=-1) / (line * line).sum(axis=-1)
    seen = np.isfinite(share)
    off = np.linalg.norm(part - np.median(share[seen]) * line, axis=-1)[seen] if seen.any() else np.ones(1)
    return bool(off.max() <= EXACT)


def _fixed(
    x: Float[np.ndarray, "frames points 3"], length: Float[np.ndarray, "frames points points"], free: list[int]
) -> list[int]:
    """Points at constant distances from three others that are at constant distances from each other."""
    seen = np.isfinite(x[..., 0])
    moved = [k for k in free if seen[:, k].any() and (np.ptp(x[seen[:, k], k], axis=0) > MOVED).any()]
    apart = length[:, moved][:, :, moved]
    often = np.isfinite(apart).sum(axis=0) > len(x) / 2
    high, low = np.fmax.reduce(apart, axis=0, initial=-np.inf), np.fmin.reduce(apart, axis=0, initial=np.inf)
    held = often & (high - low <= EXACT) & ~np.eye(len(moved), dtype=bool)
    if 2 * held.any(axis=1).sum() >= len(moved):
        return []
    return [k for k, row in zip(moved, held, strict=True) if _triangle(held[row][:, row])]


def _triangle(joined: Bool[np.ndarray, "n n"]) -> bool:
    """Whether three of these points are joined with each other."""
    count = joined.astype(float)
    return bool(np.trace(count @ count @ count) > 0.0)
