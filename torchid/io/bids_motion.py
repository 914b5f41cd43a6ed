"""Motion-BIDS: positions of tracked points in a ``_motion.tsv``, described by files beside it or above it.

The layout is that of the Brain Imaging Data Structure, part Motion (Jeung et al., 2024, Scientific Data 11, 716):
columns without names, a row of ``_channels.tsv`` for each, the rate in ``_motion.json``. A description may stand in the
folder of the file or in one above it, under a name that has some of the file's entities; the nearest holds.
"""

import csv
import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

from torchid.errors import InputError, Note
from torchid.io.clock import Clock, uniform_clock
from torchid.io.files import MOTION_BIDS, bids_subject, described_in, read_bytes, read_lines
from torchid.io.raw import MarkerTable
from torchid.io.table import Rows, parse_rows

COLUMNS = ("component", "type", "tracked_point", "units")
"""Columns of ``_channels.tsv`` that are read."""
Channels = list[dict[str, str]]
"""Rows of a ``_channels.tsv``."""


def read_bids_motion(file: Path) -> MarkerTable:
    """Points with positions on three axes, in the file's unit and axes; all other channels are left out.

    The clock is the channel of latencies, else the effective rate, else the nominal one.

    Raises:
        InputError: ``bids.sidecar`` where a description is absent or cannot be read, ``bids.channels`` where it is not
            of these columns, ``bids.positions`` without positions, ``bids.rate`` without a rate, ``bids.empty``;
            ``text.*`` and ``time.*``.
    """
    source, notes = str(file), list[Note]()
    channels, stated = _channels(file), _merged(file, MOTION_BIDS.replace(".tsv", ".json"))
    rows = parse_rows(read_lines(file), 0, len(channels), source, notes)
    if not len(rows.lines):
        raise InputError("bids.empty", "the file has no frames", source=source, remedy="Export the trial again")
    points = _points(channels, source)
    clock = _clock(rows, channels, stated, source, notes)
    units = {channels[k]["units"].strip() for columns in points.values() for k in columns}
    if len(units) > 1:
        raise _wrong("positions have several units", ", ".join(sorted(units)), source)
    position = np.stack([rows.values[:, columns] for columns in points.values()], axis=1)
    subject = bids_subject(file)
    return MarkerTable(
        tuple(points), clock.time, clock.spread(position), clock.spread(rows.lines, 0), units.pop(), tuple(notes),
        () if subject is None else (("subject", subject),), _up(file, channels, points), "z", "BIDS",
    )  # fmt: skip


def _merged(file: Path, ending: str) -> dict:
    """What JSON files say together, of which the nearest has the last word."""
    merged: dict = {}
    for one in reversed(described_in(file, ending)):
        try:
            said = json.loads(read_bytes(one).decode("utf-8-sig", "replace"))
        except (ValueError, RecursionError) as error:
            raise InputError(
                "bids.sidecar", "this is no JSON", source=one, found=str(error)[:80], remedy="Correct the file"
            ) from None
        merged |= said if isinstance(said, dict) else {}
    return merged


def _channels(file: Path) -> Channels:
    """What each column is."""
    found = described_in(file, "_channels.tsv")
    if not found:
        raise InputError(
            "bids.sidecar", "no file says what its columns are", source=file,
            remedy=f"Put {file.name.replace(MOTION_BIDS, '_channels.tsv')} beside it, as BIDS asks for",
        )  # fmt: skip
    lines = [line for line in read_lines(found[0]) if line.strip()]
    rows = [{key: value or "" for key, value in row.items() if key} for row in csv.DictReader(lines, delimiter="\t")]
    absent = [name for name in COLUMNS if not rows or name not in rows[0]]
    if absent:
        raise _wrong("columns of the description are missing", ", ".join(absent), str(found[0]))
    return rows


def _points(channels: Channels, source: str) -> dict[str, list[int]]:
    """Columns x, y and z of the position of each point."""
    found: dict[str, dict[str, int]] = {}
    for k, channel in enumerate(channels):
        if channel["type"].strip().upper() == "POS":
            axes = found.setdefault(channel["tracked_point"].strip(), {})
            axis = channel["component"].strip().lower()
            if axis in axes or axis not in ("x", "y", "z"):
                text = f"{channel['tracked_point']} {axis}"
                raise _wrong("a position stands twice, or on no axis", text, source)
            axes[axis] = k
    if not found:
        raise InputError(
            "bids.positions", "the file has no positions of points", source=source,
            found=", ".join(sorted({channel["type"] for channel in channels})),
            remedy="Give the file of a system that measures markers (type POS)",
        )  # fmt: skip
    partly = [point for point, axes in found.items() if len(axes) < 3]
    if partly:
        raise _wrong("points lack an axis", ", ".join(partly[:8]), source)
    return {point: [axes[axis] for axis in "xyz"] for point, axes in found.items()}


def _wrong(message: str, found: str, source: str) -> InputError:
    return InputError(
        "bids.channels", message, source=source, found=found, remedy="Correct its _channels.tsv, a row for each column"
    )


def _number(value: object) -> float | None:
    """A number, or a text that is one."""
    try:
        return float(value) if isinstance(value, int | float | str) else None
    except (ValueError, OverflowError):
        return None


def _clock(rows: Rows, channels: Channels, stated: dict, source: str, notes: list[Note]) -> Clock:
    """The clock that latencies tell, or a rate."""
    rates = [stated.get(f"SamplingFrequency{kind}", "") for kind in ("Effective", "")]
    rate = next((hertz for one in rates if (hertz := _number(one)) is not None and 0.0 < hertz < np.inf), None)
    latencies = [k for k, channel in enumerate(channels) if channel["type"].strip().upper() == "LATENCY"]
    if latencies:
        time: Float[np.ndarray, " rows"] = rows.values[:, latencies[0]]
    elif rate is None:
        raise InputError(
            "bids.rate", "no rate is stated", source=source, place="SamplingFrequency",
            found=str(rates[1])[:40], remedy="Write it into its _motion.json [Hz]",
        )  # fmt: skip
    else:
        time = np.arange(len(rows.lines)) / rate
    return uniform_clock(time, rows.lines, source, notes, rate)


def _up(file: Path, channels: Channels, points: dict[str, list[int]]) -> str:
    """The axis that points up by the frame of the positions, in either spelling of the specification (``SpatialAxes:
    ALS``, ``FLU``); empty where nothing says so."""
    frames = {channels[columns[0]].get("reference_frame", "") for columns in points.values()}
    about = _merged(file, "_channels.json").get("reference_frame", {})
    levels = about.get("Levels", {}) if isinstance(about, dict) else {}
    level = levels.get(next(iter(frames)), {}) if isinstance(levels, dict) and len(frames) == 1 else {}
    axes = str(level.get("SpatialAxes", "")) if isinstance(level, dict) else ""
    upwards = [k for k, letter in enumerate(axes.upper()) if letter in "SU"]
    return {1: "y", 2: "z"}.get(upwards[0], "") if len(axes) == 3 and len(upwards) == 1 else ""
