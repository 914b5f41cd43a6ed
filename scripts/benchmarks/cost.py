"""What the diagnosis costs: `scripts/cost`, or `scripts/cost configs/some.yaml ...` for recordings of your own.

Without a config, a simulated subject with five trials of 25 s. Each run is a process of its own, from files to report;
its CPU seconds count. A config that does not end with a result is listed with the reason.
"""

import argparse
import json
import logging
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from harness.command import Command
from harness.runs import ran

from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session
from torchid.storage.allocator import keep_memory, seldom_collect

SUBJECT = SimulateOptions(
    fit=("squats", "arms", "trunk", "sway_steps", "hip_rom"), heldout=("walk",), duration_s=25.0, skin_motion_mm=3.0,
    gap_fraction=0.01,
)  # fmt: skip
ASKED = 1.6
"""Goal. Times the CPU seconds of a run without the diagnosis that one with it may take."""


class Scanned(logging.Handler):
    """When the first scan began and ended."""

    def __init__(self) -> None:
        super().__init__()
        self.times: dict[str, float] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Note the first record of each kind."""
        self.times.setdefault(str(record.msg).split(" ")[0], time.process_time())


def main() -> None:
    """Run each config twice and compare."""
    args = Command(
        __doc__, ("configs",), configs=({"nargs": "*", "type": Path}, "without any, a simulated subject"),
        once=({"nargs": 2, "metavar": ("OUT", "DIAGNOSIS")}, argparse.SUPPRESS),
    ).asked()  # fmt: skip
    if args.once:
        print(json.dumps(_once(args.configs[0], *args.once)))
        return
    print(f"{'config':34}{'without':>10}{'with':>10}{'times':>8}{'first scan':>12}")
    with tempfile.TemporaryDirectory() as folder:
        configs = args.configs or [simulate_session(SUBJECT, 1, Path(folder) / "recordings").config]
        times = [own for config in configs if config and (own := _compared(config, Path(folder))) is not None]
    if times:
        print(f"times the run without: median {median(times):.2f}, most {max(times):.2f}; asked for: {ASKED}")


def _compared(config: Path, folder: Path) -> float | None:
    """How many times the run without the diagnosis one with it takes; None where it does not end."""
    runs = [_measured(config, folder / f"{config.stem}_{on}", on) for on in ("false", "true")]
    plain, whole = (one.get("seconds", math.nan) for one in runs)
    scan = f"{runs[1]['scan']:10.1f} s" if "scan" in runs[1] else ""
    print(f"{config.stem:34}{plain:8.1f} s{whole:8.1f} s{whole / plain:8.2f}{scan}", flush=True)
    return whole / plain if math.isfinite(whole / plain) else None


def _measured(config: Path, out: Path, diagnosis: str) -> dict[str, float]:
    line = [sys.executable, "-m", "benchmarks.cost", str(config), "--once", str(out), diagnosis]
    done = subprocess.run(line, capture_output=True, text=True, check=False)  # noqa: S603
    if done.returncode:
        print(f"{config.stem}: {(done.stderr.strip().splitlines() or ['ended'])[-1]}", flush=True)
        return {}
    return json.loads(done.stdout.splitlines()[-1])


def _once(config: Path, out: str, diagnosis: str) -> dict[str, float]:
    keep_memory()
    seldom_collect()
    scanned, log = Scanned(), logging.getLogger("torchid.diagnosis.search")
    log.setLevel(logging.INFO)
    log.addHandler(scanned)
    ran(config, out, f"diagnosis.enabled={diagnosis}")
    scan = {"scan": scanned.times["scanned"] - scanned.times["scanning"]} if scanned.times else {}
    return {"seconds": time.process_time(), **scan}


if __name__ == "__main__":
    main()
