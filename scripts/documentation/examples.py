"""Fenced Python blocks of the pages: every one is run as printed, unless its info string says otherwise.

```python               runs alone, from an empty namespace, in an empty folder
```python continue      goes on in the namespace and folder of the block before it
```python no-run        is a fragment, and is not run
```python title="..."   is a file or a part of one, and is not run
"""

import contextlib
import io
import re
from dataclasses import dataclass
from pathlib import Path

from documentation.pages import FENCE, pages

CONTINUE, SKIP = "continue", "no-run"
_TITLE = re.compile(r"\btitle=(\"[^\"]*\"|'[^']*')")


@dataclass(frozen=True)
class Block:
    """One fenced block of Python."""

    page: Path
    line: int
    """Of its first line of code."""
    info: tuple[str, ...]
    """Words after ``python``."""
    code: str
    end: int
    """Where it ends in the text of the page."""


def blocks(page: Path, language: str = "python") -> list[Block]:
    """All blocks of a language."""
    text, found = page.read_text(encoding="utf-8"), []
    for match in FENCE.finditer(text):
        words = _TITLE.sub(SKIP, match["info"]).split()
        if words[:1] == [language]:
            line = text.count("\n", 0, match.start("code")) + 1
            indent = len(match["indent"])
            code = "".join(one[indent:] if one.strip() else one for one in match["code"].splitlines(keepends=True))
            found.append(Block(page, line, tuple(words[1:]), code, match.end()))
    return found


def runs(page: Path) -> list[list[Block]]:
    """Blocks that run, those that continue one another together."""
    found: list[list[Block]] = []
    for block in blocks(page):
        unknown = set(block.info) - {CONTINUE, SKIP}
        if unknown:
            raise ValueError(f"{page}:{block.line}: unknown word in the info string: {', '.join(unknown)}")
        if SKIP in block.info:
            continue
        if CONTINUE in block.info and not found:
            raise ValueError(f"{page}:{block.line}: nothing runs before it that it could continue")
        if CONTINUE in block.info:
            found[-1].append(block)
        else:
            found.append([block])
    return found


def all_runs(root: Path) -> list[list[Block]]:
    """Of every page of the project."""
    return [run for page in pages(root) for run in runs(page)]


def perform(run: list[Block], folder: Path) -> list[str]:
    """What each block of a run prints; files that it writes stay in the folder."""
    names: dict = {"__name__": "__main__"}
    said = []
    with contextlib.chdir(folder):
        for block in run:
            # Line numbers of an error are those of the page.
            code = compile("\n" * (block.line - 1) + block.code, str(block.page), "exec")
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(code, names)  # noqa: S102  (the project's own pages, not a user's)
            said.append(out.getvalue())
    return said
