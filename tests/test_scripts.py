"""The training scripts run, resume and leave what they promise."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import small_session as small
import torch
from documentation.flame import boxes, drawn, own_frames, tree_of

from torchid.io import read_trial
from torchid.storage.snapshot import from_bytes

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
sys.path.insert(0, str(SCRIPTS))
FEW = ["geometry.max_frames=12", "geometry.static_frames=4"]


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["adam", "arrow"])
def test_geometry_script_lowers_the_cost_and_resumes(solver, tmp_path, capsys):
    """A second call goes on where the first one stopped, and the arrow is lower from step to step.

    Adam's first steps are of fixed length and may rise; ``test_geometry_solvers`` holds where it ends.
    """
    fit_geometry = script("fit_geometry")
    command = ["--config", str(small.config()), "--solver", solver, "--out", str(tmp_path), *FEW]
    fit_geometry.main([*command, "--iterations", "3"])
    fit_geometry.main([*command, "--iterations", "5"])
    found = rows(tmp_path)
    assert [row["iteration"] for row in found] == [1, 2, 3, 4, 5]
    assert solver == "adam" or found[-1]["cost"] < found[0]["cost"]
    assert all(0.0 < row["marker_rms_mm"] < (300.0 if solver == "adam" else 100.0) for row in found)
    assert from_bytes((tmp_path / "geometry.snapshot").read_bytes()).uncertainty is not None
    assert "shank_l_length" in capsys.readouterr().out


@pytest.mark.slow
def test_inertia_script_improves_and_resumes(tmp_path, capsys):
    """With a stored geometry, rounds of noise and parameters are counted on and masses are printed."""
    script("fit_geometry").main(
        ["--config", str(small.config()), "--solver", "arrow", "--iterations", "4", "--out", str(tmp_path), *FEW]
    )
    (tmp_path / "metrics.jsonl").unlink()
    fit_inertia = script("fit_inertia")
    for iterations in ("1", "2"):
        fit_inertia.main(["--config", str(small.config()), "--iterations", iterations, "--out", str(tmp_path), *FEW])
    found = rows(tmp_path)
    assert [row["iteration"] for row in found] == [1, 2]
    assert found[-1]["mass_kg"] == pytest.approx(small.session().subject.mass, rel=0.05)
    assert "thigh_l" in capsys.readouterr().out


def test_a_lengthened_recording_is_the_piece_to_and_fro(tmp_path):
    """As long as asked; forwards it repeats the recording, backwards it passes the same frames in reverse."""
    hour, short = script("benchmarks/hour"), small.config().with_name("squats.c3d")
    frames = hour.lengthen(short, tmp_path / "long.c3d", 0.5)
    piece, long = read_trial("a", short).markers, read_trial("b", tmp_path / "long.c3d").markers
    assert len(long.time) == frames == round(30.0 * piece.rate)
    first = next(k for k in range(len(piece.time)) if same(piece.position[k], long.position[0]))
    forth = next(k for k in range(len(piece.time)) if not same(piece.position[first + k], long.position[k]))
    assert forth > 0.3 * len(piece.time)
    torch.testing.assert_close(long.position[forth : 2 * forth], long.position[:forth].flip(0), equal_nan=True)
    torch.testing.assert_close(long.position[2 * forth : 3 * forth], long.position[:forth], equal_nan=True)


def same(a: torch.Tensor, b: torch.Tensor) -> bool:
    return bool(((a == b) | (a.isnan() & b.isnan())).all())


@pytest.mark.parametrize("name", ["demo", "draws", "fuzz", "hour", "module", "reliability", "test", "environment"])
def test_shell_scripts_parse(name):
    """bash reads them without executing; those that are called are executable."""
    subprocess.run(["bash", "-n", str(SCRIPTS / name)], check=True)
    assert name == "environment" or os.access(SCRIPTS / name, os.X_OK)


def test_delayed_forces_are_the_same_later():
    """Header and labels stay, times are later, values are untouched."""
    text = "forces\nversion=1\nendheader\ntime\tvx\tvy\n0.000\t1.5\t-2\n0.010\t2.5\t-3\n"
    found = script("delay_forces").delayed(text, 0.0125).splitlines()
    assert found == ["forces", "version=1", "endheader", "time\tvx\tvy", "0.012500\t1.5\t-2", "0.022500\t2.5\t-3"]


def test_runs_are_compared_by_every_number(tmp_path, capsys):
    """The same results are the same; one number that is off by more than 1e-6, a lost key or another cause is told."""
    compare = script("compare_runs").main
    causes = [{"effect": "drag", "where": ["thorax"], "level": "likely", "applied": True}]

    def write(folder: str, value: float, warnings: list[str], named: list[dict], **more: float) -> None:
        out = tmp_path / folder / "S01"
        out.mkdir(parents=True)
        (out / "inertia.json").write_text(json.dumps({"mass": value, "warnings": warnings, **more}))
        (out / "diagnosis.json").write_text(json.dumps({"causes": named}))

    write("old", 70.0, ["said"], causes)
    write("same", 70.0 + 1e-6, ["said", "in other words"], causes, quality=1.0)
    write("off", 70.1, [], causes)
    write("lost", 70.0, [], [])
    assert [compare([str(tmp_path / "old"), str(tmp_path / name)]) for name in ("same", "off", "lost")] == [0, 1, 1]
    assert "inertia.json/mass" in capsys.readouterr().out


def test_a_flame_graph_is_of_named_functions_of_its_own(seed):
    """Other code counts for who called it, imports for themselves; functions lie within their callers, side by side."""
    called = (
        "main (x.py:1);run (torchid/cli.py:9);<module> (torchid/a.py:1);f.<locals>.g (torchid/a/b.py:3);norm (torch/x)"
    )
    assert own_frames(called) == ["run (cli)", "f.<locals>.g (a/b)"]
    assert own_frames(f"{called};_find_and_load (importlib)") == ["imports"]
    rng, names = np.random.default_rng(seed), "abcdef"
    stacks = [
        ";".join(f"{names[k]} (torchid/x.py:{k})" for k in rng.integers(6, size=rng.integers(1, 6))) for _ in range(300)
    ]
    root = tree_of([*(f"{stack} {k % 3 + 1}" for k, stack in enumerate(stacks)), ""])
    assert root.count == 600
    ends = [(left, left + call.count / root.count, depth) for call, left, depth in boxes(root, root)]
    for k, (left, right, depth) in enumerate(ends):
        level = [other for other in ends[:k] if other[2] == depth]
        assert all(right <= a + 1e-9 or left >= b - 1e-9 for a, b, _ in level)
        assert not depth or any(a - 1e-9 <= left and right <= b + 1e-9 for a, b, d in ends[:k] if d == depth - 1)
    assert drawn(root).count("<rect") == len(ends)
