"""Tests of torchid.run.bids: a run's data set of Motion-BIDS holds what its other files hold, and is valid."""

import csv
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import small_session as small
import torch
import whole_runs
import xarray
import yaml
from numpy.testing import assert_allclose

from torchid.config import load_config
from torchid.folder.proposal import propose
from torchid.io import read_trial
from torchid.io.c3d_write import write_c3d
from torchid.run import run_experiment
from torchid.run.bids import bids_names, bids_stems, write_bids_about
from torchid.run.write import result_names
from torchid.session import Outcome

SUBJECT = {"name": "sub-Ä 7", "mass_kg": 71.5, "height_m": 1.76, "sex": "female", "age_years": 93.0}
TRIALS = ("static", "squats 1", "Squats1")
"""Two of them have one label, which are one recording."""
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """A short run with gaps, without an inertial fit."""
    folder = tmp_path_factory.mktemp("bids")
    for name in ("static", "squats"):
        trial = small.session().trial(name).trial
        position = trial.markers.position.clone()
        position[20:24, 3] = torch.nan
        write_c3d(folder / f"{name}.c3d", replace(trial, markers=replace(trial.markers, position=position)))
    files = [{"name": name, "file": "static.c3d" if name == "static" else "squats.c3d"} for name in TRIALS]
    files = [one | {"role": role} for one, role in zip(files, ("static", "fit", "heldout"), strict=True)]
    config = {
        "subject": SUBJECT, "markers": "simulated", "trials": files, "inertia": {"enabled": False}, "bids": True,
        "geometry": {"max_frames": 20, "iterations": 8, "static_frames": 5}, "out": "out",
    }  # fmt: skip
    (folder / "config.yaml").write_text(yaml.safe_dump(config, allow_unicode=True))
    with pytest.MonkeyPatch.context() as patch:
        whole_runs.leave_out_report(patch)
        return run_experiment(load_config(folder / "config.yaml"))


def table(ran: Outcome, name: str) -> dict[str, np.ndarray]:
    """Columns of a trial's table by the names of its channels."""
    stem = ran.config.out / bids_stems(SUBJECT["name"], TRIALS)[name]
    with stem.with_name(f"{stem.name}_channels.tsv").open(newline="") as file:
        names = [row["name"] for row in csv.DictReader(file, delimiter="\t")]
    columns = np.genfromtxt(f"{stem}_motion.tsv", delimiter="\t", missing_values="n/a").T
    return dict(zip(names, columns, strict=True))


def test_it_is_what_the_run_had_claimed(ran: Outcome) -> None:
    """Every file and no other; without the key there is none of them."""
    written = {path.relative_to(ran.config.out).as_posix() for path in (ran.config.out / "bids").rglob("*.*")}
    assert written == set(bids_names(SUBJECT["name"], TRIALS))
    assert written == set(result_names(TRIALS, (), SUBJECT["name"])) - set(result_names(TRIALS))
    assert {path.split("/")[1] for path in written if "/sub-" in path} == {"sub-A7"}


@pytest.mark.parametrize("name", TRIALS)
def test_markers_are_read_back(ran: Outcome, name: str) -> None:
    """To the digits that are written, with their gaps, labels, clock, unit and person."""
    markers = ran.session.trials[name].markers
    found = read_trial(name, ran.config.out / f"{bids_stems(SUBJECT['name'], TRIALS)[name]}_motion.tsv")
    assert found.markers.labels == markers.labels and found.parameters["subject"] == "sub-A7"
    assert_allclose(found.markers.time, markers.time, atol=1e-6)
    assert_allclose(found.markers.position, markers.position, rtol=5e-7, atol=1e-12, equal_nan=True)
    assert found.markers.position[20:24, 3].isnan().all()
    assert {note.code for note in found.notes} == {"axes.up"}


def test_angles_moments_and_plates_are_those_of_the_other_files(ran: Outcome) -> None:
    """In SI units; angles where markers tell them, plates as they were read."""
    columns = table(ran, "squats 1")
    with xarray.open_dataset(next(ran.config.out.glob("motion_squats-1-*.nc"))) as motion:
        knee = motion.sel(dof="knee_l_flexion")
        told = motion["observable"].to_numpy()
        assert_allclose(columns["knee_l_flexion"], np.where(told, knee["q"], np.nan), rtol=5e-7)
        assert_allclose(columns["knee_l_flexion moment"], knee["torque"], rtol=5e-7, atol=1e-12)
        assert told.all() and "pelvis_x" not in columns
    trial = ran.session.trials["squats 1"]
    assert trial.forces is not None
    for k, plate in enumerate(trial.forces.plates):
        for j, kind in enumerate(("force", "moment")):
            own = np.stack([columns[f"{plate.name} {kind} {axis}"] for axis in "xyz"], axis=1)
            assert_allclose(own, trial.forces.wrench[:, k, 3 * j : 3 * j + 3], rtol=5e-7, atol=1e-12)


def test_a_session_is_made_of_it(ran: Outcome) -> None:
    """`torchid new` on the data set finds the trials and the person; an age above 89 is not told."""
    proposal = propose(ran.config.out / "bids")
    person = proposal.told.person
    assert (person.mass_kg, person.height_m, person.sex, person.age_years) == (71.5, 1.76, "female", 89.0)
    assert proposal.name == "sub-A7" and [use.role for use in proposal.uses].count("static") == 1
    assert len(proposal.uses) == 3 and proposal.markers.name == "simulated"


def test_of_whom_nothing_is_known_nothing_is_said(ran: Outcome, tmp_path: Path) -> None:
    """No table of participants then."""
    unknown = ran.config.subject.model_copy(
        update={"mass_kg": None, "height_m": None, "sex": "unknown", "age_years": None}
    )
    (tmp_path / "bids").mkdir()
    write_bids_about(unknown, tmp_path.joinpath)
    assert {path.name for path in (tmp_path / "bids").iterdir()} == {"dataset_description.json", "README.md"}
    about = json.loads((tmp_path / "bids" / "dataset_description.json").read_text())
    assert about["DatasetType"] == "derivative" and about["GeneratedBy"][0]["Name"] == "torchid"


def validated(folder: Path) -> set[tuple[str, str]]:
    """Codes of errors, and other codes, that the validator of the BIDS project has for a data set."""
    program = shutil.which("bids-validator-deno")
    if program is None:
        pytest.skip("the validator of BIDS is not installed: pip install bids-validator-deno")
    command = [program, str(folder), "--format", "json"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    issues = [SimpleNamespace(**one) for one in json.loads(done.stdout)["issues"]["issues"]]
    return {(one.severity, one.code) for one in issues}


@pytest.mark.parametrize("kind", ["derivative", "raw"])
def test_the_validator_of_bids_has_no_objection(ran: Outcome, tmp_path: Path, kind: str) -> None:
    """As a derivative, and by the stricter rules of raw data: warnings are of what nobody knows; a fault is told."""
    shutil.copytree(ran.config.out / "bids", tmp_path / "bids")
    said = tmp_path / "bids" / "dataset_description.json"
    said.write_text(said.read_text().replace("derivative", kind))
    found = validated(tmp_path / "bids")
    absent = {"TOO_FEW_AUTHORS", "SIDECAR_KEY_RECOMMENDED", "AGE_89"}
    absent |= {"NO_AUTHORS", "JSON_KEY_RECOMMENDED", "EVENTS_TSV_MISSING"} if kind == "raw" else set()
    assert found <= {("warning", code) for code in absent}
    channels = next((tmp_path / "bids").rglob("*_channels.tsv"))
    channels.write_text(channels.read_text().replace("JNTANG", "ANGLE"))
    assert ("error", "TSV_VALUE_INCORRECT_TYPE") in validated(tmp_path / "bids")
