"""Rows of JSON, one a line, which a command that was stopped goes on from; figures of rows."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def read_lines(path: Path) -> list[Row]:
    """The rows of a file, none where it is absent."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def add_line(path: Path, row: Row) -> None:
    """Write one more row."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def write_lines(path: Path, rows: Iterable[Row]) -> None:
    """Write all rows."""
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write a document, its folder as well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def figures(row: Mapping[str, Any], size: str = ".3g") -> str:
    """A row's numbers in a line."""
    return "  ".join(f"{key} {value:{size}}" for key, value in row.items() if isinstance(value, int | float))


def means(rows: Sequence[Row]) -> Row:
    """Over all rows, of every figure but the seed."""
    return {key: sum(row[key] for row in rows) / len(rows) for key in rows[0] if key != "seed"}


def listed(row: Mapping[str, float], width: int) -> None:
    """Print a row's figures below each other."""
    for what, value in row.items():
        print(f"{what:{width}s} {value:8.3g}")
