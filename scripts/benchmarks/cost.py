"""What the diagnosis costs: `scripts/cost`, or `scripts/cost configs/some.yaml` for a recording of your own.

Without a config, a simulated subject with five trials of 25 s. Each run is a process of its own, from files to report;
its CPU seconds count.
"""

import argparse
import json
import logging
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from harness.command import Command
from harness.runs import ran

from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session
from torchid.storage.allocator import keep_memory

SUBJECT = SimulateOptions(
    fit=("squats", "arms", "trunk", "sway_steps", "hip_rom"), heldout=("walk",), duration_s=25.0, skin_motion_mm=3.0,
    gap_fraction=0.01,
)  # fmt: skip
ASKED = "{:<42}{:>8.1f} {:<4} asked for: {}"


class Scanned(logging.Handler):
    """When the first scan began and ended."""

    def __init__(self) -> None:
        super().__init__()
        self.times: dict[str, float] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Note the first record of each kind."""
        self.times.setdefault(str(record.msg).split(" ")[0], time.process_time())


def main() -> None:
    """Run twice and compare."""
    args = Command(
        __doc__, ("config",), config=({"nargs": "?"}, "of a recording; without one, a simulated subject"),
        once=({"nargs": 2, "metavar": ("OUT", "DIAGNOSIS")}, argparse.SUPPRESS),
    ).asked()  # fmt: skip
    if args.once:
        print(json.dumps(_once(args.config, *args.once)))
        return
    with tempfile.TemporaryDirectory() as folder:
        config = args.config or simulate_session(SUBJECT, 1, Path(folder) / "recordings").config
        plain, whole = (_measured(str(config), Path(folder) / on, on) for on in ("false", "true"))
    print(ASKED.format("torchid run without the diagnosis", plain["seconds"], "s", "-"))
    print(ASKED.format("torchid run", whole["seconds"], "s", "-"))
    print(ASKED.format("  times the run without", whole["seconds"] / plain["seconds"], "x", "<= 3"))
    if "scan" in whole:
        print(ASKED.format("  of it the first scan of the catalogue", whole["scan"], "s", "<= 60, five trials of 25 s"))


def _measured(config: str, out: Path, diagnosis: str) -> dict[str, float]:
    line = [sys.executable, "-m", "benchmarks.cost", config, "--once", str(out), diagnosis]
    said = subprocess.run(line, stdout=subprocess.PIPE, text=True, check=True).stdout  # noqa: S603
    return json.loads(said.splitlines()[-1])


def _once(config: str, out: str, diagnosis: str) -> dict[str, float]:
    keep_memory()
    scanned, log = Scanned(), logging.getLogger("torchid.diagnosis.search")
    log.setLevel(logging.INFO)
    log.addHandler(scanned)
    ran(config, out, f"diagnosis.enabled={diagnosis}")
    scan = {"scan": scanned.times["scanned"] - scanned.times["scanning"]} if scanned.times else {}
    return {"seconds": time.process_time(), **scan}


if __name__ == "__main__":
    main()
