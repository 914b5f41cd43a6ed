"""How many files of torchid the data of a command walk through, inside functions that are named.

    python scripts/files_entered.py run configs/demo.yaml simulate.duration_s=3 --inside open_session,diagnose

A file counts once, as soon as one of its functions is called while the named function runs; what it imports does not.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from torchid.config import load_config
from torchid.evaluation.evaluate import evaluate
from torchid.run import run_experiment

PACKAGE = str(Path(sys.modules["torchid"].__file__ or "").parent)
COMMANDS = {"run": run_experiment, "evaluate": evaluate}


@contextmanager
def entered(names: set[str]) -> Iterator[dict[str, set[str]]]:
    """Files of the package in which something is called within functions of these names."""
    found: dict[str, set[str]] = {name: set() for name in names}
    inside: Counter[str] = Counter()

    def look(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event not in ("call", "return") or not code.co_filename.startswith(PACKAGE):
            return
        if code.co_name in names:
            inside[code.co_name] += 1 if event == "call" else -1
        if event == "call":
            for name in +inside:
                found[name].add(code.co_filename.removeprefix(PACKAGE))

    sys.setprofile(look)
    try:
        yield found
    finally:
        sys.setprofile(None)


def main(argv: list[str] | None = None) -> None:
    """Run a command and print a line for each function."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("command", choices=sorted(COMMANDS))
    parser.add_argument("config", type=Path)
    parser.add_argument("--inside", required=True, help="names of functions, with commas between")
    parser.add_argument("overrides", nargs="*", help="KEY=VALUE")
    given = parser.parse_args(argv)
    config = load_config(given.config, given.overrides)
    names = given.inside.split(",")
    with entered(set(names)) as found:
        COMMANDS[given.command](config)
    for name in names:
        print(f"{name}: {len(found[name])} files, {len({Path(one).parent for one in found[name]})} folders")


if __name__ == "__main__":
    main()
