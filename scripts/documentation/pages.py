"""Which pages there are, and what Markdown looks like."""

import re
from collections.abc import Iterator
from pathlib import Path

TOP = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")
FENCE = re.compile(
    r"^(?P<indent> *)(?P<fence>`{3,}|~{3,}) *(?P<info>[^`\n]*)\n(?P<code>.*?)^ *(?P=fence) *$",
    re.MULTILINE | re.DOTALL,
)
"""A fenced block."""
_CODE = re.compile(r"(`+)(?!`).+?(?<!`)\1(?!`)", re.S)
_HEADING = re.compile(r"^#{1,6} +(.+?) *#* *$", re.M)
_ID = re.compile(r"<a +(?:id|name)=[\"']([^\"']+)[\"']")


def pages(root: Path) -> list[Path]:
    """All Markdown pages of the project that people read."""
    return [path for name in TOP if (path := root / name).exists()] + sorted((root / "docs").rglob("*.md"))


def prose(text: str) -> str:
    """The text without what is code, so that no link is seen in there; line numbers stay."""
    text = FENCE.sub(lambda match: "\n" * match[0].count("\n"), text)
    return _CODE.sub(lambda match: "\n" * match[0].count("\n"), text)


def anchors(text: str) -> set[str]:
    """What ``#...`` may point at: slugs of headings as GitHub makes them, and explicit ids."""
    found: set[str] = set(_ID.findall(text))
    for slug in map(_slug, _HEADING.findall(FENCE.sub("", text))):
        found.add(next(name for name in _numbered(slug) if name not in found))
    return found


def _slug(heading: str) -> str:
    shown = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)  # a link counts with what is shown of it
    return re.sub(r"[^\w\- ]", "", shown.lower().strip()).replace(" ", "-")


def _numbered(slug: str) -> Iterator[str]:
    yield slug
    yield from (f"{slug}-{k}" for k in range(1, 1000))
