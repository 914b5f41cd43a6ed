"""The table of thresholds in docs/diagnosis.md, made of the options' docstrings.

PYTHONPATH=.:scripts python -m documentation.thresholds
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from torchid.diagnosis.options import SECTIONS, threshold_kinds

PAGE = Path(__file__).resolve().parents[2] / "docs" / "diagnosis.md"
START, STOP = "<!-- thresholds -->\n", "\n<!-- /thresholds -->"


def rows() -> Iterator[str]:
    """A row a threshold: name, value, kind, reason."""
    yield from ("| threshold | value | kind | reason |", "|---|---|---|---|")
    kinds = threshold_kinds()
    for section in SECTIONS:
        for own in dataclasses.fields(section):
            kind, reason = kinds[f"{section.__name__}.{own.name}"]
            reason = " ".join(reason.split())
            yield f"| `{section.__name__}.{own.name}` | {own.default:g} | {kind.value.lower()} | {reason} |"


def table(page: str) -> str:
    """The table as a page has it."""
    return page.split(START)[1].split(STOP)[0]


def main() -> None:
    """Write the table into the page."""
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(page.replace(table(page), "\n".join(rows())), encoding="utf-8")


if __name__ == "__main__":
    main()
