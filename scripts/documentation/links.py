"""Links of Markdown pages: files and anchors must exist, addresses of the web be well formed; nothing is fetched."""

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from documentation.pages import anchors, pages, prose

ROOT = Path(__file__).resolve().parents[2]
_INLINE = re.compile(r"\]\(\s*<?([^()\s<>]*(?:\([^()\s]*\)[^()\s<>]*)*)>?(?:\s+[\"'][^\"']*[\"'])?\s*\)")
_REFERENCE = re.compile(r"^ {0,3}\[[^\]]+\]:\s*<?(\S+?)>?(?:\s+[\"'(].*)?$", re.M)
_TAG = re.compile(r"<(?:a|img|source)\b[^>]*?\b(?:href|src)=[\"']([^\"']*)[\"']")


@dataclass(frozen=True)
class Link:
    """One link of a page."""

    page: Path
    line: int
    target: str
    """As written."""

    @property
    def external(self) -> bool:
        """It leads out of the project."""
        return bool(urlsplit(self.target).scheme)

    @property
    def path(self) -> Path:
        """The file or folder that an internal link names."""
        name = unquote(urlsplit(self.target).path)
        return (self.page.parent / name).resolve() if name else self.page.resolve()

    @property
    def anchor(self) -> str:
        """The part after ``#``; empty where there is none."""
        return unquote(urlsplit(self.target).fragment)


def links(page: Path) -> Iterator[Link]:
    """All links and pictures of a page."""
    text = prose(page.read_text(encoding="utf-8"))
    for pattern in (_INLINE, _REFERENCE, _TAG):
        for match in pattern.finditer(text):
            yield Link(page, text.count("\n", 0, match.start()) + 1, match[1])


def broken(root: Path) -> list[str]:
    """A line for every link of the project's pages that leads nowhere."""
    found = []
    for page in pages(root):
        for link in links(page):
            fault = _bad_address(link.target) if link.external else _missing(link, root.resolve())
            if fault:
                found.append(f"{page.relative_to(root)}:{link.line}: {link.target or '(empty)'}: {fault}")
    return found


def _bad_address(target: str) -> str:
    parts = urlsplit(target)
    if parts.scheme == "mailto":
        return "" if re.fullmatch(r"[^@\s]+@[^@\s]+\.[^@\s]+", parts.path) else "no mail address"
    if parts.scheme not in ("http", "https"):
        return f"unknown scheme {parts.scheme}"
    return "" if re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.hostname or "") else "no host"


def _missing(link: Link, root: Path) -> str:
    if not link.target:
        return "no target"
    if root not in (link.path, *link.path.parents):
        return "lies outside the project"
    if not link.path.exists():
        return "no such file"
    if link.anchor and link.path.suffix == ".md":
        known = anchors(link.path.read_text(encoding="utf-8"))
        return "" if link.anchor in known else f"no such heading; there are {', '.join(sorted(known))}"
    return ""


def unlinked(root: Path, entrances: Sequence[str] = ("README.md", "docs/index.md")) -> list[str]:
    """Pages that no entrance names, so that nobody finds them."""
    starts = [root / name for name in entrances if (root / name).exists()]
    reached = {link.path for start in starts for link in links(start) if not link.external}
    reached |= {start.resolve() for start in starts}
    return [str(page.relative_to(root)) for page in pages(root) if page.resolve() not in reached]


def main() -> int:
    """Print what is wrong; 1 if anything is."""
    faults = broken(ROOT) + [f"{page}: neither README.md nor docs/index.md links it" for page in unlinked(ROOT)]
    print("\n".join(faults) or f"All links of {len(pages(ROOT))} pages lead somewhere.")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
