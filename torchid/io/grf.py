"""Ground reaction forces of an OpenSim MOT or STO: columns of force, centre of pressure and free moment to wrenches."""

import re

import numpy as np
import torch

from torchid.errors import InputError, Note
from torchid.io.storage import Storage
from torchid.io.table import uniform_clock
from torchid.recording import Forces, Plate

STYLES = (
    (re.compile(r"(?:(?P<pre>\w+?)_)?ground_force(?:_(?P<id>\w+?))?_(?P<what>[vpm])(?P<axis>[xyz])", re.I), ""),
    (re.compile(r"(?:(?P<pre>\w+?)_)?ground_(?:torque|moment)(?:_(?P<id>\w+?))?_m?(?P<axis>[xyz])", re.I), "m"),
    (re.compile(r"(?P<pre>\w+?)_(?P<id>)(?P<what>[vpm])(?P<axis>[xyz])", re.I), ""),
)
"""Column names met in the field: ``ground_force_1_vx``, ``1_ground_force_vx``, ``ground_force_vx``,
``R_ground_force_vx`` with ``R_ground_torque_x``, ``ground_force_calcn_r_vx``, ``ground_moment_1_mx``, ``FP1_vx``."""
ACTING = 20.0
"""Force [N] above which a centre of pressure must make sense."""
FAR = 50.0
"""Median distance [m] of a centre of pressure that can only be another unit."""


def forces_from_storage(storage: Storage, source: str) -> tuple[Forces, tuple[Note, ...]]:
    """Wrenches on the subject about the file's origin, in the file's axes [N, N m].

    A force acts at its centre of pressure p and brings a free moment T: the moment about the origin is p x F + T. Where
    the force is zero, p is without meaning and not used.

    Raises:
        InputError: ``mot.columns`` where no complete set of columns is found, ``mot.nan`` where a value is missing,
            ``mot.cop_units`` where centres of pressure are not in m.
    """
    notes: list[Note] = list(storage.notes)
    sets = _sets(storage, source)
    time = uniform_clock(storage.time, source, notes)
    wrenches = [_wrench(storage, columns, name, source, notes) for name, columns in sets.items()]
    stacked = torch.from_numpy(np.stack(wrenches, axis=1))
    return Forces(torch.from_numpy(time), stacked, tuple(Plate(name) for name in sets)), tuple(notes)


def _sets(storage: Storage, source: str) -> dict[str, dict[str, list[int]]]:
    """For every plate or foot the columns of v, p and m, by the name of its force columns; the others are ignored."""
    found: dict[tuple[str, str], dict[str, dict[str, int]]] = {}
    for k, column in enumerate(storage.columns):
        for pattern, fixed in STYLES:
            match = pattern.fullmatch(column)
            if match:
                what = fixed or match["what"].lower()
                key = ((match["pre"] or "").lower(), (match["id"] or "").lower())
                found.setdefault(key, {}).setdefault(what, {})[match["axis"].lower()] = k
                break
    sets = {}
    for key, parts in found.items():
        if all(len(parts.get(what, {})) == 3 for what in "vp"):
            name = storage.columns[parts["v"]["x"]][:-3]
            sets[name] = {what: [parts[what][a] for a in "xyz"] for what in "vpm" if len(parts.get(what, {})) == 3}
        elif "v" in parts:
            raise _columns_missing("_".join(filter(None, key)) or "ground_force", storage, source)
    if not sets:
        raise _columns_missing("force", storage, source)
    return sets


def _columns_missing(name: str, storage: Storage, source: str) -> InputError:
    return InputError(
        "mot.columns",
        f"no complete columns of force (v) and centre of pressure (p) for {name}",
        source=source,
        place="column names",
        found=", ".join(storage.columns[:40]),
        remedy="Name them like ground_force_1_vx, ground_force_1_px, ground_force_1_mx (also y, z)",
    )


def _wrench(storage: Storage, columns: dict[str, list[int]], name: str, source: str, notes: list[Note]) -> np.ndarray:
    force, point = storage.values[:, columns["v"]], storage.values[:, columns["p"]].copy()
    free = storage.values[:, columns["m"]] if "m" in columns else np.zeros_like(force)
    if "m" not in columns:
        notes.append(Note("mot.no_moment", f"{name} has no free moment; zero taken", source))
    point[(force == 0.0).all(axis=1)] = 0.0
    together = np.concatenate([force, point, free], axis=1)
    bad = ~np.isfinite(together)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            "mot.nan",
            f"{name} has {int(bad.any(axis=1).sum())} rows with missing values",
            source=source,
            place=f"data row {row + 1}",
            found=f"{'vpm'[column // 3]}{'xyz'[column % 3]} {together[row, column]}",
            remedy="Export the forces without gaps",
        )
    acting = np.linalg.norm(force, axis=1) > ACTING
    if acting.any() and np.median(np.linalg.norm(point[acting], axis=1)) > FAR:
        raise InputError(
            "mot.cop_units",
            "centres of pressure lie too far away for metres",
            source=source,
            place=name,
            found=f"median {np.median(np.linalg.norm(point[acting], axis=1)):.0f}",
            remedy="Write them in m",
        )
    return np.concatenate([force, np.cross(point, force) + free], axis=1)
