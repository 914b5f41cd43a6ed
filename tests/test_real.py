"""Short runs on real recordings: results that a person could have, honest refusals, and a plausible filter."""

import json
import math
from pathlib import Path

import pytest
from whole_runs import leave_out_report

from torchid.config import load_config
from torchid.io import read_trial
from torchid.motion import choose_cutoff
from torchid.run import run_experiment
from torchid.session import Outcome

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
SHORT = (
    "geometry.max_frames=40",
    "geometry.iterations=8",
    "geometry.temporal=false",
    "geometry.tolerance=1e-3",
    "diagnosis.enabled=false",
)

pytestmark = [pytest.mark.data, pytest.mark.slow]


def run(name: str, data: Path, out: Path, monkeypatch: pytest.MonkeyPatch, *overrides: str) -> Outcome:
    monkeypatch.setenv("TORCHID_DATA", str(data))
    leave_out_report(monkeypatch)
    return run_experiment(load_config(CONFIGS / f"{name}.yaml", [*SHORT, f"out={out}", *overrides]))


@pytest.fixture(scope="module")
def walk(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    """A walk with a static trial of a single frame, C3D, mass and height unknown."""
    out = tmp_path_factory.mktemp("walk")
    with pytest.MonkeyPatch.context() as patch:
        return run("schreiber_moissenet_2014001", data_dir, out, patch), out


def test_a_static_trial_of_one_frame_serves_the_geometry(walk: tuple[Outcome, Path]) -> None:
    """It is followed without motion and without forces, and the walk is tracked to less than two centimetres."""
    outcome, _ = walk
    still = outcome.followed["static"]
    assert still.wrench is None
    assert float(still.motion.v.abs().max()) == 0.0
    assert outcome.followed["walk"].tracked.rmse < 0.02


def test_mass_found_without_being_told_is_that_of_the_plates(walk: tuple[Outcome, Path]) -> None:
    """Total mass within 2 % of what the plates carry, segments within three scatters of the prior."""
    outcome, _ = walk
    assert outcome.identified is not None
    fit = outcome.identified.fit
    sd = fit.prior.covariance.diagonal().sqrt().reshape(-1, 10)[:, 0]
    assert float(((fit.mass - fit.prior.mean[:, 0]) / sd).abs().max()) < 3.0
    forces, contact = outcome.session.trials["walk"].forces, outcome.followed["walk"].contact
    assert forces is not None and contact is not None
    # A stride begins and ends alike, so that the mean vertical force over it is nearly the weight.
    weight = float(forces.total[contact.used, 2].mean()) / 9.80665
    assert float(fit.mass.sum()) == pytest.approx(weight, rel=0.02)


def test_frames_with_a_foot_beside_the_plates_are_left_out(walk: tuple[Outcome, Path]) -> None:
    """In every used frame the plates carry at least half the weight: nobody is airborne in walking."""
    outcome, _ = walk
    contact, forces = outcome.followed["walk"].contact, outcome.session.trials["walk"].forces
    assert contact is not None and forces is not None
    assert 0.3 < float(contact.used.double().mean()) < 0.9
    assert float(forces.total[contact.used, 2].min()) > 0.5 * 65.0 * 9.81


def test_no_number_in_the_tables_is_missing(walk: tuple[Outcome, Path]) -> None:
    """inertia.json and geometry.json hold finite numbers throughout, a trial without forces is null."""
    _, out = walk

    def numbers(value: object) -> list[float]:
        if isinstance(value, dict):
            return [x for item in value.values() for x in numbers(item)]
        if isinstance(value, list):
            return [x for item in value for x in numbers(item)]
        return [value] if isinstance(value, float) else []

    for name in ("inertia.json", "geometry.json"):
        found = numbers(json.loads((out / name).read_text()))
        assert found and all(math.isfinite(x) for x in found)


def test_legs_alone_tell_the_mass_and_say_what_nobody_saw(
    data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Standing weighs 60.2 kg; trunk, arms and head stay as in tables, and the verdict says that nobody saw them."""
    outcome = run("btk_functional", data_dir, tmp_path, monkeypatch)
    assert outcome.identified is not None and outcome.quality is not None
    fit = outcome.identified.fit
    assert float(fit.mass.sum()) == pytest.approx(60.2, rel=0.015)
    prior = outcome.prior.mean[:, 0]
    for name in ("thorax", "head", "upper_arm_l"):
        k = fit.names.index(name)
        assert float(fit.mass[k]) == pytest.approx(float(prior[k]), rel=0.15)
    (unseen,) = (one for one in outcome.quality.criteria if one.name == "unseen")
    assert "thorax" in unseen.words and "thigh" not in unseen.words


@pytest.mark.parametrize(
    ("file", "low", "high"),
    [
        ("opencap_subject4/MarkerData/walking1.trc", 4.0, 8.0),
        ("opencap_subject4/MarkerData/squats1.trc", 4.0, 8.0),
        ("hamner2013_subject04/trials/run400/markers.trc", 8.0, 15.0),
        ("opensim_subject01_gait2354/subject01_walk1.trc", 4.0, 8.0),
    ],
)
def test_cutoff_is_what_the_textbooks_use(data_dir: Path, file: str, low: float, high: float) -> None:
    """4 to 8 Hz in walks and squats, 8 to 15 Hz in running (Winter 2009), also where the laboratory filtered before."""
    markers = read_trial("trial", data_dir / file).markers
    assert low <= choose_cutoff(markers.position, markers.rate) <= high
