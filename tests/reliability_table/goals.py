"""One function for each goal: what was reached, and whether that is enough."""

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from c3d_bytes import C3dBuilder, labels, standing
from fuzzing.run import failed, verdicts
from fuzzing.workers import Verdict

from reliability_table.record import Figure
from reliability_table.source import ROOT, unnamed_codes, unsafe, without_remedy
from torchid.dynamics.equations_of_motion import inverse_dynamics
from torchid.io import ReadOptions, read_trial
from torchid.model.whole_body import whole_body

RATES = (24.0, 25.0, 29.97, 30.0, 47.95, 48.0, 50.0, 59.94, 60.0, 64.0, 72.0, 75.0, 80.0, 90.0, 96.0, 100.0, 119.88,
         120.0, 125.0, 128.0, 143.85, 144.0, 150.0, 160.0, 179.82, 180.0, 199.8, 200.0, 239.76, 240.0, 250.0, 256.0,
         300.0, 320.0, 1000.0 / 3.0, 360.0, 400.0, 480.0, 500.0, 512.0, 750.0, 1000.0)  # fmt: skip
RATIOS = (*range(1, 21), 25, 50)
FRAMES = 6
SLOWEST_S = 1.0


@dataclass(frozen=True)
class Measuring:
    """What all goals measure with."""

    seed: int
    count: int
    """C3D mutants; a fifth of them of every other kind."""


def g1(by: Measuring) -> Figure:
    """Mutated C3D: no crash, hang, untyped error, blow-up; nothing unsaid."""
    return _fuzzed(verdicts("c3d", range(by.count), by.seed), f"scripts/fuzz --kind c3d --count {by.count}")


def g2(by: Measuring) -> Figure:
    """Mutated text, configs and models likewise."""
    kinds, count = ("trc", "mot", "sto", "config", "marker_set", "urdf", "mjcf"), by.count // 5
    found = [one for kind in kinds for one in verdicts(kind, range(count), by.seed)]
    return _fuzzed(found, f"scripts/fuzz --count {count}")


def _fuzzed(found: Sequence[Verdict], command: str) -> Figure:
    bad, unsaid = (sum(1 for one in found if one.outcome == what and failed(one)) for what in ("bad", "silent"))
    slowest = max(one.seconds for one in found)
    text = f"{len(found)} mutants: {bad} bad, {unsaid} unsaid beyond the rules; slowest {slowest:.2f} s"
    return Figure(text, not bad and not unsaid and slowest <= SLOWEST_S, command)


def g3(by: Measuring) -> Figure:
    """Real recordings: two independent readers agree."""
    return _tests("tests/test_io_recordings.py::test_two_readers_agree")


def g4(by: Measuring) -> Figure:
    """Files cut short: none is read as a shorter trial or other numbers unsaid."""
    kinds = ("c3d", "trc", "mot", "sto")
    found = [one for kind in kinds for one in verdicts(kind, range(by.count // 2), by.seed, truncate=True)]
    wrong = sum(one.outcome in ("bad", "silent") for one in found)
    return Figure(f"{wrong} of {len(found)} cuts unsaid", not wrong, f"scripts/fuzz --truncate {by.count // 2}")


def g5(by: Measuring) -> Figure:
    """Camera rates times analog ratios: every frame and sample on its place."""
    with tempfile.TemporaryDirectory() as folder:
        right = sum(_aligned(rate, ratio, Path(folder) / "a.c3d") for rate in RATES for ratio in RATIOS)
    count = len(RATES) * len(RATIOS)
    return Figure(f"{right} of {count} right", right == count, "scripts/reliability --only G5")


def _aligned(rate: float, ratio: int, path: Path) -> bool:
    """Whether points, samples and clocks of a file are where they were put."""
    points, count = standing(FRAMES), FRAMES * ratio
    corners = np.array([[600.0, 0, 0], [0, 0, 0], [0, 400, 0], [600, 400, 0]]).T[:, :, None]
    plate = {"USED": np.array([1]), "TYPE": np.array([2]), "CHANNEL": np.arange(1, 7)[:, None], "CORNERS": corners,
             "ORIGIN": np.array([[0.0], [0.0], [-40.0]])}  # fmt: skip
    analogs = np.arange(count)[:, None] * [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
    units = {"UNITS": ["N"] * 3 + ["Nmm"] * 3}
    built = C3dBuilder(points, labels(8), analogs, ratio, rate, parameters={"FORCE_PLATFORM": plate, "ANALOG": units})
    trial = read_trial("a", built.save(path), options=ReadOptions(up="z"))
    if trial.forces is None or trial.markers.position.shape[0] != FRAMES or len(trial.forces.time) != count:
        return False
    time = np.arange(count) / (np.float32(rate) * ratio)
    placed = np.abs(trial.markers.position.numpy() - points / 1000.0).max() < 1e-5
    pressed = np.abs(trial.forces.wrench[:, 0, 2].numpy() - np.arange(count)).max() < 1e-6
    return bool(placed and pressed and np.abs(trial.forces.time.numpy() - time).max() < 1e-6 / rate)


def g6(by: Measuring) -> Figure:
    """Six encodings of one trial hold the same numbers."""
    return _tests("tests/test_io_c3d.py::test_six_encodings_hold_the_same_numbers")


def g7(by: Measuring) -> Figure:
    """Rows of the catalogue of bad inputs with a test each; none names its row, so codes that one names are counted."""
    unnamed, count = unnamed_codes()
    text = f"no test names a row; {count - len(unnamed)} of {count} codes of errors and notes are named in tests"
    return Figure(text, False, "scripts/reliability --only G7")


def g19(by: Measuring) -> Figure:
    """A frame alone and in a batch of 1000 has the same bits; two runs write the same bytes."""
    torch.manual_seed(by.seed)
    model = whole_body(1.75, 70.0, "male")
    geometry = model.geometry.geometry(model.geometry.mean)
    motion = [torch.randn(len(model.tree.dofs), 1000, dtype=torch.float64) for _ in range(3)]
    together = inverse_dynamics(model.tree, geometry, model.inertia.mean, *motion)
    frames = range(0, 1000, 50)
    alone = [
        inverse_dynamics(model.tree, geometry, model.inertia.mean, *(x[:, k : k + 1] for x in motion)) for k in frames
    ]
    equal = sum(torch.equal(one[:, 0], together[:, k]) for k, one in zip(frames, alone, strict=True))
    runs = _tests("tests/test_experiment.py::test_two_runs_write_the_same_bytes")
    text = f"{equal} of {len(frames)} frames bit-equal alone and in a batch of 1000; two runs byte-equal: {runs.text}"
    return Figure(text, equal == len(frames) and bool(runs.reached), f"scripts/reliability --only G19; {runs.command}")


def g24(by: Measuring) -> Figure:
    """Nothing that runs what a file holds."""
    found = unsafe(ROOT / "torchid")
    ruff = [sys.executable, "-m", "ruff", "check", "--select", "S", "--ignore", "S101", "torchid"]
    clean = subprocess.run(ruff, check=False, cwd=ROOT, capture_output=True).returncode == 0  # noqa: S603
    hostile = _tests("tests/test_config.py::test_hostile_documents_are_refused_with_a_code",
                     "tests/test_marker_set.py::test_files_that_are_no_sets_are_refused",
                     "tests/test_results.py::test_snapshots_hold_and_rebuild_nothing_foreign")  # fmt: skip
    ruled = "clean" if clean else "complains"
    text = f"{len(found)} unsafe calls in the package, ruff S {ruled}, hostile files: {hostile.text}"
    return Figure(text, not found and clean and bool(hostile.reached), "scripts/reliability --only G24")


def g25(by: Measuring) -> Figure:
    """Names of subject, trial and marker are text in the report, and the page fetches nothing."""
    return _tests("tests/test_report.py::test_hostile_names_are_text",
                  "tests/test_report.py::test_page_is_whole_small_and_reads_nothing_from_outside")  # fmt: skip


def g26(by: Measuring) -> Figure:
    """Names from inside files never lead outside the folder of the results."""
    return _tests("tests/test_results.py::test_names_from_data_stay_one_plain_component",
                  "tests/test_results.py::test_results_stay_below_the_folder")  # fmt: skip


def g28(by: Measuring) -> Figure:
    """Every error has a remedy, every end its exit code."""
    bare, count = without_remedy(ROOT / "torchid")
    ends = _tests("tests/test_cli.py::test_every_end_has_its_exit_code_and_one_line")
    text = f"{count - len(bare)} of {count} errors with a remedy; exit codes: {ends.text}"
    return Figure(text, not bare and bool(ends.reached), "scripts/reliability --only G28")


def _tests(*nodes: str) -> Figure:
    """How many of these tests pass."""
    line = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *nodes]
    done = subprocess.run(line, check=False, cwd=ROOT, capture_output=True, text=True)  # noqa: S603
    counts = {what: int(n) for n, what in re.findall(r"(\d+) (passed|failed|error|skipped)", done.stdout)}
    text = ", ".join(f"{n} {what}" for what, n in counts.items()) or f"pytest ended with {done.returncode}"
    return Figure(f"tests: {text}", done.returncode == 0 and counts.get("passed", 0) > 0, f"pytest {' '.join(nodes)}")


GOALS: dict[str, tuple[str, Callable[[Measuring], Figure] | str]] = {
    "G1": ("mutated C3D", g1), "G2": ("mutated text, configs, models", g2), "G3": ("two readers agree", g3),
    "G4": ("silent truncation", g4), "G5": ("rates times ratios", g5), "G6": ("six encodings", g6),
    "G7": ("catalogue of bad inputs", g7), "G8": ("kill -9", "scripts/faults --kills 50"),
    "G9": ("failing writes, full disks", "scripts/faults --kills 50"),
    "G14": ("planted plate faults", "scripts/plate_faults --record"), "G19": ("batches, repeated runs", g19),
    "G20": ("memory of an hour", "scripts/hour --record"), "G24": ("no foreign code", g24), "G25": ("report", g25),
    "G26": ("paths", g26), "G28": ("errors", g28),
}  # fmt: skip
"""Goal: its words, and the function that measures it or the command that records it."""
