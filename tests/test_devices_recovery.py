"""A simulated subject with a device, identified from recordings alone, against MuJoCo's truth."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from benchmarks.device_cases import CASES
from benchmarks.devices import subject

from torchid.simulate.options import SimulateOptions


@pytest.mark.slow
@pytest.mark.parametrize("kind", CASES)
def test_a_device_is_recovered(kind: str, tmp_path: Path, no_report: None, seed: int) -> None:
    """Assistance within 10 %, mass within 0.2 kg, and nothing that a sensor measured stays unknown."""
    options = SimulateOptions(duration_s=6.0, skin_motion_mm=5.0)
    figures = subject(kind, seed % 1000, tmp_path, options, blind=False).figures
    assert figures["not_determinable"] == 0.0, figures
    assert figures["assistance_pct"] < 10.0 and figures["mass_kg"] < 0.2, figures


@pytest.mark.slow
def test_without_a_sensor_nothing_is_claimed(tmp_path: Path, no_report: None, seed: int) -> None:
    """Both numbers of both springs are not determinable; the mass is found all the same."""
    options = SimulateOptions(duration_s=6.0, skin_motion_mm=5.0)
    figures = subject("hip", seed % 1000, tmp_path, options, blind=True).figures
    assert figures["not_determinable"] == 4.0 and figures["mass_kg"] < 0.2, figures
