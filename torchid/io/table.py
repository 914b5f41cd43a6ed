"""Cells, rows and time columns of text files (TRC, MOT, STO)."""

import math

import numpy as np
from jaxtyping import Float

from torchid.errors import InputError, Note

MISSING = frozenset(
    ["", "nan", "-nan", "+nan", "na", "n/a", "null", "none", "-", "nan(ind)", "-nan(ind)", "missing"]
    + ["1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf"]
)
ROUNDED = 0.01
"""Deviation of a stored time from a uniform clock, in periods, above which the rounding is said."""
IRREGULAR = 0.5
"""Deviation in periods above which samples are missing or doubled."""


def split_row(line: str) -> list[str]:
    """Cells of a row: by tabs where it has any, else by blanks; without surrounding blanks."""
    return [cell.strip() for cell in line.split("\t")] if "\t" in line.strip() else line.split()


def number(cell: str, source: str, line: int, column: int) -> float:
    """A cell's value, NaN where it is one of the spellings of a missing value.

    Raises:
        InputError: ``text.decimal_comma`` or ``text.number``.
    """
    try:
        value = float(cell)
        if "_" not in cell:
            return value
    except ValueError:
        if cell.lower() in MISSING:
            return math.nan
    comma = cell.count(",") == 1 and cell.replace(",", "", 1).lstrip("+-").replace(".", "", 1).isdigit()
    raise InputError(
        "text.decimal_comma" if comma else "text.number",
        "numbers are written with a comma" if comma else "a cell is not a number",
        source=source,
        place=f"line {line}, column {column}",
        found=repr(cell[:40]),
        remedy="Export the file with decimal points" if comma else "Correct or export the file again",
    )


def parse_rows(
    lines: list[tuple[int, str]], width: int, source: str, notes: list[Note]
) -> Float[np.ndarray, "rows width"]:
    """Rows (line number, text) as numbers (rows, width).

    Blank cells after the last column are ignored. A last row of wrong length is dropped and said.

    Raises:
        InputError: ``text.row`` where another row is too short or too long, ``text.number`` where a cell is none.
    """
    rows = []
    for position, (line, text) in enumerate(lines):
        cells = split_row(text)
        if len(cells) < width or any(cells[width:]):
            if position == len(lines) - 1 and rows:
                notes.append(Note("text.last_row", f"line {line}, the last, is incomplete and left out", source))
                break
            raise InputError(
                "text.row",
                "a row has the wrong number of cells",
                source=source,
                place=f"line {line}",
                found=f"{len(cells)} instead of {width}",
                remedy="Correct that line or export the file again",
            )
        rows.append(_row(cells[:width], source, line))
    return np.array(rows, dtype=float).reshape(len(rows), width)


def _row(cells: list[str], source: str, line: int) -> list[float]:
    """All cells of a row as numbers; a row of plain numbers takes the short way."""
    try:
        if not any("_" in cell for cell in cells):
            return [float(cell) for cell in cells]
    except ValueError:
        pass
    return [number(cell, source, line, k + 1) for k, cell in enumerate(cells)]


def uniform_clock(
    times: Float[np.ndarray, " rows"], source: str, notes: list[Note], nominal: float | None = None
) -> Float[np.ndarray, " rows"]:
    """The uniform clock behind a time column that may be rounded.

    Args:
        times: as stored [s].
        source: the file.
        notes: rounding is said here.
        nominal: rate that the file states [Hz]; used where it fits the column at least as well as first and last time.

    Raises:
        InputError: ``time.invalid``, ``time.order`` or ``time.irregular``.
    """
    if not np.isfinite(times).all():
        raise _bad_time("time.invalid", "a time is missing", int(np.argmin(np.isfinite(times))), times, source)
    if len(times) < 2:
        return times
    steps = np.diff(times)
    if (steps <= 0).any():
        raise _bad_time("time.order", "time does not increase", int(np.argmax(steps <= 0)) + 1, times, source)
    count = np.arange(len(times))
    candidates = [times[0] + count * ((times[-1] - times[0]) / count[-1])]
    if nominal and 1e-3 < nominal < 1e6:
        candidates.append(times[0] + count / nominal)
    clock = min(reversed(candidates), key=lambda c: float(np.abs(times - c).max()))
    period = clock[1] - clock[0]
    deviation = np.abs(times - clock) / period
    if deviation.max() > IRREGULAR:
        raise _bad_time(
            "time.irregular", "the samples are not evenly spaced", int(np.argmax(deviation > IRREGULAR)), times, source
        )
    if deviation.max() > ROUNDED:
        text = f"times are rounded (by up to {deviation.max():.2f} periods); {1 / period:.6g} Hz throughout used"
        notes.append(Note("time.rounded", text, source))
    return clock


def _bad_time(code: str, message: str, row: int, times: np.ndarray, source: str) -> InputError:
    return InputError(
        code,
        message,
        source=source,
        place=f"data row {row + 1}",
        found=f"{times[row]:g} s",
        remedy="Export the file again with every sample on one clock",
    )
