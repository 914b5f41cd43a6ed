"""OpenSim's MOT and STO files: a header, then columns over time."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from torchid.errors import InputError, Note
from torchid.io.files import read_lines
from torchid.io.table import parse_rows, split_row
from torchid.storage.files import atomic_write

MAX_HEADER_LINES = 500


@dataclass(frozen=True)
class Storage:
    """Columns over time, in the units of the file."""

    columns: tuple[str, ...]
    """Names without the time column."""
    time: Float[np.ndarray, " rows"]
    values: Float[np.ndarray, "rows columns"]
    """NaN where a cell is blank or spelled so."""
    header: dict[str, str] = field(default_factory=dict)
    in_degrees: bool | None = None
    """What ``inDegrees`` says, None where it is absent."""
    notes: tuple[Note, ...] = ()
    lines: Int[np.ndarray, " rows"] = field(default_factory=lambda: np.zeros(0, int))
    """Line of the file of every row, from 1; empty where the columns were never in a file."""

    def column(self, name: str) -> Float[np.ndarray, " rows"]:
        """Values (rows,) of a column.

        Raises:
            InputError: ``storage.column`` where it is absent.
        """
        if name not in self.columns:
            raise InputError(
                "storage.column", "a column is missing", place=name, found=", ".join(self.columns[:40]),
                remedy="Export the file again with this column, or rename the one that holds it",
            )  # fmt: skip
        return self.values[:, self.columns.index(name)]


def read_storage(path: str | Path) -> Storage:
    """A MOT or STO file.

    Header keys in the styles ``key=value`` (OpenSim) and ``key value`` (SIMM) are kept, keys in lower case. Columns of
    vectors (``DataType=Vec3``, cells ``x,y,z``) become three columns each, ``name_x``, ``name_y`` and ``name_z``.

    Raises:
        InputError: ``storage.header`` without ``endheader`` or column line, ``storage.type`` for cells that are neither
            numbers nor vectors, ``text.*`` for its rows.
    """
    source = str(path)
    lines = read_lines(Path(path))
    end = next((k for k, line in enumerate(lines[:MAX_HEADER_LINES]) if line.strip().lower() == "endheader"), None)
    names = next((k for k in range((end or 0) + 1, len(lines)) if lines[k].strip()), None)
    if end is None or names is None:
        raise InputError(
            "storage.header", "this is no MOT or STO file", source=source, place="header", found=repr(lines[0][:40]),
            remedy="A line endheader must stand before the line of column names",
        )  # fmt: skip
    columns = _columns(lines[names])
    header, notes = _header(lines[:end]), []
    if not columns or columns[0].lower() != "time":
        raise InputError(
            "storage.header", "the first column is not time", source=source, place=f"line {names + 1}",
            found=", ".join(columns[:8]), remedy="Export the file again",
        )  # fmt: skip
    stored = len(columns)
    if _is_vectors(header, source):
        columns = ("time", *(f"{name}_{axis}" for name in columns[1:] for axis in "xyz"))
        lines = [*lines[: names + 1], *(line.replace(",", "\t") for line in lines[names + 1 :])]
    rows = parse_rows(lines, names + 1, len(columns), source, notes)
    for keys, actual in ((("nrows", "datarows"), len(rows.lines)), (("ncolumns", "datacolumns"), stored)):
        notes += _counted(header, keys, actual, source)
    time, values = rows.values[:, 0], rows.values[:, 1:]
    return Storage(columns[1:], time, values, header, _degrees(header), tuple(notes), rows.lines)


def _is_vectors(header: dict[str, str], source: str) -> bool:
    """Whether the cells are vectors of three by the header's ``DataType``."""
    kind = header.get("datatype", "double").lower()
    if kind not in ("double", "vec3", "unitvec3"):
        raise InputError(
            "storage.type", "columns of this type are not read", source=source, place="header, DataType",
            found=header["datatype"], remedy="Write plain columns (DataType=double) or vectors (DataType=Vec3)",
        )  # fmt: skip
    return kind != "double"


def _columns(line: str) -> tuple[str, ...]:
    cells = split_row(line)
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def _header(lines: list[str]) -> dict[str, str]:
    header = {"title": lines[0].strip()} if lines else {}
    for line in lines:
        match = re.fullmatch(r"(\w+)\s*=\s*(.*)", line.strip()) or re.fullmatch(r"(\w+)\s+(\S.*)", line.strip())
        if match:
            header.setdefault(match[1].lower(), match[2].strip())
    return header


def _degrees(header: dict[str, str]) -> bool | None:
    return {"yes": True, "no": False}.get(header.get("indegrees", "").lower())


def _counted(header: dict[str, str], keys: tuple[str, ...], actual: int, source: str) -> list[Note]:
    stated = [(key, header[key][:20]) for key in keys if header.get(key, str(actual)) != str(actual)]
    return [Note("storage.counts", f"{key} is {count}, the file holds {actual}", source) for key, count in stated]


def write_storage(
    path: str | Path,
    columns: tuple[str, ...],
    time: np.ndarray,
    values: np.ndarray,
    in_degrees: bool = False,
    title: str = "torchid",
) -> None:
    """Write columns over time as MOT or STO, whole or not at all; NaN as ``nan``.

    Raises:
        ValueError: shapes that do not agree.
        InputError: ``results.unwritable``.
    """
    if values.shape != (len(time), len(columns)):
        raise ValueError(f"values {values.shape}, time {len(time)}, columns {len(columns)}")
    head = [title, "version=1", f"nRows={len(time)}", f"nColumns={len(columns) + 1}"]
    head += [f"inDegrees={'yes' if in_degrees else 'no'}", "endheader", "\t".join(("time", *columns))]
    row = "\t".join(["%.12g"] * (len(columns) + 1)) + "\n"
    with atomic_write(path) as file:
        file.write(("\n".join(head) + "\n").encode("utf-8", "replace"))
        for t, x in zip(time.tolist(), values, strict=True):
            file.write((row % (t, *x.tolist())).encode("ascii"))
