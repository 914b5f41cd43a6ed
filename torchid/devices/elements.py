"""Elements from the keys of their sheet: which belong together, and what they mean."""

import csv
import math
from pathlib import Path
from typing import Any

from torchid.devices.device import (
    WORLD,
    Axis,
    Coordinate,
    Drive,
    Element,
    Handle,
    Law,
    Line,
    Number,
    SegmentPoint,
    Sensor,
    SheetValue,
    Triple,
)
from torchid.devices.device import Path as Run
from torchid.devices.sheet import ElementSheet, ProfileSheet, VectorWithSd, WithSd
from torchid.errors import ConfigError


def fault(code: str, message: str, source: str | Path, place: str = "", found: str = "", *, remedy: str) -> ConfigError:
    """Return the error ``device.<code>`` of a place of a sheet."""
    return ConfigError(f"device.{code}", message, source=source, place=place, found=found, remedy=remedy)


def number(text: Any) -> Number:
    """Return a number of a sheet; None where it is unknown."""
    if text == "unknown":
        return None
    return SheetValue(text.value, text.sd) if isinstance(text, WithSd) else SheetValue(float(text))


def vector(text: Any) -> tuple[SheetValue, SheetValue, SheetValue] | None:
    """Return a vector of a sheet; None where it is unknown."""
    if text == "unknown":
        return None
    values, sd = (text.value, text.sd) if isinstance(text, VectorWithSd) else (text, 0.0)
    spread = sd if isinstance(sd, tuple) else (sd, sd, sd)
    x, y, z = (SheetValue(float(v), float(s)) for v, s in zip(values, spread, strict=True))
    return x, y, z


LINEAR = {
    "stiffness": "stiffness_N_m", "rest": "rest_m", "preload": "preload_N", "free_play": "free_play_m",
    "damping": "damping_Ns_m",
}  # fmt: skip
TURNING = {
    "stiffness": "stiffness_Nm_rad", "rest": "rest_rad", "preload": "preload_Nm", "free_play": "free_play_rad",
    "damping": "damping_Nms_rad",
}  # fmt: skip
NEEDED = {"spring": "stiffness", "cable": "stiffness", "damper": "damping"}
"""Parameter without which an element of a type is none, unless it has a table, a profile or a channel."""


def element_of(sheet: ElementSheet, k: int, path: Path) -> Element:
    """Make an element of its sheet.

    Args:
        k: number in the list.
        path: the file, from whose folder profiles are found.

    Raises:
        ConfigError: ``device.element`` for keys that are missing or do not go together.
    """
    place = f"elements.{k}"
    line = _line(sheet, place, path)
    turns = isinstance(line, Coordinate | Axis)
    if sheet.type in ("torque", "force") and turns != (sheet.type == "torque"):
        remedy = "A torque has `coordinate` or `axis`, a force has `from_m` and `to_m`."
        raise fault("element", f"a {sheet.type} does not act so", path, place, remedy=remedy)
    law, drive = _law(sheet, turns, place, path), _drive(sheet, place, path)
    if law is None and drive is None and not isinstance(line, Handle):
        need = (TURNING if turns else LINEAR).get(NEEDED.get(sheet.type, ""), "profile or channel")
        raise fault("element", f"a {sheet.type} without its law", path, place, remedy=f"Give {need}.")
    name = sheet.name or f"{sheet.type}_{k + 1}"
    return Element(name, sheet.type, sheet.between, line, law, drive, _sensor(sheet, turns))


def _line(sheet: ElementSheet, place: str, path: Path) -> Line:
    first, last = sheet.between
    if (sheet.type == "ground") != (WORLD in sheet.between):
        remedy = f"Write type: ground with between: [segment, {WORLD}]; elements between two segments have other types."
        raise fault("element", "ground and world go together", path, place, f"{first}, {last}", remedy=remedy)
    if sheet.channels is not None:
        if sheet.type != "ground" or last != WORLD or not (sheet.from_m or sheet.from_marker):
            remedy = f"Give between: [segment, {WORLD}] and from_m, the point of the segment where it holds."
            raise fault("element", "a recorded support needs its point", path, place, remedy=remedy)
        return Handle(SegmentPoint(first, sheet.from_m, sheet.from_marker or ""), sheet.channels)
    ends = (bool(sheet.from_m or sheet.from_marker), bool(sheet.to_m or sheet.to_marker))
    chosen = [key for key in ("coordinate", "axis") if getattr(sheet, key) is not None] + ["from, to"] * any(ends)
    if len(chosen) != 1 or any(ends) != all(ends):
        remedy = "Give `coordinate`, or `axis`, or from_m and to_m (or from_marker, to_marker; `via` for pulleys)."
        raise fault("element", "needs one line of action", path, place, ", ".join(chosen) or "none", remedy=remedy)
    if sheet.coordinate is not None:
        return Coordinate(sheet.coordinate)
    if sheet.axis is not None:
        return Axis(_unit(sheet.axis, f"{place}.axis", path))
    inner = [SegmentPoint(via.segment, via.point_m, via.marker or "") for via in sheet.via]
    rail = None if sheet.rail is None else _unit(sheet.rail, f"{place}.rail", path)
    begin = SegmentPoint(first, sheet.from_m, sheet.from_marker or "")
    run = (begin, *inner, SegmentPoint(last, sheet.to_m, sheet.to_marker or ""))
    if any((point.place is None) != bool(point.marker) for point in run):
        raise fault("element", "a point is given twice or not at all", path, place, remedy="Give point or marker.")
    return Run(run, rail)


def _unit(axis: Triple, place: str, path: Path) -> Triple:
    norm = math.sqrt(sum(x * x for x in axis))
    if not norm > 0.0:
        raise fault("axis", "a direction of length zero", path, place, remedy="Give it a direction.")
    return axis[0] / norm, axis[1] / norm, axis[2] / norm


def _law(sheet: ElementSheet, turns: bool, place: str, path: Path) -> Law | None:
    wrong = LINEAR if turns else TURNING
    stray = [key for key in (*wrong.values(), *(("force_N",) if turns else ())) if getattr(sheet, key) is not None]
    if stray:
        unit = "an angle" if turns else "a length"
        remedy = f"Use keys such as {', '.join((TURNING if turns else LINEAR).values())}."
        raise fault("element", f"it acts on {unit}", path, f"{place}.{stray[0]}", remedy=remedy)
    given: dict[str, Any] = {
        name: number(getattr(sheet, key))
        for name, key in (TURNING if turns else LINEAR).items()
        if getattr(sheet, key) is not None
    }
    if sheet.force_N is not None:
        if "preload" in given:
            raise fault("element", "force_N and preload_N are one", path, place, remedy="Leave one.")
        given["preload"] = number(sheet.force_N)
    if not given and sheet.table is None:
        return None
    tight = sheet.type == "cable" if sheet.tension_only is None else sheet.tension_only
    law = Law(tension_only=tight, table=_rising(sheet.table or (), f"{place}.table", path), **given)
    return law


def _rising(table: tuple[tuple[float, float], ...], place: str, path: Path) -> tuple[tuple[float, float], ...]:
    if any(not a[0] < b[0] for a, b in zip(table, table[1:], strict=False)) or len(table) == 1:
        raise fault("table", "a table needs two rows or more, rising", path, place, remedy="Sort its rows.")
    return table


def _drive(sheet: ElementSheet, place: str, path: Path) -> Drive | None:
    if sheet.channel is None and sheet.profile is None:
        return None
    if sheet.channel is not None and sheet.profile is not None:
        raise fault("element", "channel and profile are both given", path, place, remedy="Leave one.")
    gain = SheetValue(1.0) if sheet.gain is None else number(sheet.gain)
    lag = SheetValue(0.0) if sheet.lag_s is None else number(sheet.lag_s)
    if sheet.profile is None:
        return Drive(sheet.channel or "", gain=gain, lag=lag)
    return Drive("", sheet.profile.over, _profile(sheet.profile, f"{place}.profile", path), gain, lag)


def _profile(sheet: ProfileSheet, place: str, path: Path) -> tuple[tuple[float, float], ...]:
    if (sheet.file is None) == (sheet.table is None):
        raise fault("profile", "needs a file or a table", path, place, remedy="Give one of them.")
    if sheet.table is not None:
        return _rising(sheet.table, place, path)
    file = path.parent / str(sheet.file)
    try:
        with file.open(newline="", encoding="utf-8") as lines:
            rows = list(csv.reader(lines))
        column = 1 if sheet.column is None else rows[0].index(sheet.column)
        pairs = tuple((float(row[0]), float(row[column])) for row in rows[1:] if row)
    except (OSError, ValueError, IndexError) as error:
        remedy = "Write a header and two columns of numbers, the abscissa first."
        raise fault("profile", "cannot be read", file, place, str(error)[:80], remedy=remedy) from error
    return _rising(pairs, place, file)


def _sensor(sheet: ElementSheet, turns: bool) -> Sensor:
    own = sheet.sensor
    if own is None:
        return Sensor()
    force, length = (own.torque, own.angle) if turns else (own.force, own.length)
    return Sensor(force or "", length or "", own.sd)
