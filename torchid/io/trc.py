"""TRC files: marker trajectories as tab-separated text."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from torchid.conventions import y_up_to_z_up
from torchid.errors import InputError, Note
from torchid.files import write_text
from torchid.io.files import read_lines
from torchid.io.labels import refuse_forces
from torchid.io.table import parse_rows, split_row, uniform_clock
from torchid.recording import Markers


@dataclass(frozen=True)
class TrcFile:
    """The content of a TRC file in its own unit and axes."""

    labels: tuple[str, ...]
    time: Float[np.ndarray, " frames"]
    position: Float[np.ndarray, "frames markers 3"]
    """NaN where cells are blank."""
    units: str
    header: dict[str, str]
    notes: tuple[Note, ...]


def read_trc(path: str | Path) -> TrcFile:
    """A TRC file; a blank cell keeps its column, whatever the number of tabs in the header.

    Raises:
        InputError: ``trc.signature``, ``trc.columns``, ``trc.empty``, ``trc.forces``, ``text.*`` and ``time.*``.
    """
    source, notes = str(path), []
    lines = read_lines(Path(path))
    if len(lines) < 5 or not lines[0].lstrip().lower().startswith("pathfiletype"):
        raise InputError(
            "trc.signature",
            "this is no TRC file",
            source=source,
            place="line 1",
            found=repr(lines[0][:40]),
            remedy="The first line must begin with PathFileType",
        )
    header = dict(zip((key.lower() for key in lines[1].split()), lines[2].split(), strict=False))
    labels = _labels(lines[3], source)
    refuse_forces(labels, source)
    rows = [(k + 1, lines[k]) for k in range(4, len(lines)) if lines[k].strip()]
    if rows and not _is_number(split_row(rows[0][1])):
        rows = rows[1:]
    if not rows:
        raise InputError("trc.empty", "the file has no frames", source=source, remedy="Export the trial again")
    table = parse_rows(rows, 2 + 3 * len(labels), source, notes)
    notes += _counted(header, "numframes", len(table), source) + _counted(header, "nummarkers", len(labels), source)
    time = uniform_clock(table[:, 1], source, notes, _float(header.get("datarate")))
    notes += _rate_note(header, time, source)
    position = table[:, 2:].reshape(len(table), len(labels), 3)
    position[np.isnan(position).any(axis=-1)] = np.nan
    return TrcFile(tuple(labels), time, position, _units(header), header, tuple(notes))


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


def _rate_note(header: dict[str, str], time: np.ndarray, source: str) -> list[Note]:
    stated = _float(header.get("datarate"))
    if not stated or len(time) < 2:
        return []
    rate = (len(time) - 1) / (time[-1] - time[0])
    if abs(stated - rate) <= 0.01 * rate:
        return []
    return [Note("trc.rate", f"DataRate is {stated:g} Hz, the time column runs at {rate:g} Hz and is used", source)]


def write_trc(path: str | Path, markers: Markers, y_up: bool = True) -> None:
    """Write markers as TRC in m, with Y up as OpenSim expects or in W; gaps are blank cells. Whole or not at all."""
    position = markers.position
    for _ in range(3 if y_up else 0):
        # The rotation by +90 degrees about X taken three times is its inverse.
        position = y_up_to_z_up(position)
    values = position.detach().cpu().numpy()
    count, rate = len(markers.labels), markers.rate if len(markers.time) > 1 else 0.0
    keys = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame")
    facts = (f"{rate:.10g}", f"{rate:.10g}", len(values), count, "m", f"{rate:.10g}", 1, len(values))
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "\t".join((*keys, "OrigNumFrames")),
        "\t".join(str(fact) for fact in facts),
        "Frame#\tTime\t" + "\t\t\t".join(markers.labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(count) for axis in "XYZ"),
        "",
    ]
    rows = (
        "\t".join([str(k + 1), f"{float(t):.10g}", *("" if np.isnan(x) else f"{x:.9g}" for x in frame.ravel())])
        for k, (t, frame) in enumerate(zip(markers.time, values, strict=True))
    )
    write_text(path, "\n".join([*head, *rows]) + "\n")
