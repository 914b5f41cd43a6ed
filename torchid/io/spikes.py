"""Single samples that leap away from their neighbours and back, as nothing that is measured on a person can."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from torchid.errors import Note
from torchid.recording import Forces

ACCELERATION = 2000.0
"""Acceleration [m/s^2] that no marker on a person has for a whole frame: hands that pitch and feet that kick reach
about 1000; recordings of gait and runs stay below 420, their worst reconstructed point included."""
FLICKER = 0.05
"""A leap [m] up to which a sample is left alone: markers that merge or are half hidden flicker by centimetres (42 mm in
the worst recording at hand), and the robust fit bears those."""
STANDS_OUT = 5.0
"""So many times the largest bend elsewhere in its own stream makes a sample one that does not belong there."""
LOADING = 5e5
"""Rate [N/s] that no force on a plate reaches: stiff landings of gymnasts load by some 1e5 N/s, gait and drop jumps
leap by less than 3e4."""
FORCE_FLICKER = 500.0
"""A leap [N] up to which a sample is left alone at any rate."""
LEVER = 1.0
"""Distance [m] from a plate's centre that no centre of pressure on it exceeds, for leaps of the moment."""
MANY = 0.1
"""Share of a stream's samples above which leaps are no single samples: rate, unit or labels are wrong."""
PIECE = 512
"""Frames that are looked at together, few enough to stay in a processor's cache."""
LISTED = 8
"""Frames that a note names."""


def leap_bound(rate: float) -> float:
    """Deviation [m] of a marker from the middle of its neighbours, at ``rate`` [Hz], that no body can make."""
    return max(FLICKER, ACCELERATION / (2.0 * rate**2)) if rate else np.inf


def force_bound(rate: float) -> float:
    """Deviation [N] of a force from the middle of its neighbours, at ``rate`` [Hz], that no contact can make."""
    return max(FORCE_FLICKER, LOADING / rate) if rate else np.inf


def spikes(
    values: Float[np.ndarray, "frames streams components"],
    bound: float,
    floor: float | None = None,
    among: Bool[np.ndarray, " streams"] | None = None,
) -> tuple[Bool[np.ndarray, "frames streams"], Bool[np.ndarray, " streams"]]:
    """Which samples deviate by more than can be from where their neighbours put them, and which streams do throughout.

    Between two neighbours that is their middle, and they must be closer to each other than the sample is to it, so that
    a step is none. With neighbours on one side only (first, last, beside a gap) it is the straight line through two of
    them, for twice the deviation. A sample without neighbours is not judged. NaN are gaps. Where more than ``MANY`` of
    the samples leap, no single one is marked, but the stream.

    Args:
        values: one vector per frame and stream.
        bound: deviation that is always too large.
        floor: deviation that never is; between the two it is where it exceeds ``STANDS_OUT`` times all others of its
            stream. By default the bound alone counts.
        among: streams to look at, where the caller knows the others to bend too little (``bent``).
    """
    floor = bound if floor is None else min(floor, bound)
    found = np.zeros(values.shape[:2], bool)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in np.flatnonzero(bent(values, floor) if among is None else among):
            stream = values[:, k].copy()
            found[:, k] = _between(stream, bound, floor)
            stream[found[:, k]] = np.nan
            found[:, k] |= _beside(stream, bound, floor) | _beside(stream[::-1], bound, floor)[::-1]
    throughout = found.sum(axis=0) > np.maximum(MANY * len(found), 1)
    found[:, throughout] = False
    return found, throughout


def bent(values: Float[np.ndarray, "frames streams components"], floor: float) -> Bool[np.ndarray, " streams"]:
    """Streams with a second difference that a leap of more than ``floor`` must have: every other is done with."""
    frames, streams, components = values.shape
    bend = _largest_bends(values.reshape(frames, streams * components))
    return (bend.reshape(streams, components) > 2.0 * floor / np.sqrt(components)).any(axis=1)


def _largest_bends(columns: np.ndarray) -> np.ndarray:
    """Largest second difference of every column (frames, columns), 0 where it is never known."""
    largest = np.zeros(columns.shape[1])
    for start in range(0, max(0, len(columns) - 2), PIECE):
        part = columns[start : start + PIECE + 2]
        bend = part[2:] - part[1:-1]
        bend += part[:-2]
        bend -= part[1:-1]
        for extreme in (np.fmax.reduce(bend, axis=0), -np.fmin.reduce(bend, axis=0)):
            np.fmax(largest, extreme, out=largest)
    return largest


def _leaps(stream: np.ndarray) -> np.ndarray:
    """Distance of every sample of a stream (frames, components) from the middle of its neighbours, 0 without both."""
    leap = np.zeros(len(stream))
    leap[1:-1] = np.nan_to_num(np.linalg.norm(stream[1:-1] - (stream[:-2] + stream[2:]) / 2.0, axis=1), posinf=np.inf)
    return leap


def _between(stream: np.ndarray, bound: float, floor: float) -> np.ndarray:
    """Spikes of one stream (frames, components) with a neighbour on either side."""
    leap = _leaps(stream)
    # A spike bends the two samples before and after it as well: these say nothing about the rest.
    before = np.concatenate([np.zeros(3), np.maximum.accumulate(leap)[:-3]])
    after = np.concatenate([np.maximum.accumulate(leap[::-1])[::-1][3:], np.zeros(3)])
    limit = np.clip(STANDS_OUT * np.maximum(before[: len(leap)], after[-len(leap) :]), floor, bound)
    apart = np.full(len(stream), np.inf)
    apart[1:-1] = np.linalg.norm(stream[2:] - stream[:-2], axis=1)
    return (leap > limit) & (apart < leap)


def _beside(stream: np.ndarray, bound: float, floor: float) -> np.ndarray:
    """Spikes of one stream (frames, components) with two neighbours after them and none before."""
    sample, near, far = stream[:-2], stream[1:-1], stream[2:]
    alone = np.concatenate([[True], np.isnan(sample[:-1]).any(axis=1)])
    leap = np.linalg.norm(sample - (2.0 * near - far), axis=1)
    others = _leaps(stream)
    others[1:-1][alone] = 0.0
    limit = np.clip(STANDS_OUT * others.max(), floor, bound)
    found = np.zeros(len(stream), bool)
    found[:-2] = alone & (leap > 2.0 * limit) & (np.linalg.norm(far - near, axis=1) < leap / 2.0)
    return found


def marker_spikes(
    position: Float[np.ndarray, "frames markers 3"],
    rate: float,
    labels: tuple[str, ...],
    source: str,
    lines: Int[np.ndarray, " frames"] | None = None,
) -> tuple[Bool[np.ndarray, "frames markers"], list[Note]]:
    """Mask of marker samples [m] that leap away for one frame, and what to say of them and of steps that last.

    Args:
        position: NaN where missing.
        labels: one per marker.
        lines: of the file, by frame; None where it has none.
    """
    bound = leap_bound(rate)
    with np.errstate(over="ignore", invalid="ignore"):
        among = bent(position, min(FLICKER, bound))
    found, throughout = spikes(position, bound, FLICKER, among)
    frames = np.flatnonzero(found.any(axis=1))
    # The middle of two neighbours is half a second difference away, which a lasting step has in full.
    notes = marker_steps(position, found, among & ~throughout, 2.0 * bound, labels, source)
    if throughout.any():
        names = [label for label, hit in zip(labels, throughout, strict=True) if hit]
        text = f"leap between places in over {MANY:.0%} of their frames, as no body moves: {', '.join(names[:12])}"
        notes.append(Note("markers.leaping", f"{len(names)} markers {text}; left as they are", source))
    if not len(frames):
        return found, notes
    places = []
    for k in frames[:LISTED]:
        names = [label for label, hit in zip(labels, found[k], strict=True) if hit]
        line = "" if lines is None else f", line {lines[k]}"
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        places.append(f"{', '.join(names[:3])}{more} (frame {k + 1}{line})")
    rest = f", and {len(frames) - LISTED} more frames" if len(frames) > LISTED else ""
    text = (
        f"{found.sum()} samples leap away from where the frames before and after put them, as no body moves; taken as"
    )
    text = f"{text} missing: {', '.join(places)}{rest}"
    return found, [*notes, Note("markers.spikes", text, source)]


def plate_spikes(forces: Forces, source: str) -> tuple[Bool[np.ndarray, "samples plates"], list[Note]]:
    """Mask of plate samples whose force, or moment about the plate's centre, leaps away once, and what to say of it."""
    wrench, bound = forces.wrench.numpy(), force_bound(forces.rate if len(forces.time) > 1 else 0.0)
    found = np.zeros(wrench.shape[:2], bool)
    with np.errstate(over="ignore", invalid="ignore"):
        bends = _largest_bends(wrench.reshape(len(wrench), -1)).reshape(-1, 6)
    for k, plate in enumerate(forces.plates):
        centre = np.zeros(3) if plate.corners is None else plate.corners.mean(dim=0).numpy()
        force, moment = bends[k, :3].sum(), bends[k, 3:].sum()
        if force + moment + np.abs(centre).sum() * force < bound * min(LEVER, 1.0):
            continue
        found[:, k] = spikes(wrench[:, k, None, :3], bound)[0][:, 0]
        if plate.corners is not None:
            about = wrench[:, k, 3:] - np.cross(centre, wrench[:, k, :3])
            found[:, k] |= spikes(about[:, None], bound * LEVER)[0][:, 0]
    notes = []
    for k, plate in enumerate(forces.plates):
        times = forces.time[torch.from_numpy(found[:, k])].tolist()
        if times:
            listed = ", ".join(f"{t:.4g}" for t in times[:LISTED]) + (", ..." if len(times) > LISTED else "")
            text = (
                f"{plate.name}: {len(times)} samples leap away from those before and after, faster than a contact loads"
            )
            notes.append(Note("plates.spikes", f"{text}; left as gaps (at {listed} s)", source))
    return found, notes


STEPS_NAMED = 8
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
    """What to say of markers that step to another place within a frame and stay, as nothing measured on a person can.

    Labels that are exchanged from a frame on do so, and so do all markers where a piece of a file was lost.

    Args:
        position: [m], NaN where missing.
        spikes: samples that leap away and back, which are no steps.
        among: markers to look at; the others are known to move evenly.
        bound: change of a step from one frame to the next [m] that no body makes.
        labels: one per marker.
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
    places = [f"{_named(names)} (frame {frame + 2})" for frame, names in sorted(found.items())[:STEPS_NAMED]]
    more = f", and {len(found) - STEPS_NAMED} more frames" if len(found) > STEPS_NAMED else ""
    count = sum(map(len, found.values()))
    text = f"{count} times a marker steps to another place, up to {furthest:.2g} m within a frame, and stays"
    text += f", as no body moves; left: {', '.join(places)}{more}; labels are exchanged there, or frames are missing"
    return [Note("markers.steps", text, source)]


def _named(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
