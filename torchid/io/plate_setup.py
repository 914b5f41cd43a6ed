"""Which force plates a C3D file describes, and whether each description can be that of a plate.

Parameters of the group FORCE_PLATFORM: USED, TYPE, CHANNEL, CORNERS, ORIGIN, CAL_MATRIX (C3D file format user guide,
c3d.org, chapter "The FORCE_PLATFORM group"). A plate that cannot be is refused alone, with the reason.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import torch
from jaxtyping import Float

from torchid.errors import Note
from torchid.io.c3d_header import C3dHeader
from torchid.io.frame import METRES
from torchid.io.mend import PlateAs, PlatesAs, ordered_corners
from torchid.io.plate_axes import frame_of

CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6, 7: 8}
"""Channels of the types that are read; type 7 is type 3 behind a calibration of 8 by 8, as type 4 is type 2."""
CALIBRATED = (4, 7)
UNREAD = {
    5: "programs disagree whether its calibration of 6 by 8 gives inches and pounds or the file's units",
    6: "the format says neither where its four sensors lie nor how its calibration of 12 by 12 is stored",
}
"""Why types that exist in the field are not read."""
EDGE = (0.1, 5.0)
"""Lengths of a plate's edges [m] that raise no doubt."""
SMALL_MISFIT = 0.005
"""Corners less far [m] from a rectangle are worth no word; measured ones of public recordings lie within 2 mm."""
MAX_MISFIT = 0.02
"""A corner further [m] from the nearest rectangle is a mistake, not a measurement."""


class PlateProblem(Exception):
    """A plate that cannot be used; becomes a note, never leaves the reading of plates."""


@dataclass(frozen=True)
class PlateSetup:
    """One plate as the file describes it, lengths in m."""

    number: int
    kind: int
    channels: tuple[int, ...]
    corners: Float[np.ndarray, "4 3"]
    origin: Float[np.ndarray, " 3"]
    calibration: Float[np.ndarray, "n n"] | None


def plate_setups(
    header: C3dHeader, channels: int, metres: float, changes: PlatesAs
) -> tuple[list[PlateSetup], list[Note]]:
    """The plates that can be used, and a note about every other.

    Plates that TYPE lists beyond USED are read where the file describes them in full, with channels and a place of
    their own: USED is then the one witness against the others.

    Args:
        channels: analog channels that the data hold.
        metres: length of the file's unit of position [m].
        changes: what the user says about the corners of single plates.
    """
    used, types = header.number("FORCE_PLATFORM", "USED"), header.numbers("FORCE_PLATFORM", "TYPE")[:255]
    stated = len(types) if used is None else min(int(used), len(types))
    notes: list[Note] = []
    if used is not None and used > len(types):
        text = f"FORCE_PLATFORM:USED is {used:g}, but only {len(types)} types are given"
        notes.append(Note("plates.used", text, header.source))
    setups: list[PlateSetup] = []
    for k in range(stated):
        try:
            setups.append(_setup(header, k, channels, metres, changes.get(k + 1, PlateAs())))
        except PlateProblem as problem:
            notes.append(_refused(k + 1, str(problem), header))
    for k in range(stated, len(types) if stated else 0):
        text = f"FORCE_PLATFORM:USED is {used:g}, but TYPE lists {len(types)}"
        try:
            setups.append(_apart(_setup(header, k, channels, metres, changes.get(k + 1, PlateAs())), setups))
            said = "is described in full and is read as well"
        except PlateProblem as problem:
            said = f"is left out: {problem}"
        notes.append(Note("plates.used", f"{text}; plate {k + 1} {said}", header.source))
    return _without_shared(setups, header, notes), notes


def _refused(number: int, reason: str, header: C3dHeader) -> Note:
    return Note("plates.refused", f"plate {number} cannot be used: {reason}", header.source)


def _apart(setup: PlateSetup, others: list[PlateSetup]) -> PlateSetup:
    """A plate beyond USED, unless it repeats one within."""
    for other in others:
        if set(setup.channels) & set(other.channels):
            raise PlateProblem(f"it has channels of plate {other.number}")
        if np.linalg.norm(setup.corners.mean(axis=0) - other.corners.mean(axis=0)) < EDGE[0]:
            raise PlateProblem(f"it lies where plate {other.number} lies")
    return setup


def _without_shared(setups: list[PlateSetup], header: C3dHeader, notes: list[Note]) -> list[PlateSetup]:
    """Plates whose channels are theirs alone; of two that share some, nothing tells which is right."""
    kept = []
    for setup in setups:
        others = [one for one in setups if one is not setup and set(one.channels) & set(setup.channels)]
        if others:
            shared = sorted({c for one in others for c in one.channels} & set(setup.channels))
            named = ", ".join(str(one.number) for one in others)
            reason = f"its channels {', '.join(map(str, shared))} are also those of plate {named}"
            notes.append(_refused(setup.number, reason, header))
        else:
            kept.append(setup)
    return kept


def _setup(header: C3dHeader, k: int, available: int, metres: float, change: PlateAs) -> PlateSetup:
    kind = int(_finite(header.numbers("FORCE_PLATFORM", "TYPE")[k : k + 1], 1, "TYPE")[0])
    if kind not in CHANNELS:
        reason = UNREAD.get(kind, f"types {', '.join(map(str, CHANNELS))} are")
        raise PlateProblem(f"type {kind} is not read: {reason}")
    channels = _channels(header, k, CHANNELS[kind], available)
    corners = _finite(header.numbers("FORCE_PLATFORM", "CORNERS")[12 * k : 12 * k + 12], 12, "CORNERS").reshape(4, 3)
    origin = _finite(header.numbers("FORCE_PLATFORM", "ORIGIN")[3 * k : 3 * k + 3], 3, "ORIGIN")
    calibration = _calibration(header, k, CHANNELS[kind]) if kind in CALIBRATED else None
    corners = corners * (METRES[change.corner_unit] if change.corner_unit else metres)
    corners = ordered_corners(torch.from_numpy(corners), change).numpy()
    plate_frame(corners)
    return PlateSetup(k + 1, kind, channels, corners, origin * metres, calibration)


def _channels(header: C3dHeader, k: int, count: int, available: int) -> tuple[int, ...]:
    channel = header.find("FORCE_PLATFORM", "CHANNEL")
    rows = channel.dims[0] if channel is not None and channel.dims else 0
    numbers = header.numbers("FORCE_PLATFORM", "CHANNEL", unsigned=True)[k * rows : (k + 1) * rows]
    found = tuple(int(c) for c in _finite(numbers[:count], count, "CHANNEL"))
    if min(found) < 1 or max(found) > available:
        raise PlateProblem(f"its channels {found} are not among the {available} of the file")
    if len(set(found)) < len(found):
        raise PlateProblem(f"its channels {found} repeat")
    return found


def _calibration(header: C3dHeader, k: int, side: int) -> Float[np.ndarray, "n n"]:
    """The matrix from channels to forces (and moments), stored with its first index fastest."""
    stored = header.find("FORCE_PLATFORM", "CAL_MATRIX")
    if stored is not None and len(stored.dims) >= 2 and stored.dims[:2] != (side, side):
        raise PlateProblem(f"its CAL_MATRIX is {stored.dims[0]} by {stored.dims[1]} and not {side} by {side}")
    size = side * side
    entries = header.numbers("FORCE_PLATFORM", "CAL_MATRIX")[size * k : size * (k + 1)]
    return _finite(entries, size, "CAL_MATRIX").reshape(side, side).T


def _finite(values: np.ndarray, count: int, name: str) -> np.ndarray:
    if len(values) < count:
        raise PlateProblem(f"FORCE_PLATFORM:{name} is missing or too short")
    if not np.isfinite(values).all() or np.abs(values).max() > 1e9:
        raise PlateProblem(f"FORCE_PLATFORM:{name} is not a number")
    return values


def plate_frame(corners: Float[np.ndarray, "4 3"]) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Axes R_WF (3, 3) and centre p_WF of a plate from its corners (4, 3) [m] in the quadrants ++, -+, --, +-."""
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    if edges.min() < EDGE[0] or edges.max() > EDGE[1]:
        raise PlateProblem(f"its edges are {edges.min():.4g} to {edges.max():.4g} m long")
    misfit = rectangle_misfit(corners)
    if misfit > MAX_MISFIT:
        raise PlateProblem(f"its corners lie {1e3 * misfit:.0f} mm from the nearest rectangle{_other_order(corners)}")
    R_WF, p_WF = frame_of(torch.from_numpy(corners))
    return R_WF.numpy(), p_WF.numpy()


def rectangle_misfit(corners: Float[np.ndarray, "4 3"]) -> float:
    """Largest distance [m] of a corner from the rectangle with the corners' centre, mean sides and mean directions."""
    x = (corners[0] - corners[1] + corners[3] - corners[2]) / 2
    y = (corners[0] - corners[3] + corners[1] - corners[2]) / 2
    width, depth = np.linalg.norm(x), np.linalg.norm(y)
    z = np.cross(x, y)
    if np.linalg.norm(z) < 1e-9:
        return float(np.inf)
    along = x / width
    across = np.cross(z, along) / np.linalg.norm(z)
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    rectangle = corners.mean(axis=0) + signs @ np.stack([width * along, depth * across])
    return float(np.linalg.norm(corners - rectangle, axis=1).max())


def _other_order(corners: Float[np.ndarray, "4 3"]) -> str:
    """Words about an order of the corners in which they are a rectangle, if there is one."""
    for order in permutations(range(4)):
        if rectangle_misfit(corners[list(order)]) <= MAX_MISFIT:
            return f"; they are one in another order, such as {', '.join(str(k + 1) for k in order)}"
    return ""
