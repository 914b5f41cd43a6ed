"""Does a cohort finish, whoever is broken and whatever is killed meanwhile? Simulated people, some of them poison.

    scripts/module test batteries.poison --seed 5300                          # 60 subjects, two workers
    scripts/module test batteries.poison --seed 5300 --throughput 16          # two workers against one

Three of sixty, by lot, cannot be done: a damaged file, a fit without an end, a run that exhausts memory. Once a
third of all are done a worker is killed, once two thirds are, the command; then it is called again. Prints who was not
done and with what reason, whose work was lost or done twice, and how long it took. ``--throughput`` runs as many sound
subjects with one worker and with two, one call after the other.
"""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
from harness.command import Command, said_seed

from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session

SHORT = SimulateOptions(fit=("squats", "sway_steps"), heldout=("arms",), duration_s=4.0)
QUICK = "\ndiagnosis: {enabled: false}\n"
MORE = {"endless": "geometry: {solver: adam, gradient_iterations: 1000000}\n", "hog": "torques: {draws: 4096}\n"}
"""Of the configs of poison."""
MEMORY_GB, MINUTES = 1.5, 1.5
"""Choice. What a run may take: a sound one needs half a gibibyte and ten seconds."""
REASONS = {"damaged": "truncated", "endless": "took longer than", "hog": "needed more than"}
"""Words of the reason that is right for each poison."""
SHARE = 20
"""Choice. One subject in so many is poison."""
PEOPLE = 6
"""Choice. Sound people who are simulated; all others have the files of one of them."""
LOOK_S = 0.1
"""Resolution. Time between looks at what is done [s]."""


def people(count: int, seed: int, folder: Path) -> dict[str, str]:
    """A table of subjects, and the poison of those who have one."""
    draw = np.random.default_rng(seed)
    ill = [int(k) for k in draw.permutation(count)[: max(count // SHARE, 0)]]
    poison = {f"S{k:03d}": list(REASONS)[n % len(REASONS)] for n, k in enumerate(ill)}
    lines = ["subject,config,laboratory"]
    for k in range(count):
        name = f"S{k:03d}"
        kind = poison.get(name)
        config = folder / name / "config.yaml"
        if k >= PEOPLE and f"S{k % PEOPLE:03d}" not in poison:
            shutil.copytree(folder / f"S{k % PEOPLE:03d}", folder / name)
        else:
            simulate_session(SHORT, seed + k, folder / name)
            config.write_text(config.read_text() + QUICK)
        config.write_text(config.read_text() + MORE.get(kind or "", ""))
        if kind == "damaged":
            file = folder / name / "squats.c3d"
            file.write_bytes(file.read_bytes()[: int(draw.integers(600, file.stat().st_size // 2))])
        lines.append(f"{name},{config.relative_to(folder)},L")
    (folder / "subjects.csv").write_text("\n".join(lines) + "\n")
    return poison


def command(folder: Path, out: Path, workers: int) -> list[str]:
    """The command line of a cohort."""
    own = [sys.executable, "-m", "torchid.cli", "cohort", str(folder / "subjects.csv"), "-o", str(out)]
    return [*own, "--workers", str(workers), "--memory", str(MEMORY_GB), "--minutes", str(MINUTES)]


def rows_of(out: Path) -> dict[str, int]:
    """Time at which each row was written."""
    return {file.stem: file.stat().st_mtime_ns for file in (out / "rows").glob("S*.json")}


def waited(process: subprocess.Popen, holds: Callable[[], bool]) -> None:
    """Until something holds, or the process has ended."""
    while process.poll() is None and not holds():
        time.sleep(LOOK_S)


def killed(folder: Path, out: Path, count: int) -> dict[str, int]:
    """A worker and then the command are killed; what was done by then."""
    log = (out.parent / "first.log").open("wb")
    with log, subprocess.Popen(command(folder, out, 2), stdout=log, stderr=log) as first:  # noqa: S603 - our own
        waited(first, lambda: len(rows_of(out)) >= count // 3)
        runs = [
            p for p in psutil.Process(first.pid).children(recursive=True) if "torchid.cohort.process" in p.cmdline()
        ]
        if runs and (worker := runs[0].parent()) is not None:
            os.kill(worker.pid, signal.SIGKILL)
        waited(first, lambda: len(rows_of(out)) >= 2 * count // 3)
        left = psutil.Process(first.pid).children(recursive=True) if first.poll() is None else []
        first.kill()
    psutil.wait_procs(left, timeout=60.0)
    return rows_of(out)


def survived(count: int, seed: int, out: Path) -> Iterator[str]:
    """What came of all, as lines."""
    poison = people(count, seed, out / "people")
    results, begun = out / "results", time.monotonic()
    before = killed(out / "people", results, count)
    again = command(out / "people", results, 2)
    second = subprocess.run(again, capture_output=True, text=True, check=False)  # noqa: S603 - our own
    spent, after = time.monotonic() - begun, rows_of(results)
    read = {one["subject"]: one for one in csv.DictReader((results / "cohort.csv").open(encoding="utf-8"))}
    done = [name for name, one in read.items() if one["status"] == "done"]
    sound = [f"S{k:03d}" for k in range(count) if f"S{k:03d}" not in poison]
    yield f"exit code {second.returncode}; {len(done)} of {len(sound)} sound subjects done in {spent:.0f} s"
    yield f"lost: {[name for name in sound if name not in done] or 'nobody'}"
    # A row of a run that exceeded its limits is no row of one that ended: the next call tries again, as it should.
    kept = [name for name in before if name in done or poison.get(name) == "damaged"]
    yield f"done twice: {[name for name in kept if after[name] != before[name]] or 'nobody'} of {len(kept)} done before"
    for name, kind in sorted(poison.items()):
        reason = read[name]["reason"]
        yield f"{name} ({kind}): {'right' if REASONS[kind] in reason else 'WRONG'}: {reason[:160]}"


def throughput(count: int, seed: int, out: Path) -> Iterator[str]:
    """Sound subjects with one worker and with two."""
    people(count, seed, out / "sound")  # fewer than one in SHARE: none is poison
    spent = {}
    for workers in (1, 2):
        begun = time.monotonic()
        own = command(out / "sound", out / f"workers{workers}", workers)
        subprocess.run(own, capture_output=True, check=True)  # noqa: S603 - our own
        spent[workers] = time.monotonic() - begun
    yield ", ".join(f"{n} worker(s) {seconds:.0f} s" for n, seconds in spent.items()) + (
        f": {spent[1] / spent[2]:.2f} times as fast"
    )


def main() -> None:
    """Run what is asked for."""
    asked = Command(
        __doc__, seed=(int, "of people and poison (default: drawn)"), count=60,
        throughput=(int, "so many sound subjects, fewer than 20, with one worker and with two"),
        out=(Path("out/poison"), "folder of people and results; a new one"),
    ).asked()  # fmt: skip
    seed = said_seed(asked.seed, 10**6)
    asked.out.mkdir(parents=True, exist_ok=True)
    lines = (
        throughput(asked.throughput, seed, asked.out) if asked.throughput else survived(asked.count, seed, asked.out)
    )
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main()
