"""A simulated subject with a device, identified from recordings alone, against MuJoCo's truth."""

import functools
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from balance import in_balance
from benchmarks.device_cases import CASES
from benchmarks.device_subject import identified
from benchmarks.devices import subject
from draws import seed_of
from whole_runs import write_tables_alone

from torchid.simulate.options import SimulateOptions

SEED = seed_of(__name__)


@pytest.fixture(scope="module", autouse=True)
def _each_body_once() -> Iterator[None]:
    """The run over a subject's recordings knows of no device: it is made once, whatever is asked of the device."""
    with pytest.MonkeyPatch.context() as patch:
        write_tables_alone(patch)
        patch.setattr("benchmarks.devices.identified", functools.cache(identified))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of all subjects."""
    return tmp_path_factory.mktemp("devices")


def figures_of(kind: str, folder: Path, blind: bool) -> dict[str, float]:
    """Figures of the first subject from a seed on who can do the motions in balance."""
    options = SimulateOptions(duration_s=6.0, skin_motion_mm=5.0)
    return in_balance(lambda k: subject(kind, k % 1000, folder / str(k), options, blind=blind).figures, SEED)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [pytest.param(k, marks=pytest.mark.battery) if k != "hip" else k for k in CASES])
def test_a_device_is_recovered(kind: str, folder: Path) -> None:
    """Assistance within 10 %, mass within 0.2 kg, and nothing that a sensor measured stays unknown."""
    figures = figures_of(kind, folder, blind=False)
    assert figures["not_determinable"] == 0.0, figures
    assert figures["assistance_pct"] < 10.0 and figures["mass_kg"] < 0.2, figures


@pytest.mark.slow
def test_without_a_sensor_nothing_is_claimed(folder: Path) -> None:
    """Both numbers of both springs are not determinable; the mass is found all the same."""
    figures = figures_of("hip", folder, blind=True)
    assert figures["not_determinable"] == 4.0 and figures["mass_kg"] < 0.2, figures
