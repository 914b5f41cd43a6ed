"""Force plates of a C3D file: analog channels to the wrench on the subject about the origin of the file's axes.

Types 1 to 4 of the C3D file format user guide (c3d.org), chapter "The FORCE_PLATFORM group". The channels of a plate
hold the reaction on the subject in the plate's axes: X and Y along its edges, Z down, so that a standing person makes
Fz negative. ORIGIN leads from the transducer's origin to the centre of the working surface; its z is negative (the
surface is above), and where a file has it positive, the opposite vector was stored. Nothing is zeroed: offsets stay.
"""

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.errors import Note
from torchid.io.c3d_header import C3dHeader
from torchid.io.mend import PlateAs, PlatesAs, ordered_corners
from torchid.io.units import METRES
from torchid.recording import Plate

CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}
EDGE = (0.1, 5.0)
"""Lengths of a plate's edges [m] that raise no doubt."""
MAX_WARP = 0.02
"""A corner further [m] from the plane of the others is a mistake."""


ReadChannels = Callable[[list[int]], Iterable[tuple[slice, np.ndarray]]]
"""From column numbers to samples (samples, columns), a few after the other, each time with where they lie among all."""


@dataclass(frozen=True)
class PlateSetup:
    """One plate as the file describes it, lengths in m."""

    number: int
    kind: int
    channels: tuple[int, ...]
    corners: Float[np.ndarray, "4 3"]
    origin: Float[np.ndarray, " 3"]
    calibration: Float[np.ndarray, "6 6"] | None


class PlateProblem(Exception):
    """A plate that cannot be used; becomes a note, never leaves this module."""


def read_plates(
    header: C3dHeader, read: ReadChannels, shape: tuple[int, int], metres: float, changes: PlatesAs
) -> tuple[Float[Tensor, "samples plates 6"], tuple[Plate, ...], list[Note], dict[str, str]]:
    """Wrenches of all usable plates.

    Args:
        header: of the file.
        read: gives the scaled samples of the analog channels asked for.
        shape: samples and channels of the file.
        metres: length of the file's unit of position [m].
        changes: what the user says about single plates; here their corners matter.

    Returns:
        Wrench (samples, plates, 6) on the subject about the origin of the file's axes [N, N m], the plates with corners
        in the file's axes [m], notes (one per refused plate), and facts about each plate.
    """
    used, types = header.number("FORCE_PLATFORM", "USED"), header.numbers("FORCE_PLATFORM", "TYPE")
    notes: list[Note] = []
    count = len(types) if used is None else min(int(used), len(types))
    if used is not None and used > len(types):
        text = f"FORCE_PLATFORM:USED is {used:g}, but only {len(types)} types are given"
        notes.append(Note("plates.used", text, header.source))
    plates, facts = [], {}
    found = np.empty((shape[0], min(count, 255), 6))
    for k in range(min(count, 255)):
        try:
            setup = _setup(header, k, metres, changes.get(k + 1, PlateAs()))
            said = _read_wrench(setup, read, shape[1], header, metres, found[:, len(plates)])
        except PlateProblem as problem:
            notes.append(Note("plates.refused", f"plate {k + 1} cannot be used: {problem}", header.source))
            facts["plates refused"] = f"{facts.get('plates refused', '')} {k + 1}".strip()
            continue
        notes += [Note("plates.assumed", f"plate {k + 1}: {text}", header.source) for text in said]
        facts[f"plate {k + 1} type"] = str(setup.kind)
        plates.append(Plate(f"plate {k + 1}", torch.from_numpy(setup.corners), torch.from_numpy(_upright(setup))))
    return torch.from_numpy(np.ascontiguousarray(found[:, : len(plates)])), tuple(plates), notes, facts


def _setup(header: C3dHeader, k: int, metres: float, change: PlateAs) -> PlateSetup:
    kind = int(_finite(header.numbers("FORCE_PLATFORM", "TYPE")[k : k + 1], 1, "TYPE")[0])
    if kind not in CHANNELS:
        raise PlateProblem(f"type {kind} is not supported (types 1 to 4 are)")
    channel = header.find("FORCE_PLATFORM", "CHANNEL")
    rows = channel.dims[0] if channel is not None and channel.dims else 0
    numbers = header.numbers("FORCE_PLATFORM", "CHANNEL", unsigned=True)[k * rows : (k + 1) * rows]
    channels = tuple(int(c) for c in _finite(numbers[: CHANNELS[kind]], CHANNELS[kind], "CHANNEL"))
    corners = _finite(header.numbers("FORCE_PLATFORM", "CORNERS")[12 * k : 12 * k + 12], 12, "CORNERS").reshape(4, 3)
    origin = _finite(header.numbers("FORCE_PLATFORM", "ORIGIN")[3 * k : 3 * k + 3], 3, "ORIGIN")
    calibration = None
    if kind == 4:
        entries = _finite(header.numbers("FORCE_PLATFORM", "CAL_MATRIX")[36 * k : 36 * k + 36], 36, "CAL_MATRIX")
        calibration = entries.reshape(6, 6).T
    corners = corners * (METRES[change.corner_unit] if change.corner_unit else metres)
    corners = ordered_corners(torch.from_numpy(corners), change).numpy()
    return PlateSetup(k + 1, kind, channels, corners, origin * metres, calibration)


def _upright(setup: PlateSetup) -> Float[np.ndarray, " 3"]:
    """The right ORIGIN: from the transducer to the surface above it."""
    if setup.kind == 1:
        return np.zeros(3)
    if setup.kind == 3:
        return np.array([0.0, 0.0, -abs(setup.origin[2])])
    return -setup.origin if setup.origin[2] > 0 else setup.origin


def _finite(values: np.ndarray, count: int, name: str) -> np.ndarray:
    if len(values) < count:
        raise PlateProblem(f"FORCE_PLATFORM:{name} is missing or too short")
    if not np.isfinite(values).all() or np.abs(values).max() > 1e9:
        raise PlateProblem(f"FORCE_PLATFORM:{name} is not a number")
    return values


def _read_wrench(
    setup: PlateSetup,
    read: ReadChannels,
    channels: int,
    header: C3dHeader,
    metres: float,
    out: Float[np.ndarray, "samples 6"],
) -> list[str]:
    """Fill ``out`` with the wrench on the subject about the origin of the file's axes; returns what was assumed."""
    columns = [c - 1 for c in setup.channels]
    if min(columns) < 0 or max(columns) >= channels:
        raise PlateProblem(f"its channels {setup.channels} are not among the {channels} of the file")
    if len(set(columns)) < len(columns):
        raise PlateProblem(f"its channels {setup.channels} repeat")
    R_WF, p_WF = plate_frame(setup.corners)
    units = header.strings("ANALOG", "UNITS")
    factors, said = _factors(setup, [units[c] if c < len(units) else "" for c in columns], metres)
    known = np.zeros(len(columns), bool)
    for part, raw in read(columns):
        known |= ~np.isnan(raw).all(axis=0)
        # Not a product with a diagonal matrix, which would spread a channel's NaN to all.
        si = raw * factors if factors.ndim == 1 else raw @ factors.T
        force, moment, origin = _in_plate(setup, si)
        force_W = force @ R_WF.T
        out[part, :3] = force_W
        out[part, 3:] = (moment - np.cross(origin, force)) @ R_WF.T + np.cross(p_WF, force_W)
    if len(out) and not known.all():
        raise PlateProblem("one of its channels has no scale or offset")
    if setup.origin[2] > 0 and setup.kind != 1:
        said.append("ORIGIN has its z above zero, the opposite vector is used")
    return said


def plate_frame(corners: Float[np.ndarray, "4 3"]) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Axes R_WF (3, 3) and centre p_WF of a plate from its corners (4, 3) [m] in the quadrants ++, -+, --, +-."""
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    if edges.min() < EDGE[0] or edges.max() > EDGE[1]:
        raise PlateProblem(f"its edges are {edges.min():.4g} to {edges.max():.4g} m long")
    x = corners[0] - corners[1]
    z = np.cross(x, corners[0] - corners[3])
    if np.linalg.norm(z) < 0.5 * np.linalg.norm(x) * np.linalg.norm(corners[0] - corners[3]):
        raise PlateProblem("its corners are not a rectangle")
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    centre = corners.mean(axis=0)
    if np.abs((corners - centre) @ z).max() > MAX_WARP:
        raise PlateProblem("its corners do not lie in a plane")
    return np.stack([x, np.cross(z, x), z], axis=1), centre


def _factors(setup: PlateSetup, units: list[str], metres: float) -> tuple[np.ndarray, list[str]]:
    """Factor of each channel, or a matrix, to N, N m and m; where a unit says nothing, the file's unit of length."""
    if setup.kind == 4:
        assert setup.calibration is not None
        return np.diag([1.0, 1.0, 1.0, metres, metres, metres]) @ setup.calibration, []
    kinds = {1: "FFFLLM", 2: "FFFMMM", 3: "F" * 8}[setup.kind]
    factors, unclear = [], []
    for kind, unit in zip(kinds, units, strict=True):
        factor = _factor(kind, unit)
        if factor is None:
            unclear.append(unit)
            factor = 1.0 if kind == "F" else metres
        factors.append(factor)
    said = (
        [f"units {sorted(set(unclear))} of its channels taken as N and N times the unit of position"] if unclear else []
    )
    return np.array(factors), said


def _factor(kind: str, unit: str) -> float | None:
    """SI value of a unit of force (F), moment (M) or length (L), None where it says nothing."""
    text = re.sub(r"[Nn]ewtons?|^nt", "N", "".join(c for c in unit if c.isalpha()))
    lengths = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0}
    forces = {"N": 1.0, "n": 1.0, "kN": 1e3}
    if kind == "F":
        return forces.get(text)
    if kind == "L":
        return lengths.get(text)
    return next((f * m for n, f in forces.items() for u, m in lengths.items() if text == n + u), None)


def _in_plate(setup: PlateSetup, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force and moment (samples, 3) at the transducer in plate axes, and the right ORIGIN."""
    if setup.kind == 3:
        return *_kistler(raw, setup.origin[0], setup.origin[1]), _upright(setup)
    force, zero = raw[:, :3], np.zeros(len(raw))
    if setup.kind == 1:
        point = np.stack([raw[:, 3], raw[:, 4], zero], axis=1)
        return force, np.cross(point, force) + np.stack([zero, zero, raw[:, 5]], axis=1), _upright(setup)
    return force, raw[:, 3:], _upright(setup)


def _kistler(raw: np.ndarray, a: float, b: float) -> tuple[np.ndarray, np.ndarray]:
    """Type 3: channels Fx12, Fx34, Fy14, Fy23, Fz1 to Fz4 of four sensors at (+-a, +-b)."""
    x12, x34, y14, y23, z1, z2, z3, z4 = raw.T
    force = np.stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4], axis=1)
    moment = [b * (z1 + z2 - z3 - z4), a * (z2 + z3 - z1 - z4), b * (x34 - x12) + a * (y14 - y23)]
    return force, np.stack(moment, axis=1)


def baseline(vertical: Float[np.ndarray, " samples"]) -> float | None:
    """Median vertical force [N] of a plate while nobody stands on it, None where it is never free.

    Free are the samples within ``LOADED_N`` of the level that the smallest twentieth reaches, provided that this level
    is itself small and that a tenth of the samples share it.
    """
    size = np.abs(vertical[np.isfinite(vertical)])
    if not len(size):
        return None
    level = float(np.quantile(size, 0.05))
    free = np.abs(size - level) < LOADED_N
    if level > 3 * LOADED_N or free.mean() < 0.1 or math.isclose(level, 0.0) and not free.any():
        return None
    return float(np.median(vertical[np.isfinite(vertical)][free]))
