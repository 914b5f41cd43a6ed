"""How far a cohort scales: what is measured on this machine, and a plan of what a larger one would do.

    scripts/module test batteries.cohort_scale --again 1000    # a second call with nothing changed
    scripts/module test batteries.cohort_scale --empty 10000   # tasks that do nothing: scheduler's memory and overhead
    scripts/module test batteries.cohort_scale --plan docs/cohort_scaling   # 10,000 subjects on 1 to 1,000 workers

The plan is a simulation of events: a scheduler hands out one task after another, each reads its files from a file
system that all share, computes for a time by lot (``--task-s``, with stragglers), and writes; some crash and are run
once more. It writes the times of all numbers of workers as JSON, and a picture.
"""

import heapq
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import psutil
from harness.command import Command

from torchid.cohort.cluster import ended, workers
from torchid.cohort.cohort import run_cohort
from torchid.cohort.members import members_of
from torchid.cohort.task import RunLimits, content, looks, row_path
from torchid.storage.files import write_json

mpl.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402 - behind the choice of what draws

WORKERS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Choice. Numbers of workers of the plan."""


@dataclass(frozen=True)
class Assumptions:
    """What a plan assumes; times are those measured on this machine."""

    subjects: int = 10_000
    task_s: float = 40.0
    """Median time that a subject computes [s]."""
    spread: float = 0.6
    """Standard deviation of its logarithm: one in a hundred takes four times as long."""
    files_mib: float = 30.0
    """What a subject reads and writes [MiB]."""
    bandwidth_mib_s: float = 500.0
    """Of the file system that all share [MiB/s]."""
    crash: float = 0.01
    """Share of runs that crash and are tried once more."""
    overhead_s: float = 0.003
    """Time of the scheduler for a task [s]."""


def again(count: int) -> float:
    """Seconds of a second call for so many subjects, of whom nothing has changed."""
    with tempfile.TemporaryDirectory() as folder:
        root, out = Path(folder) / "recordings", Path(folder) / "out"
        for k in range(count):
            own = root / f"S{k:05d}"
            own.mkdir(parents=True)
            for name in ("static", "walk1", "walk2"):
                (own / f"{name}.c3d").write_bytes(f"{k} {name}".encode())
        members = members_of(root)
        for member in members:
            figures = {"mass_kg": 70.0, "recorded_kg": 70.0, "marker_rmse_mm": 5.0, "heldout_force_N": 20.0}
            row = {"subject": member.name, "status": "done", "reason": "", "verdict": "good", "again": False, **figures}
            row |= {"looks": looks(member), "content": content(member), "causes": [], "seconds": 1.0}
            row_path(member, out).parent.mkdir(parents=True, exist_ok=True)
            write_json(row_path(member, out), row)
            (out / member.name).mkdir()
            (out / member.name / "report.html").write_text("")
        begun = time.perf_counter()
        rows = run_cohort(members_of(root), out, RunLimits(4.0, 60.0))
        assert len(rows) == count, "a row for each"
        return time.perf_counter() - begun


def nothing(number: int) -> int:
    """A task that does nothing."""
    return number


def empty(count: int) -> tuple[float, float]:
    """Seconds for a task that does nothing, and memory of the process that schedules them [GiB]."""
    with workers(2, None) as client:
        begun = time.perf_counter()
        waiting = [client.submit(nothing, k, pure=False, retries=2) for k in range(count)]
        for future in ended(waiting):
            future.release()
        spent = time.perf_counter() - begun
        return spent / count, psutil.Process().memory_info().rss / 2**30


def schedule(lab: Assumptions, count: int, seed: int = 0) -> dict[str, float]:
    """Hours that all subjects take on so many workers, by events, and the share of time in which these wait."""
    draw = np.random.default_rng(seed)
    computing = lab.task_s * np.exp(lab.spread * draw.standard_normal(lab.subjects))
    runs = [float(s) for s in computing] + [float(s) for s in computing[draw.uniform(size=lab.subjects) < lab.crash]]
    free = [0.0] * count
    heapq.heapify(free)
    scheduler = files = end = 0.0
    for seconds in runs:
        worker = heapq.heappop(free)
        scheduler = max(scheduler, worker) + lab.overhead_s
        # The file system serves one after another at its full bandwidth, which is as fast as all at once at a share.
        files = max(files, scheduler) + lab.files_mib / lab.bandwidth_mib_s
        done = files + seconds
        heapq.heappush(free, done)
        end = max(end, done)
    busy = sum(runs)
    return {"workers": count, "hours": end / 3600.0, "busy": busy / (count * end), "speedup": busy / end}


def limits(lab: Assumptions) -> dict[str, float]:
    """Numbers of workers that each part of a laboratory can keep busy."""
    mean = lab.task_s * float(np.exp(0.5 * lab.spread**2))
    return {
        "scheduler": mean / lab.overhead_s,
        "file system": mean * lab.bandwidth_mib_s / lab.files_mib,
        "longest subject": lab.subjects * mean / (lab.task_s * float(np.exp(lab.spread * 3.7))),
    }


def plan(lab: Assumptions, path: Path) -> Iterator[str]:
    """Lines of the plan, which is written as JSON and drawn."""
    found = [schedule(lab, count) for count in WORKERS]
    bounds = limits(lab)
    path.with_suffix(".json").write_text(
        json.dumps({"assumed": lab.__dict__, "limits": bounds, "plan": found}, indent=1)
    )
    figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    axes.loglog(WORKERS, [one["speedup"] for one in found], "o-", label="10,000 subjects")
    axes.loglog(WORKERS, WORKERS, "--", color="grey", label="as many times as workers")
    for k, (name, bound) in enumerate(bounds.items()):
        if bound < 2.0 * WORKERS[-1]:
            axes.axvline(bound, color="tab:red", linewidth=0.8)
            axes.text(bound, 1.5 * 4.0**k, f"{name}  ", va="bottom", ha="right", fontsize=8)
    axes.set(xlabel="workers", ylabel="speed against one worker")
    axes.legend()
    figure.savefig(path.with_suffix(".svg"), metadata={"Date": None})
    yield "workers   hours   busy"
    yield from (f"{one['workers']:7d} {one['hours']:7.2f} {100 * one['busy']:5.0f} %" for one in found)
    yield "kept busy at most: " + ", ".join(f"{name} {bound:,.0f} workers" for name, bound in bounds.items())


def main(given: Sequence[str] | None = None) -> None:
    """Measure what is asked for."""
    asked = Command(
        __doc__, again=(int, "subjects of a second call"), empty=(int, "tasks that do nothing"),
        plan=(Path, "path of the plan's JSON and picture, without its ending"),
        task_s=(Assumptions.task_s, "median time of a subject [s]"),
        overhead_s=(Assumptions.overhead_s, "time of the scheduler for a task [s]"),
    ).asked(given)  # fmt: skip
    if asked.again:
        print(f"second call, {asked.again} subjects: {again(asked.again):.1f} s")
    if asked.empty:
        seconds, memory = empty(asked.empty)
        print(f"{asked.empty} empty tasks: {1e3 * seconds:.2f} ms each, {memory:.2f} GiB where they are scheduled")
    if asked.plan:
        print("\n".join(plan(Assumptions(task_s=asked.task_s, overhead_s=asked.overhead_s), asked.plan)))


if __name__ == "__main__":
    main()
