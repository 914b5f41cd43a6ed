"""TRC files: marker trajectories as tab-separated text."""

from pathlib import Path

import numpy as np

from torchid.errors import InputError, Note
from torchid.io.clock import Clock, uniform_clock
from torchid.io.files import read_lines
from torchid.io.force_names import refuse_forces
from torchid.io.raw import MarkerTable
from torchid.io.table import Rows, parse_rows, split_row

PARTLY = 0.5
"""Share of a marker's points that may lack a coordinate: cells are damaged now and then, not in every other row."""


def read_trc(path: str | Path) -> MarkerTable:
    """A TRC file; a blank cell keeps its column, whatever the number of tabs in the header.

    Rows that the time column shows to be missing become frames without markers.

    Raises:
        InputError: ``trc.signature``, ``trc.header``, ``trc.columns``, ``trc.empty``, ``trc.forces``, ``text.*`` and
            ``time.*``.
    """
    source, notes = str(path), []
    lines = read_lines(Path(path))
    _refuse_others(lines, source)
    header = dict(zip((key.lower() for key in lines[1].split()), lines[2].split(), strict=False))
    labels = _labels(lines[3], source)
    refuse_forces(labels, source)
    first = next((k for k in range(4, len(lines)) if lines[k].strip()), len(lines))
    if first < len(lines) and not _is_number(split_row(lines[first])):
        first += 1
    more = (_float(header.get("nummarkers")) or 0) > len(labels)
    rows = parse_rows(lines, first, 2 + 3 * len(labels), source, notes, more)
    if not len(rows.lines):
        raise InputError("trc.empty", "the file has no frames", source=source, remedy="Export the trial again")
    for key, actual in (("numframes", len(rows.lines)), ("nummarkers", len(labels))):
        notes += _counted(header, key, actual, source)
    clock = uniform_clock(rows.values[:, 1], rows.lines, source, notes, _float(header.get("datarate")))
    notes += [*_rate_note(header, clock, source), *_numbers_note(rows, clock, source)]
    position = rows.values[:, 2:].reshape(len(rows.lines), len(labels), 3)
    notes += _whole_points(position, labels, rows.lines, source)
    return MarkerTable(
        tuple(labels), clock.time, clock.spread(position), clock.spread(rows.lines, 0), _units(header), tuple(notes)
    )


def _refuse_others(lines: list[str], source: str) -> None:
    """Refuse files that are no TRC, and those that end before their labels."""
    if not lines[0].lstrip().lower().startswith("pathfiletype"):
        raise InputError(
            "trc.signature", "this is no TRC file", source=source, place="line 1", found=repr(lines[0][:40]),
            remedy="The first line must begin with PathFileType",
        )  # fmt: skip
    if not any(line.strip() for line in lines[3:]):
        last = max(k for k, line in enumerate(lines) if line.strip())
        raise InputError(
            "trc.header", "the file ends in its header: it has no labels and no frames", source=source,
            place=f"line {last + 1}, the last", found=repr(lines[last][:60]), remedy="Copy or export the file again",
        )  # fmt: skip


def _labels(line: str, source: str) -> list[str]:
    """Labels at every third cell after Frame# and Time; where tabs are irregular, the cells that are not blank."""
    cells = split_row(line)
    named = [k for k, cell in enumerate(cells) if cell]
    if len(named) < 3 or not cells[0].lower().startswith("frame"):
        raise InputError(
            "trc.columns",
            "the line of labels is missing",
            source=source,
            place="line 4",
            found=repr(line[:60]),
            remedy="Line 4 must hold Frame#, Time and the labels",
        )
    if all((k - 2) % 3 == 0 for k in named[2:]) and named[:2] == [0, 1]:
        return cells[2 : named[-1] + 1 : 3]
    return [cells[k] for k in named[2:]]


def _is_number(cells: list[str]) -> bool:
    return bool(cells) and _float(cells[0]) is not None


def _float(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None


def _units(header: dict[str, str]) -> str:
    """The unit, empty where the file has none (a number in its place means that a value before it is missing)."""
    units = header.get("units", "")
    return "" if _float(units) is not None else units


def _counted(header: dict[str, str], key: str, actual: int, source: str) -> list[Note]:
    stated = _float(header.get(key))
    if stated is None or stated == actual:
        return []
    return [Note("trc.counts", f"{key} is {stated:g}, the file holds {actual}", source)]


def _rate_note(header: dict[str, str], clock: Clock, source: str) -> list[Note]:
    stated = _float(header.get("datarate"))
    if not stated or not clock.rate or abs(stated - clock.rate) <= 0.01 * clock.rate:
        return []
    text = f"DataRate is {stated:g} Hz, the time column runs at {clock.rate:g} Hz and is used"
    return [Note("trc.rate", text, source)]


def _numbers_note(rows: Rows, clock: Clock, source: str) -> list[Note]:
    """Frame numbers that do not count on as the time column does."""
    numbers = rows.values[:, 0]
    if len(numbers) < 3 or not np.isfinite(numbers).all():
        return []
    steps = np.diff(numbers) / np.diff(clock.rows)
    wrong = np.flatnonzero(steps != np.median(steps))
    if not len(wrong):
        return []
    at = int(wrong[0]) + 1
    text = f"Frame# goes from {numbers[at - 1]:g} to {numbers[at]:g}, the time column does not; time is used"
    return [Note("trc.frame_numbers", f"line {rows.lines[at]}: {text}", source)]


def _whole_points(position: np.ndarray, labels: list[str], lines: np.ndarray, source: str) -> list[Note]:
    """Make points with one or two coordinates missing, in place; those are said.

    Raises:
        InputError: ``trc.shifted`` where most points of a marker are so: cells are missing before it in every row.
    """
    absent = np.isnan(position)
    whole = absent.any(axis=-1)
    partly = whole & ~absent.all(axis=-1)
    if not partly.any():
        return []
    frame, marker = np.argwhere(partly)[0]
    place = f"{labels[marker]} in line {lines[frame]}"
    often = partly.sum(axis=0) > PARTLY * (~absent.all(axis=-1)).sum(axis=0)
    if often.any():
        named = ", ".join(labels[k] for k in np.flatnonzero(often)[:5])
        raise InputError(
            "trc.shifted", "columns are shifted: cells are missing in the rows", source=source, place=place,
            found=f"{named} with fewer than three coordinates in most rows",
            remedy="Export the file again, with three cells for every marker",
        )  # fmt: skip
    position[whole] = np.nan
    text = f"{partly.sum()} points lack one or two coordinates and are taken as missing, the first {place}"
    return [Note("trc.partial", text, source)]
