"""A command's options in a line, its seed, and where things lie."""

import argparse
import os
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchid.config.sections import PROJECT_DATA

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("TORCHID_DATA", PROJECT_DATA))


@dataclass(frozen=True)
class Among:
    """An option that takes one of some words, or with ``several`` any number of them."""

    words: Sequence[str]
    default: Any = None
    several: bool = False
    name: str | None = None
    """Shown instead of all words."""


class Command:
    """Options of a command, by their defaults.

    ``Command(__doc__, seeds=10, skin=(0.0, "skin motion [mm]"), out=Path("out/a"), keep=False).asked()``: a number, a
    text or a path is an option of that type and its default; a type is one without a default; False is a flag; an
    ``Among`` has choices; a dict goes to argparse as it is. A pair adds a line of help, ``positional`` names what
    stands without ``--``.
    """

    def __init__(self, doc: str | None, positional: Sequence[str] = (), **options: Any) -> None:
        shape = argparse.RawDescriptionHelpFormatter
        self.parser = argparse.ArgumentParser(description=doc, formatter_class=shape)
        for name, own in options.items():
            said, words = own if isinstance(own, tuple) else (own, None)
            flag = name if name in positional else f"--{name.replace('_', '-')}"
            self.parser.add_argument(flag, help=words, **_spelled(said))

    def asked(self, given: Sequence[str] | None = None) -> argparse.Namespace:
        """What was asked for, in ``given`` or on the command line."""
        return self.parser.parse_args(given)


def _spelled(own: Any) -> dict[str, Any]:
    if isinstance(own, dict):
        return own
    if own is False:
        return {"action": "store_true"}
    if isinstance(own, type):
        return {"type": own}
    if isinstance(own, Among):
        kept = {"choices": own.words, "default": own.default, "metavar": own.name}
        return kept | ({"nargs": "+"} if own.several else {})
    return {"type": type(own), "default": own}


def said_seed(given: int | None, below: int = 2**31) -> int:
    """The seed that was given, else one by lot; printed, so that the same can be run again."""
    seed = secrets.randbelow(below) if given is None else given
    print(f"seed {seed}", flush=True)
    return seed
