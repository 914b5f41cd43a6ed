"""Runs whose writing fails, whose disk fills or that are killed; what they leave, and whether the next run mends it.

    scripts/faults --calls 40 --disks 6 --kills 10
    scripts/faults --calls all --disks 0 --kills 50 --seed 7

Each is a small run with the diagnosis in a folder that holds the results of an earlier config and files of a user's.
Right is: a call that fails or a full disk ends with exit 2 and names a path in that folder; no file of the user's is
touched; results of the two configs never stand side by side; and the next run ends with exit 0, the results of an
undisturbed run (bytes, but for costs) and nothing else left. Ends with 1 where one is not.
"""

import random
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from harness.command import Command, said_seed

from mishaps.bench import Attempt, Bench
from mishaps.injection import Calls

MIB = 1 << 20
IN_A_ROW = 3
"""Kills before a run may end. A choice: more would mostly fall on late stages."""
SHORTEST = 0.1
"""Share of an undisturbed run in which the last kills fall: something is always left to do."""


def main() -> int:
    """Every kind of mishap, and the table."""
    arguments = Command(
        __doc__, calls=("24", "how many of the calls that write fail, each in its turn, or all"),
        first=(1, "with --calls all, begin with this one"),
        disks=(4, "disks of 1 to 30 MB (needs the right to mount)"), seed=int,
        kills=(6, "runs ended by kill -9 at a moment drawn by lot"),
        folder=(str, "work here and keep what is left"),
    ).asked()  # fmt: skip
    seed = said_seed(arguments.seed, 10**6)
    draw = random.Random(seed)  # noqa: S311 - no secret
    with tempfile.TemporaryDirectory() as temporary:
        bench = Bench(Path(arguments.folder or temporary).resolve() / "faults", seed)
        print(f"undisturbed: {bench.seconds:.0f} s, {len(bench.stages)} stages", flush=True)
        table = {
            "a call fails": list(failing_calls(bench, arguments.calls, draw, arguments.first)),
            "the disk is full": list(small_disks(bench, arguments.disks, draw)),
            "killed": list(kills(bench, arguments.kills, draw)),
        }
    for what, rows in table.items():
        ends = sorted({code for code, _ in rows})
        counts = ", ".join(f"exit {code}: {sum(code == c for c, _ in rows)}" for code in ends)
        print(f"{what:18s} {len(rows):4d} runs, {sum(bool(faults) for _, faults in rows)} wrong ({counts or 'none'})")
    return int(any(faults for rows in table.values() for _, faults in rows))


def failing_calls(bench: Bench, wanted: str, draw: random.Random, first: int = 1) -> Iterator[tuple[int, list[str]]]:
    """The n-th call fails in a run that has all stages but one, drawn by lot, stored."""
    calls = Calls()

    def attempt(missing: str, failing: int | None) -> Attempt:
        bench.lay_out(set(bench.stages) - {missing})
        return bench.run(prepare=lambda: calls.watch(bench.out, failing))

    if wanted == "0":
        return
    bench.report = False
    attempt(bench.stages[0], None)
    total = calls.count
    print(f"{total} calls write", flush=True)
    numbers = range(first, total + 1) if wanted == "all" else sorted(draw.sample(range(1, total + 1), int(wanted)))
    for number in numbers:
        missing = draw.choice(bench.stages)
        ended = attempt(missing, number)
        faults = _wrong_end(bench, ended, (2,) if calls.count >= number else (0, 2)) + bench.faults_now()
        yield _judged(bench, f"call {number} without {missing}", ended, faults)


def small_disks(bench: Bench, count: int, draw: random.Random) -> Iterator[tuple[int, list[str]]]:
    """From the start on a disk that is too small, perhaps; then on the same disk made large."""
    for _ in range(count):
        size = int(MIB * 30.0 ** draw.random())
        shutil.rmtree(bench.out, ignore_errors=True)
        bench.out.mkdir()
        if not _system("mount", "-t", "tmpfs", "-o", f"size={size}", "torchid-faults", str(bench.out)):
            print("no right to mount a small disk: left out", flush=True)
            return
        try:
            bench.plant()
            ended = bench.run()
            faults = _wrong_end(bench, ended, (0, 2)) + bench.faults_now()
            _system("mount", "-o", "remount,size=1g", str(bench.out))
            yield _judged(bench, f"a disk of {size / MIB:.1f} MiB", ended, faults)
        finally:
            _system("umount", str(bench.out))


def _system(*command: str) -> bool:
    return subprocess.run(command, capture_output=True, check=False).returncode == 0  # noqa: S603 - our own words


def kills(bench: Bench, count: int, draw: random.Random) -> Iterator[tuple[int, list[str]]]:
    """kill -9 at any moment of a run with no stage stored, then at any moment of the runs that take it up.

    The folder is judged after every kill, the results once a run may end: up to ``IN_A_ROW`` kills share the time that
    the undisturbed rest takes.
    """
    bench.report = True
    while count > 0:
        bench.lay_out(set())
        rest, left = bench.seconds, min(IN_A_ROW, count)
        while left:
            left, count = left - 1, count - 1
            moment = rest * draw.random()
            ended = bench.run(kill_after=moment)
            rest = max(rest - moment, SHORTEST * bench.seconds)
            faults = [] if ended.code in (-9, 0) else [f"exit {ended.code}: {ended.said[-300:]}"]
            faults += bench.faults_now()
            what = f"killed after {moment:.1f} s"
            if left and ended.code == -9:
                print(f"{what}: exit -9, taken up again; {'; '.join(faults) or 'right'}", flush=True)
                yield ended.code, faults
            else:
                left = 0
                yield _judged(bench, what, ended, faults)


def _wrong_end(bench: Bench, ended: Attempt, allowed: tuple[int, ...]) -> list[str]:
    if ended.code not in allowed:
        return [f"exit {ended.code}: {ended.said[-300:]}"]
    return [f"no path: {ended.said[-300:]}"] if ended.code and str(bench.out) not in ended.said else []


def _judged(bench: Bench, what: str, ended: Attempt, faults: list[str]) -> tuple[int, list[str]]:
    """The next run puts it right."""
    again = bench.run()
    faults = faults + _wrong_end(bench, again, (0,)) + bench.faults_after()
    print(f"{what}: exit {ended.code}, then {again.code}; {'; '.join(faults) or 'right'}", flush=True)
    return ended.code, faults


if __name__ == "__main__":
    raise SystemExit(main())
