"""Force plates of a C3D file: analog channels to the wrench on the subject about the origin of the file's axes.

Types 1 to 4 of the C3D file format user guide (c3d.org), chapter "The FORCE_PLATFORM group", and type 7, which is type
3 behind a calibration (Visual3D's documentation, "FP_Type"). The channels of a plate hold the reaction on the subject
in the plate's axes: X and Y along its edges, Z down, so that a standing person makes Fz negative. ORIGIN leads from the
transducer's origin to the centre of the working surface; its z is negative (the surface is above), and where a file has
it positive, the opposite vector was stored. Nothing is zeroed: offsets stay.
"""

import math
import re
from collections.abc import Callable, Iterable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import LOADED_N, ZERO_MOST_N
from torchid.errors import Note
from torchid.io.c3d_header import C3dHeader
from torchid.io.mend import PlateAs, PlatesAs
from torchid.io.plate_setup import SMALL_MISFIT, PlateProblem, PlateSetup, plate_frame, plate_setups, rectangle_misfit
from torchid.recording import Plate

ReadChannels = Callable[[list[int]], Iterable[tuple[slice, np.ndarray]]]
"""From column numbers to samples (samples, columns), a few after the other, each time with where they lie among all."""


def read_plates(
    header: C3dHeader, read: ReadChannels, shape: tuple[int, int], metres: float, changes: PlatesAs
) -> tuple[Float[Tensor, "samples plates 6"], tuple[Plate, ...], list[Note], dict[str, str]]:
    """Wrenches of all usable plates.

    Args:
        read: gives the scaled samples of the analog channels asked for.
        shape: samples and channels of the file.
        metres: length of the file's unit of position [m].
        changes: what the user says about single plates; here their corners matter.

    Returns:
        Wrench (samples, plates, 6) on the subject about the origin of the file's axes [N, N m], the plates with corners
        in the file's axes [m], notes (one per refused plate), and facts about each plate.
    """
    setups, notes = plate_setups(header, shape[1], metres, changes)
    plates, facts = [], {}
    refused = [match[1] for note in notes if (match := re.match(r"plate (\d+) cannot", note.message))]
    refused = [number for number in refused if changes.get(int(number), PlateAs()).use]
    if refused:
        facts["plates refused"] = " ".join(refused)
    found = np.empty((shape[0], len(setups), 6))
    for setup in setups:
        try:
            said = _read_wrench(setup, read, header, metres, found[:, len(plates)])
        except PlateProblem as problem:
            notes.append(Note("plates.refused", f"plate {setup.number} cannot be used: {problem}", header.source))
            continue
        notes += [Note("plates.assumed", f"plate {setup.number}: {text}", header.source) for text in said]
        facts[f"plate {setup.number} type"] = str(setup.kind)
        corners, origin = torch.from_numpy(setup.corners), torch.from_numpy(_upright(setup))
        plates.append(Plate(f"plate {setup.number}", corners, origin, metres))
    return torch.from_numpy(np.ascontiguousarray(found[:, : len(plates)])), tuple(plates), notes, facts


def _read_wrench(
    setup: PlateSetup,
    read: ReadChannels,
    header: C3dHeader,
    metres: float,
    out: Float[np.ndarray, "samples 6"],
) -> list[str]:
    """Fill ``out`` with the wrench on the subject about the origin of the file's axes; returns what was assumed."""
    columns = [c - 1 for c in setup.channels]
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
    misfit = rectangle_misfit(setup.corners)
    if misfit > SMALL_MISFIT:
        text = "its corners lie {:.0f} mm from a rectangle; kept, with the axes of its first edges"
        said.append(text.format(1e3 * misfit))
    return said


def _factors(setup: PlateSetup, units: list[str], metres: float) -> tuple[np.ndarray, list[str]]:
    """Factor of each channel, or a matrix, to N, N m and m; where a unit says nothing, the file's unit of length."""
    if setup.calibration is not None:
        units_of = [1.0] * 8 if setup.kind == 7 else [1.0] * 3 + [metres] * 3
        return np.diag(units_of) @ setup.calibration, []
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
    if setup.kind in (3, 7):
        return *_kistler(raw, setup.origin[0], setup.origin[1]), _upright(setup)
    force, zero = raw[:, :3], np.zeros(len(raw))
    if setup.kind == 1:
        point = np.stack([raw[:, 3], raw[:, 4], zero], axis=1)
        return force, np.cross(point, force) + np.stack([zero, zero, raw[:, 5]], axis=1), _upright(setup)
    return force, raw[:, 3:], _upright(setup)


def _upright(setup: PlateSetup) -> Float[np.ndarray, " 3"]:
    """The right ORIGIN: from the transducer to the surface above it."""
    if setup.kind == 1:
        return np.zeros(3)
    if setup.kind in (3, 7):
        return np.array([0.0, 0.0, -abs(setup.origin[2])])
    return -setup.origin if setup.origin[2] > 0 else setup.origin


def _kistler(raw: np.ndarray, a: float, b: float) -> tuple[np.ndarray, np.ndarray]:
    """Types 3 and 7: channels Fx12, Fx34, Fy14, Fy23, Fz1 to Fz4 of four sensors at (+-a, +-b)."""
    x12, x34, y14, y23, z1, z2, z3, z4 = raw.T
    force = np.stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4], axis=1)
    moment = [b * (z1 + z2 - z3 - z4), a * (z2 + z3 - z1 - z4), b * (x34 - x12) + a * (y14 - y23)]
    return force, np.stack(moment, axis=1)


def baseline(vertical: Float[np.ndarray, " samples"]) -> float | None:
    """Median vertical force [N] of a plate while nobody stands on it, None where it is never free.

    Free are the samples within ``LOADED_N`` of the level that the smallest twentieth reaches, provided that this level
    is a zero's (``ZERO_MOST_N``) and that a tenth of the samples share it.
    """
    size = np.abs(vertical[np.isfinite(vertical)])
    if not len(size):
        return None
    level = float(np.quantile(size, 0.05))
    free = np.abs(size - level) < LOADED_N
    if level > ZERO_MOST_N or free.mean() < 0.1 or math.isclose(level, 0.0) and not free.any():
        return None
    return float(np.median(vertical[np.isfinite(vertical)][free]))
