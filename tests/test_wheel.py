"""What ``pip install torchid`` puts on a machine works without the checkout."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
SMALL = (
    "simulate.fit=[squats,sway_steps]",
    "simulate.duration_s=3",
    "geometry.max_frames=60",
    "diagnosis.max_effects=1",
)
"""Overrides for a demonstration that takes seconds."""


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder with what the wheel holds, its dependencies those of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", folder / "dist", PROJECT], check=True)
    (wheel,) = (folder / "dist").glob("torchid-*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", folder / "site", wheel], check=True)
    return folder / "site"


@pytest.mark.slow
def test_an_installed_torchid_demonstrates_itself(installed, tmp_path):
    """From an empty folder: its own files alone, a verdict beside the truth, and a report at the end."""
    env = {**os.environ, "PYTHONPATH": str(installed)}
    where = "import torchid; print(torchid.__file__)"
    done = subprocess.run(
        [sys.executable, "-P", "-c", where], cwd=tmp_path, env=env, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()).is_relative_to(installed)
    done = subprocess.run(
        [sys.executable, "-P", "-m", "torchid.cli", "demo", "7", *SMALL], cwd=tmp_path, env=env, capture_output=True,
        text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Truth: " in done.stdout and "The verdict was" in done.stdout
    assert (tmp_path / "out" / "demo" / "7" / "report.html").stat().st_size > 0
