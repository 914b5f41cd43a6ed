"""The training scripts run, resume and leave what they promise."""

import importlib.util
import json
import os
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
import small_session as small

from torchid.snapshot import from_bytes

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
FEW = ["geometry.max_frames=12", "geometry.static_frames=4"]


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("solver", ["adam", "lbfgs", "arrow"])
def test_geometry_script_lowers_the_cost_and_resumes(solver, tmp_path, capsys):
    """A second call goes on where the first one stopped, and LBFGS and the arrow are lower from step to step.

    Adam's first steps are of fixed length and may rise; ``test_geometry_solvers`` holds where it ends.
    """
    fit_geometry = script("fit_geometry")
    command = ["--config", str(small.config()), "--solver", solver, "--out", str(tmp_path), *FEW]
    fit_geometry.main([*command, "--iterations", "3"])
    fit_geometry.main([*command, "--iterations", "5"])
    found = rows(tmp_path)
    assert [row["iteration"] for row in found] == [1, 2, 3, 4, 5]
    assert solver == "adam" or found[-1]["cost"] < found[0]["cost"]
    assert all(0.0 < row["marker_rms_mm"] < 100.0 for row in found)
    assert from_bytes((tmp_path / "geometry.snapshot").read_bytes()).uncertainty is not None
    assert "shank_l_length" in capsys.readouterr().out


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


@pytest.mark.parametrize("name", ["demo", "test", "environment"])
def test_shell_scripts_parse(name):
    """bash reads them without executing; those that are called are executable."""
    subprocess.run(["bash", "-n", str(SCRIPTS / name)], check=True)
    assert name == "environment" or os.access(SCRIPTS / name, os.X_OK)
