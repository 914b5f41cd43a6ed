"""What is left to do in a built site, so that it needs no network."""

import os
import re
import shutil
from pathlib import Path

_FOREIGN = re.compile(r'<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)="(https?:[^"]*)')
_REMOTE = "https://unpkg.com/iframe-worker/shim"
"""What the theme loads for the search of pages that are opened as files."""
_LOCAL = Path("assets", "javascripts", "iframe_worker.js")


def finish(site: Path) -> None:
    """Give the search a script of the site's own; refuse a page that still loads something from elsewhere."""
    shutil.copy(Path(__file__).with_name(_LOCAL.name), site / _LOCAL)
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        text = text.replace(_REMOTE, os.path.relpath(site / _LOCAL, page.parent))
        page.write_text(text, encoding="utf-8")
        if foreign := _FOREIGN.search(text):
            raise ValueError(f"{page}: needs the network: {foreign[1]}")
