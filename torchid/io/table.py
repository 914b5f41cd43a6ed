"""Cells and rows of text files (TRC, MOT, STO)."""

import math
import re
from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from torchid.errors import InputError, Note

MISSING = frozenset(
    ["", "nan", "-nan", "+nan", "na", "n/a", "null", "none", "-", "nan(ind)", "-nan(ind)", "missing"]
    + ["1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf"]
)
NUMBER = re.compile(r"[+-]?(?:\d+\.?|\.(?=\d))(?P<decimals>(?<=\.)\d+)?(?:[eE][+-]?(?P<exponent>\d+))?")
"""A whole number, a decimal or a power of ten."""
RECENT = 1000
"""So many rows before the last show how its last cell is written."""


@dataclass(frozen=True)
class Rows:
    """The numbers of a text table."""

    values: Float[np.ndarray, "rows width"]
    """NaN where a cell is blank or spelled so."""
    lines: Int[np.ndarray, " rows"]
    """Line of the file in which each row stands, from 1."""


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
        "numbers are written with a comma" if comma else "a cell is not a number", source=source,
        place=f"line {line}, column {column}", found=repr(cell[:40]),
        remedy="Export the file with decimal points" if comma else "Correct or export the file again",
    )  # fmt: skip


def parse_rows(lines: list[str], first: int, width: int, source: str, notes: list[Note], more: bool = False) -> Rows:
    """The rows of a file from line number ``first`` (counted from 0) on as numbers; blank lines are skipped.

    Blank cells after the last column are ignored, with ``more`` others as well. A last row of wrong length is dropped
    and said. A last row without line end may be cut in its last cell: it is dropped and said where that cell shows it
    (``_cut``), else kept and said.

    Raises:
        InputError: ``text.row`` where another row is too short or too long, or is shorter than its like and lacks its
            last value (a cell is missing before it, so that all columns after that are shifted), ``text.number`` where
            a cell is none.
    """
    stand = [k for k in range(first, len(lines)) if lines[k].strip()]
    tabs = Counter(lines[k].count("\t") for k in stand)
    usual = tabs.most_common(1)[0][0] if tabs else 0
    if len(stand) > 1 and stand[-1] == len(lines) - 1:
        stand = _without_cut(lines, stand, width, usual, source, notes)
    values = _plain_rows([lines[k] for k in stand], width, usual) if len(tabs) == 1 and not more else None
    if values is None:
        values = _careful_rows(lines, stand, width, 0 if more else usual, source, notes, more)
    return Rows(values, np.array(stand[: len(values)], dtype=int) + 1)


def _plain_rows(rows: list[str], width: int, tabs: int) -> np.ndarray | None:
    """Rows with equally many tabs and numbers or blanks alone, the quick way; None where any is not so."""
    if tabs < width - 1 or any(any(map(str.strip, row.rsplit("\t", tabs + 1 - width)[1:])) for row in rows):
        return None
    # Twice: a blank cell's second tab is the first one of the next.
    rows = [row.replace("\t\t", "\tnan\t").replace("\t\t", "\tnan\t") if "\t\t" in row else row for row in rows]
    try:
        return np.loadtxt(rows, delimiter="\t", usecols=range(width), comments=None, ndmin=2)
    except ValueError:
        return None


def _careful_rows(
    lines: list[str], stand: list[int], width: int, usual: int, source: str, notes: list[Note], more: bool
) -> np.ndarray:
    """Rows one after the other, each judged as ``parse_rows`` says."""
    rows = []
    for k in stand:
        cells = split_row(lines[k])
        short = lines[k].count("\t") < usual and not any(cells[width - 1 :])
        if len(cells) < width or short or any(cells[width:]) and not more:
            if k == stand[-1] and rows:
                notes.append(Note("text.last_row", f"line {k + 1}, the last, is incomplete and left out", source))
                break
            raise _bad_row(len(cells), width, short, k + 1, source)
        rows.append(_row(cells[:width], source, k + 1))
    return np.array(rows, dtype=float).reshape(len(rows), width)


def _bad_row(count: int, width: int, short: bool, line: int, source: str) -> InputError:
    return InputError(
        "text.row",
        "a row has fewer cells than the others: its columns may be shifted" if short and count >= width
        else "a row has the wrong number of cells",
        source=source,
        place=f"line {line}",
        found=f"{count} cells for {width} columns",
        remedy="Correct that line or export the file again",
    )  # fmt: skip


def _without_cut(
    lines: list[str], stand: list[int], width: int, usual: int, source: str, notes: list[Note]
) -> list[int]:
    """The rows without the last, which has no line end, where its last cell is cut; what was decided is said."""
    cells = split_row(lines[stand[-1]])
    if len(cells) < width:
        return stand
    before = [split_row(lines[k]) for k in stand[-1 - RECENT : -1]]
    like = [row[width - 1] for row in before if len(row) >= width]
    where = f"line {stand[-1] + 1}, the last, has no line end"
    if lines[stand[-1]].count("\t") < usual or _cut(cells[width - 1], like):
        text = f"{where} and seems cut in its last cell ({cells[width - 1][:20]!r}); it is left out"
        notes.append(Note("text.last_row", text, source))
        return stand[:-1]
    notes.append(Note("text.no_line_end", f"{where}; it looks whole and is kept", source))
    return stand


def _cut(cell: str, like: list[str]) -> bool:
    """Whether a cell at the end of a file looks cut beside those above it.

    It does where it is no number, where it is missing below a number, and where it has fewer decimals or fewer digits
    of its exponent than every number above. A cut that takes no more than the varying zeros of a cell cannot be seen.
    """
    if cell.lower() in MISSING:
        return bool(like) and like[-1].lower() not in MISSING
    own = NUMBER.fullmatch(cell)
    if own is None:
        return True
    above = [match for match in map(NUMBER.fullmatch, like) if match]
    decimals = [_digits(match, "decimals") for match in above]
    exponents = [_digits(match, "exponent") for match in above if match["exponent"]]
    always = bool(above) and len(exponents) == len(above)
    shorter = (always or bool(own["exponent"])) and _digits(own, "exponent") < min(exponents, default=0)
    return shorter or _digits(own, "decimals") < min(decimals, default=0)


def _digits(match: re.Match[str], part: str) -> int:
    return len(match[part] or "")


def _row(cells: list[str], source: str, line: int) -> list[float]:
    """All cells of a row as numbers; a row of plain numbers takes the short way."""
    try:
        if not any("_" in cell for cell in cells):
            return [float(cell) for cell in cells]
    except ValueError:
        pass
    return [number(cell, source, line, k + 1) for k, cell in enumerate(cells)]
