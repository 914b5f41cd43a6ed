"""Where torchid's log goes: the terminal's error stream, with no names of subjects in it (health data)."""

import logging
import sys

from torchid.wording import visible


class _Visible(logging.Formatter):
    """Messages that quote a file cannot write to the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return visible(super().format(record))


def configure_logging(debug: bool = False) -> None:
    """Send warnings, or with ``debug`` everything, to stderr; the library itself sets up nothing."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Visible("%(asctime)s %(name)s %(levelname)s: %(message)s" if debug else "%(message)s"))
    root = logging.getLogger("torchid")
    root.handlers[:] = [handler]
    root.setLevel(logging.DEBUG if debug else logging.WARNING)
    root.propagate = False
    logging.captureWarnings(True)
