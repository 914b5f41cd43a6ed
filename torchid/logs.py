"""Where torchid's log goes: the terminal's error stream, with no names of subjects in it (health data)."""

import logging
import sys


def configure_logging(debug: bool = False) -> None:
    """Send warnings, or with ``debug`` everything, to stderr; the library itself sets up nothing."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        logging.Formatter("%(asctime)s %(name)s %(levelname)s: %(message)s" if debug else "%(message)s")
    )
    root = logging.getLogger("torchid")
    root.handlers[:] = [handler]
    root.setLevel(logging.DEBUG if debug else logging.WARNING)
    root.propagate = False
    logging.captureWarnings(True)
