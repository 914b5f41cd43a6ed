"""A page inside a page: what it is, and the policy under which its scripts run and no others."""

import base64
import hashlib
from dataclasses import dataclass
from html.parser import HTMLParser

CLIENT = "'sha256-o/BTEGoB4UnTxqb+3RxwUFQZkWXpqUxouHkbDNrAkqE='"
"""Of the script that the page of viser 1.1.1 unpacks and runs; a browser that blocks it says which one it is."""


OPENER = (
    'for(const one of document.querySelectorAll("details"))one.addEventListener("toggle",()=>{'
    'const frame=one.querySelector("iframe");if(frame&&one.open&&!frame.srcdoc)frame.srcdoc=frame.dataset.page})'
)
"""Script of the page around it: what is embedded is unpacked when somebody opens it. A frame's own ``loading`` does not
wait for that where its page comes with it."""


@dataclass(frozen=True)
class EmbeddedPage:
    """A page to be put into an ``iframe``."""

    html: str
    policy: str
    """Content-Security-Policy under which its scripts run, and no others."""
    trial: str
    seconds: float


def policy(html: str) -> str:
    """Return a Content-Security-Policy that lets the scripts of a page run, and ``OPENER``, known by their hashes."""
    found = _Scripts()
    found.feed(html)
    hashes = [CLIENT, *sorted(map(hashed, {OPENER, *found.all}))]
    return (
        f"default-src 'none'; style-src 'unsafe-inline'; script-src {' '.join(hashes)} 'wasm-unsafe-eval'; "
        "worker-src blob: data:; connect-src blob: data:; img-src blob: data:; font-src data:; base-uri 'none'; "
        "form-action 'none'"
    )


def hashed(script: str) -> str:
    """Return the word by which a policy allows a script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


class _Scripts(HTMLParser):
    """Collects the text of every script."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=False)
        self.all: list[str] = []
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "script":
            self._inside = True
            self.all.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = self._inside and tag != "script"

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.all[-1] += data
