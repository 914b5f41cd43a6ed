"""Ground reaction forces of an OpenSim MOT or STO: columns of force, centre of pressure and free moment to wrenches."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from torchid.conventions import LOADED_N, SAMPLE_LOADED_N
from torchid.errors import InputError, Note
from torchid.io.clock import uniform_clock
from torchid.io.force_names import force_columns
from torchid.io.plate_limits import MOST_FORCE
from torchid.io.spikes import force_bound, spikes
from torchid.io.storage import Storage
from torchid.recording import Forces, Plate

FAR = 50.0
"""Median distance [m] of a centre of pressure that can only be another unit."""
REACH = 10.0
"""Distance [m] of a centre of pressure from the median of its column that no walkway spans."""
MANY_FAR = 0.1
"""Share of the loaded rows beyond ``REACH`` above which the column as a whole is wrong."""
POINT_LEAP = (0.1, 0.5)
"""Leap [m] of a centre of pressure for one row, under load before and after: up to the first it is left alone, beyond
the second it leaves any foot; in between it is what the column shows elsewhere that decides."""
TORQUE_LEAP = (10.0, 50.0)
"""The same for a free moment [N m]: feet reach 20 in gait and runs."""
MANY_GAPS = 0.5
"""Share of a plate's rows that may be missing: forces with more holes than values are no record of a contact."""
LISTED = 5
"""Rows that a note names."""


@dataclass(frozen=True)
class PlateRows:
    """One plate's columns as stored; unloaded rows are zero."""

    name: str
    source: str
    lines: Int[np.ndarray, " rows"]
    columns: tuple[str, ...]
    """Names of the columns of force, point and torque; empty where there is none."""
    force: Float[np.ndarray, "rows 3"]
    point: Float[np.ndarray, "rows 3"]
    torque: Float[np.ndarray, "rows 3"]

    @property
    def together(self) -> Float[np.ndarray, "rows 9"]:
        """Force, point and torque beside each other."""
        return np.concatenate([self.force, self.point, self.torque], axis=1)


def forces_from_storage(
    storage: Storage, source: str, moment_gain: Callable[[int], float] = lambda number: 1.0
) -> tuple[Forces, tuple[Note, ...]]:
    """Wrenches on the subject about the file's origin, in the file's axes [N, N m].

    A force acts at its centre of pressure p and brings a free moment T: the moment about the origin is p x F + T. Where
    the force is zero, p is without meaning and not used; where p or T is missing under less than 20 N, there is no
    load. Missing rows, missing values under load, and single cells that leap away are gaps (NaN), and said.

    Args:
        moment_gain: factor of the free moments of a plate, by its number: what the user says of their unit.

    Raises:
        InputError: ``mot.columns`` where no complete set of columns is found, ``mot.empty`` without rows, ``mot.nan``
            where most rows have missing values, ``mot.cop_units`` where centres of pressure are not in m,
            ``mot.force_units`` where forces are not in N, ``time.*``.
    """
    return forces_of_columns(storage, force_columns(storage.columns, source), source, moment_gain)


def forces_of_columns(
    storage: Storage,
    sets: dict[str, dict[str, dict[str, int]]],
    source: str,
    moment_gain: Callable[[int], float] = lambda number: 1.0,
) -> tuple[Forces, tuple[Note, ...]]:
    """As ``forces_from_storage``, of columns that are known.

    Args:
        sets: columns by the name of the plate, the quantity and the axis, as of ``force_columns``.
    """
    notes: list[Note] = list(storage.notes)
    if not len(storage.time):
        raise InputError("mot.empty", "the file has no rows", source=source, remedy="Export the forces again")
    lines = storage.lines if len(storage.lines) else np.arange(len(storage.time)) + 1
    clock = uniform_clock(storage.time, lines, source, notes)
    wrenches = []
    for number, (name, columns) in enumerate(sets.items(), start=1):
        with np.errstate(over="ignore", invalid="ignore"):
            plate, idle = _plate_rows(storage, columns, name, source, lines)
            plate = replace(plate, torque=plate.torque * moment_gain(number))
            wrenches.append(_wrench(plate, idle, clock.rate, notes))
    stacked = torch.from_numpy(clock.spread(np.stack(wrenches, axis=1)))
    return Forces(torch.from_numpy(clock.time), stacked, tuple(Plate(name) for name in sets)), tuple(notes)


def _plate_rows(
    storage: Storage, columns: dict[str, dict[str, int]], name: str, source: str, lines: np.ndarray
) -> tuple[PlateRows, Bool[np.ndarray, " rows"]]:
    """The columns of a plate, rows without load set to zero, and which of them lacked a value for that."""
    names, values = [], []
    for kind in ("force", "point", "torque"):
        at = [columns[kind].get(axis) for axis in "xyz"]
        names += ["" if k is None else storage.columns[k] for k in at]
        cells = [np.zeros(len(lines)) if k is None else storage.values[:, k] for k in at]
        values.append(np.stack(cells, axis=1))
    force, point, torque = values
    size = np.linalg.norm(force, axis=1)
    point[size == 0.0] = 0.0
    absent = ~np.isfinite(np.concatenate([point, torque], axis=1)).all(axis=1)
    absent |= np.linalg.norm(point - _middle(size, point), axis=1) > REACH
    idle = absent & (size <= LOADED_N)
    for stream in values:
        stream[idle] = 0.0
    return PlateRows(name, source, lines, tuple(names), force, point, torque), idle


def _middle(size: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Median (3,) of the centre of pressure under load, NaN where nothing loads."""
    loaded = point[(size > LOADED_N) & np.isfinite(point).all(axis=1)]
    return np.median(loaded, axis=0) if len(loaded) else np.full(3, np.nan)


def _wrench(plate: PlateRows, idle: np.ndarray, rate: float, notes: list[Note]) -> Float[np.ndarray, "rows 6"]:
    """The wrench about the origin, NaN in gaps, of which ``notes`` tells."""
    free = ", ".join(filter(None, plate.columns[6:]))
    if free.count(",") < 2:
        told = f"only {free} of its free moment; zero taken for the rest" if free else "no free moment; zero taken"
        notes.append(Note("mot.no_moment", f"{plate.name} has {told}", plate.source))
    if idle.any():
        text = f"{idle.sum()} rows without centre of pressure or free moment bear at most {LOADED_N:g} N: no load taken"
        notes.append(Note("mot.no_load", f"{plate.name}: {text} ({_listed(plate.lines[idle])})", plate.source))
    gaps = _missing(plate, notes)
    _refuse_units(plate)
    gaps |= _bad_cells(plate, rate, notes)
    _refuse_sustained(plate, gaps)
    wrench = np.concatenate([plate.force, np.cross(plate.point, plate.force) + plate.torque], axis=1)
    wrench[gaps] = np.nan
    return wrench


def _missing(plate: PlateRows, notes: list[Note]) -> Bool[np.ndarray, " rows"]:
    """Rows with a value missing under load, or with the force itself missing."""
    bad = ~np.isfinite(plate.together)
    rows = np.asarray(bad.any(axis=1))
    if not rows.any():
        return rows
    row, column = np.argwhere(bad)[0]
    if rows.mean() > MANY_GAPS:
        raise InputError(
            "mot.nan", f"{plate.name} has {rows.sum()} of {len(rows)} rows with missing values", source=plate.source,
            place=f"line {plate.lines[row]}, column {plate.columns[column]}", found=f"{plate.together[row, column]}",
            remedy="Export the forces without gaps, with zeros where nothing is on the plate",
        )  # fmt: skip
    text = f"{rows.sum()} rows with missing values left as gaps ({_listed(plate.lines[rows])}; the first in column"
    notes.append(Note("mot.gaps", f"{plate.name}: {text} {plate.columns[column]})", plate.source))
    return rows


def _refuse_units(plate: PlateRows) -> None:
    """Centres of pressure in m, by the size of most of them."""
    size = np.linalg.norm(plate.force, axis=1)
    acting = plate.point[(size > LOADED_N) & np.isfinite(plate.point).all(axis=1)]
    if not len(acting):
        return
    far = float(np.mean(np.linalg.norm(acting - np.median(acting, axis=0), axis=1) > REACH))
    distance = float(np.median(np.linalg.norm(acting, axis=1)))
    if distance > FAR or far > MANY_FAR:
        spread = f", {100 * far:.0f} % of the loaded rows over {REACH:g} m from their median" if far > MANY_FAR else ""
        raise InputError(
            "mot.cop_units", "centres of pressure lie too far away for metres", source=plate.source, place=plate.name,
            found=f"median {distance:.3g} from the origin{spread}", remedy="Write them in m",
        )  # fmt: skip


def _bad_cells(plate: PlateRows, rate: float, notes: list[Note]) -> Bool[np.ndarray, " rows"]:
    """Rows of which one quantity leaps away and back, each said with line and column."""
    size = np.linalg.norm(plate.force, axis=1)
    bearing = (size > SAMPLE_LOADED_N)[:, None]
    point = np.where(bearing, plate.point, np.nan)
    far = np.linalg.norm(point - _middle(size, plate.point), axis=1) > REACH
    streams = (
        (plate.force, spikes(plate.force[:, None], force_bound(rate)), _pulls(plate.force)),
        (plate.point, spikes(point[:, None], POINT_LEAP[1], POINT_LEAP[0]), far),
        (plate.torque, spikes(plate.torque[:, None], TORQUE_LEAP[1], TORQUE_LEAP[0]), False),
    )
    places, found = [], np.zeros(len(size), bool)
    for first, (values, (single, throughout), more) in zip((0, 3, 6), streams, strict=True):
        if throughout.any():
            columns = ", ".join(filter(None, plate.columns[first : first + 3]))
            text = f"{plate.name}: {columns} leap from row to row as no contact does; left as they are"
            notes.append(Note("mot.leaping", text, plate.source))
        rows = single[:, 0] | more
        found |= rows
        for row in np.flatnonzero(rows):
            beside = values[[k for k in (row - 1, row + 1) if 0 <= k < len(values)]]
            axis = int(np.argmax(np.abs(values[row] - beside.mean(axis=0))))
            others = " and ".join(f"{x:g}" for x in beside[:, axis])
            where = f"line {plate.lines[row]}, column {plate.columns[first + axis]}"
            places.append(f"{where} is {values[row, axis]:g} beside {others}")
    if places:
        more = f" and {len(places) - LISTED} more" if len(places) > LISTED else ""
        text = "single cells leap away from their neighbours as no contact can; those rows are gaps"
        notes.append(Note("mot.spikes", f"{plate.name}: {text}: {'; '.join(places[:LISTED])}{more}", plate.source))
    return found


def _pulls(force: np.ndarray) -> Bool[np.ndarray, " rows"]:
    """Single rows in which the force along its main axis turns round: a foot that stands beside them cannot pull."""
    total = np.nansum(force, axis=0)
    axis = int(np.argmax(np.abs(total)))
    pushing = force[:, axis] * np.sign(total[axis])
    found = np.zeros(len(force), bool)
    beside = np.minimum(pushing[:-2], pushing[2:])
    found[1:-1] = (pushing[1:-1] < -SAMPLE_LOADED_N) & (beside > SAMPLE_LOADED_N)
    return found


def _refuse_sustained(plate: PlateRows, gaps: np.ndarray) -> None:
    """Forces in N, by what nobody bears."""
    size = np.where(gaps, 0.0, np.linalg.norm(plate.force, axis=1))
    row = int(np.argmax(size)) if len(size) else 0
    if len(size) and size[row] > MOST_FORCE:
        axis = int(np.argmax(np.abs(plate.force[row])))
        raise InputError(
            "mot.force_units",
            f"forces of {(size > MOST_FORCE).sum()} rows exceed {MOST_FORCE / 1e3:g} kN, more than a person can bear",
            source=plate.source, place=f"line {plate.lines[row]}, column {plate.columns[axis]}",
            found=f"{plate.force[row, axis]:g}", remedy="Write forces in N",
        )  # fmt: skip


def _listed(lines: np.ndarray) -> str:
    """Lines of a file, runs as ``3 to 7``."""
    runs = np.split(lines, np.flatnonzero(np.diff(lines) > 1) + 1)
    told = [f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    return f"line{'s' if len(lines) > 1 else ''} {', '.join(told[:LISTED])}" + (", ..." if len(told) > LISTED else "")
