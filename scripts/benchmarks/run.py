"""All comparisons in one run: prints a table and writes bench.json."""

import datetime
import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path

from harness.command import Command
from harness.pool import alone
from harness.rows import write_json
from rich.console import Console
from rich.table import Table

from benchmarks.fit import bench_fit
from benchmarks.inertia import bench_inertia
from benchmarks.kinematics import bench_ik
from benchmarks.reading import bench_reading
from benchmarks.regressor import bench_regressor
from benchmarks.sharing import bench_sharing

PACKAGES = ("torch", "numpy", "scipy", "pin", "opensim", "ezc3d")
Row = tuple[str, float | None, str, str]
"""What, value, unit, what is asked for."""


def main() -> None:
    """Run everything, or a tiny size with --quick."""
    args = Command(
        __doc__, quick=(False, "few frames, no slow peers, no compiler: a smoke test"), out=Path("bench.json")
    ).asked()
    alone()
    quick = args.quick
    fit = bench_fit(200 if quick else 1000, 1 if quick else 5, peers=not quick)
    ik = bench_ik(300 if quick else 2000, 20 if quick else 200, 1 if quick else 3)
    regressor = bench_regressor(2 if quick else 9, compiled=not quick)
    inertia = bench_inertia(3 if quick else 20)
    memory = _memory(1 if quick else 60)
    reading = bench_reading(1 if quick else 5)
    sharing = bench_sharing(300 if quick else 4000, 20 if quick else 200, 1 if quick else 3)
    rows = _rows(fit, ik, regressor, inertia, memory, reading) + _sharing(sharing)
    about = {"date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), "cpu": _cpu(),
             "versions": {name: metadata.version(name) for name in PACKAGES}}  # fmt: skip
    results = {"about": about, "fit": fit, "ik": ik, "regressor": regressor, "inertia": inertia,
               "hour_memory_MiB": memory, "reading": reading, "sharing": sharing}  # fmt: skip
    write_json(args.out, results)
    _print(rows)


def _ratio(a: object, b: object) -> float | None:
    return float(a) / float(b) if isinstance(a, float) and isinstance(b, float) else None


def _rows(fit: dict, ik: dict, regressor: dict, inertia: dict, memory: float, reading: dict) -> list[Row]:
    speed, gap, peer = ik["frames_per_s"], ik["gap"], regressor["pinocchio_us"]
    given = regressor.get("compiled_without_kinematics_us")
    return [
        ("fit to 0.01 %, 62 unknowns", fit["few_s"], "s", "<= 0.35"),
        ("fit, all marker places free / few", _ratio(fit["all_s"], fit["few_s"]), "x", "<= 4"),
        ("fit, 20 times the frames / once", _ratio(fit["long_s"], fit["few_s"]), "x", "about 20"),
        ("Adam (analytic gradient) / arrow", _ratio(fit.get("adam_s"), fit["few_s"]), "x", ">= 25"),
        ("scipy (sparse Jacobian) / arrow", _ratio(fit.get("scipy_s"), fit["few_s"]), "x", ">= 15"),
        ("inverse kinematics", speed["torchid"], "frames/s", ">= 9000"),
        ("  gap to the optimum", gap["torchid"], "", f"< OpenSim's {gap['opensim']:.1e}"),
        ("  torchid / OpenSim's tool", speed["torchid"] / speed["opensim"], "x", ">= 60"),
        ("  torchid / nimblephysics", speed["torchid"] / speed["nimblephysics"], "x", ">= 20"),
        ("Pinocchio / regressor, eager", _ratio(peer, regressor["eager_us"]), "x", ">= 1.5"),
        ("Pinocchio / regressor, compiled", _ratio(peer, regressor.get("compiled_us")), "x", ">= 7"),
        ("  poses and accelerations given", _ratio(peer, given), "x", ">= 7"),
        ("  largest difference", regressor["difference"], "", "<= 1e-12"),
        ("100 000 frames to normal equations", regressor["normal_equations_100k_s"], "s", "<= 0.9"),
        ("  compiled", regressor.get("normal_equations_100k_compiled_s"), "s", "<= 0.9"),
        ("inertial solve, 1 000 frames", inertia["few_ms"], "ms", "<= 40"),
        ("inertial solve, 20 000 frames", inertia["many_ms"], "ms", "<= 40"),
        ("  relative gap", inertia["gap"], "", "<= 1e-8"),
        ("memory of an hour beyond the input", memory, "MiB", "<= 150"),
        ("ezc3d / torchid, reading all C3D", _ratio(reading.get("ezc3d"), reading.get("torchid")), "x", ">= 1"),
        ("  without plates", _ratio(reading.get("ezc3d, no plates"), reading.get("torchid")), "x", ">= 1"),
    ]


def _sharing(sharing: dict) -> list[Row]:
    return [
        ("shared contact", sharing["frames_per_s"], "frames/s", ">= 1000 on two cores"),
        ("  Clarabel by cvxpy / torchid", sharing["clarabel"], "x", ""),
        ("  largest difference", sharing["apart_N"], "N", "<= 0.5"),
    ]


def _memory(minutes: int) -> float:
    line = [sys.executable, "-m", "benchmarks.memory", str(minutes)]
    return float(subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()[-1])  # noqa: S603


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [x.split(":")[1].strip() for x in lines if "model name" in x]
    return names[0] if names else platform.processor()


def _print(rows: list[Row]) -> None:
    table = Table("measurement (CPU time, one thread)", "value", "unit", "asked for")
    for what, value, unit, wanted in rows:
        table.add_row(what, "not reached" if value is None else f"{value:.3g}", unit, wanted)
    Console().print(table)


if __name__ == "__main__":
    main()
