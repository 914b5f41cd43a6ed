"""Reading every C3D of the shared recordings, by turns with ezc3d: seconds of each, and their ratios."""

import contextlib
import time
from pathlib import Path

import ezc3d
from harness.command import DATA

from torchid.errors import InputError
from torchid.io import read_trial

READERS = {
    "torchid": lambda path: read_trial(path.stem, path),
    "ezc3d": lambda path: ezc3d.c3d(str(path), extract_forceplat_data=True),
    "ezc3d, no plates": lambda path: ezc3d.c3d(str(path)),
}
"""torchid checks and turns markers and plates with everything it doubts; ezc3d gives points, channels and plates."""


def bench_reading(repeats: int) -> dict[str, float]:
    """CPU seconds of every reader for all files, of each the least of ``repeats``; empty where there are no recordings.

    A file that one of them refuses is left out of all sums.
    """
    files = sorted(path for path in DATA.rglob("*") if path.suffix.lower() == ".c3d") if DATA.is_dir() else []
    sums = dict.fromkeys(READERS, 0.0) if files else {}
    for path in files:
        with contextlib.suppress(InputError, RuntimeError, ValueError):
            for name, seconds in _least(path, repeats).items():
                sums[name] += seconds
    return sums


def _least(path: Path, repeats: int) -> dict[str, float]:
    """The least CPU time [s] of each reader, taken by turns."""
    times: dict[str, list[float]] = {name: [] for name in READERS}
    for _ in range(repeats):
        for name, reader in READERS.items():
            begin = time.process_time()
            reader(path)
            times[name].append(time.process_time() - begin)
    return {name: min(taken) for name, taken in times.items()}


if __name__ == "__main__":
    found = bench_reading(5)
    for name, seconds in found.items():
        print(f"{name:<18}{seconds:.3g} s, {seconds / found['torchid']:.3g} times torchid")
