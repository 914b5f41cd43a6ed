"""A run writes what is promised, takes up finished stages, and says why when something is missing."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import small_session as small
import torch
import xarray
import yaml
from torch.testing import assert_close
from typer.testing import CliRunner

from torchid.cli import app
from torchid.config import load_config
from torchid.io.c3d_write import write_c3d
from torchid.recording import Trial
from torchid.run import run_experiment
from torchid.run.write import result_names
from torchid.session.following import legs

pytestmark = pytest.mark.slow


def out() -> Path:
    small.outcome()
    return small.folder() / "out"


def table(name: str, folder: Path | None = None) -> dict:
    return json.loads(((folder or out()) / name).read_text())


def test_every_promised_file_is_there():
    """One file of each kind, and per trial motion, forces, and OpenSim's two."""
    names = {item.trial.name for item in small.session().trials}
    expected = {
        "config.yaml",
        "provenance.json",
        "geometry.json",
        "inertia.json",
        "model.urdf",
        "model.osim",
        "report.html",
    }
    expected |= {f"{kind}_{name}.nc" for kind in ("motion", "forces") for name in names}
    expected |= {f"{name}_{kind}" for kind in ("ik.mot", "id.sto") for name in names}
    assert expected <= {path.name for path in out().iterdir()}


def test_geometry_table_holds_the_fit():
    """Keys as promised; lengths and rms errors are those of the outcome."""
    found, content = small.outcome(), table("geometry.json")
    assert {"xi", "segments", "markers", "undetermined", "marker_rmse_mm"} <= set(content)
    assert set(content["xi"]) == set(found.fit.prior.names)
    entry = content["xi"][found.fit.prior.names[0]]
    assert entry["value"] == pytest.approx(float(found.fit.xi[0])) and entry["sd"] > 0 and entry["unit"] == "m"
    shank = found.fit.geometry.offset[found.fit.model.tree.index("foot_l")].norm()
    assert content["segments"]["shank_l"]["length_m"] == pytest.approx(float(shank))
    assert set(content["markers"]) == set(found.fit.attachment.labels)
    held = content["marker_rmse_mm"]["sway_steps"]
    assert held["identified"] == pytest.approx(1e3 * found.tracked("sway_steps").rmse)
    assert held["identified"] < held["scaled"] and set(held["markers"]) == set(found.fit.attachment.labels)


def test_inertia_table_holds_every_segment():
    """Mass, centre of mass, inertia about it, their scatter and the progress, for all bodies; masses add up."""
    content = table("inertia.json")
    assert set(content["segments"]) == set(small.template().tree.names)
    for entry in content["segments"].values():
        assert np.shape(entry["com_m"]) == (3,) and np.shape(entry["inertia_kgm2"]) == (3, 3)
        assert set(entry["sd"]) == {"mass_kg", "com_m", "inertia_kgm2"} and 0.0 <= entry["progress"] <= 1.0
    total = sum(entry["mass_kg"] for entry in content["segments"].values())
    assert content["total_mass"]["value_kg"] == pytest.approx(total)
    assert content["rank"] == len(content["base_parameters"]) and content["status"] == "accepted"
    assert {"certificate", "weights", "trials", "cutoff_hz"} <= set(content)


def test_motion_file_keeps_every_frame():
    """Coordinates, poses and markers of every marker frame, in the file's time and by name."""
    with xarray.open_dataset(out() / "motion_sway_steps.nc", engine="h5netcdf") as data:
        markers = small.session().trial("sway_steps").trial.markers
        np.testing.assert_allclose(data["time"], markers.time.numpy(), rtol=0, atol=1e-6)
        assert {"q", "v", "a", "torque", "X_WB", "markers_measured", "markers_modelled"} <= set(data.variables)
        assert list(data["body"].values) == list(small.template().tree.names)
        R = data["X_WB"].values[..., :3, :3]
        np.testing.assert_allclose(R @ R.swapaxes(-1, -2), np.broadcast_to(np.eye(3), R.shape), rtol=0, atol=1e-9)
        assert data["X_WB"].dims[:2] == ("time", "body")


def test_forces_file_holds_measured_and_predicted():
    """Plates add up to the total, and the prediction is near it where frames are used."""
    with xarray.open_dataset(out() / "forces_sway_steps.nc", engine="h5netcdf") as data:
        used = data["used"].values
        assert used.mean() > 0.5
        np.testing.assert_allclose(data["plate_wrench"].sum("plate")[used], data["measured"][used], rtol=0, atol=1e-6)
        off = (data["predicted"] - data["measured"]).values[used][:, :3]
        row = next(r for r in reversed(small.outcome().residuals) if r.role == "heldout")
        assert np.sqrt((off**2).sum(1).mean()) == pytest.approx(row.force_rmse_N, rel=1e-6)


def test_torques_are_blank_where_a_foot_is_not_measured():
    """A leg's torques are NaN exactly where its foot's wrench is unknown."""
    found = small.outcome()
    tree, item = found.fit.model.tree, found.followed["sway_steps"]
    assert item.contact is not None
    unknown = (item.contact.plate == -2).any(1)[:, None] & item.contact.touching | ~item.contact.supported
    for k, foot in enumerate(item.contact.feet):
        blank = torch.isnan(found.torque["sway_steps"][:, legs(tree)[foot]])
        assert_close(blank, unknown[:, k : k + 1].expand_as(blank))


def test_provenance_names_inputs_and_versions():
    """Hashes of the recordings, the seed, versions and the cost of every stage."""
    content = table("provenance.json")
    assert len(content["inputs"]) == len(small.session().trials) and content["seed"] == small.SEED
    stages = content["stages"]
    assert {"read", "geometry", "scaled", "inertia", "motion_sway_steps", "follow", "torques", "write"} <= set(stages)
    assert all(stage["seconds"] >= 0.0 and stage["cpu_seconds"] >= 0.0 for stage in stages.values())
    assert stages["geometry"]["cpu_seconds"] > 0.1
    told = small.outcome().times
    assert told["geometry"].seconds == stages["geometry"]["seconds"] and set(stages) - set(told) == {"write"}
    assert content["versions"]["torch"].startswith(torch.__version__.split("+")[0])


@pytest.mark.usefixtures("tables_alone")
def test_a_second_run_takes_up_the_stages(tmp_path):
    """Nothing is computed twice, and the results are the same to the last bit."""
    before, folder = small.outcome(), tmp_path / "out"
    shutil.copytree(out(), folder)
    again = run_experiment(load_config(small.config(), small.overrides(folder)))
    stages = table("provenance.json", folder)["stages"].values()
    assert any(stage["key"] for stage in stages) and all(stage["reused"] for stage in stages if stage["key"])
    assert_close(again.fit.xi, before.fit.xi, rtol=0, atol=0)
    assert_close(again.phi, before.phi, rtol=0, atol=0)


def short_session(folder: Path, forces: bool = True, **changes) -> Path:
    """A config of two short trials, with or without plates."""
    listed = []
    for name, role in (("static", "static"), ("squats", "fit")):
        trial = small.session().trial(name).trial
        if not forces:
            trial = Trial(name, trial.markers, None, role, parameters=trial.parameters)
        write_c3d(folder / f"{name}.c3d", trial)
        listed.append({"name": name, "role": role, "file": f"{name}.c3d"})
    config = yaml.safe_load(small.config().read_text())
    config |= {"trials": listed, "geometry": {"max_frames": 20, "iterations": 8, "static_frames": 5}, **changes}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    return folder / "config.yaml"


def test_two_runs_write_the_same_bytes(tmp_path):
    """Computed afresh, only the record of the run differs, and of the report only what the stages cost."""
    config, written = load_config(short_session(tmp_path, inertia={"refuse": False})), []
    for _ in range(2):
        run_experiment(config)
        written.append({path.name: path.read_bytes() for path in config.out.iterdir() if path.is_file()})
        shutil.rmtree(config.out)
    first, second = written
    assert set(first) == set(second)
    assert {name for name in first if first[name] != second[name]} <= {"provenance.json", "report.html"}
    reports = [files["report.html"].decode() for files in written]
    assert all("<summary>Time: " in report for report in reports)
    assert len({re.sub(r"<details>\s*<summary>Time: .*?</details>", "", report, flags=re.S) for report in reports}) == 1


def test_without_plates_everything_up_to_the_motion_is_written(tmp_path):
    """No forces: exit 3 with one line of reason; geometry and motion are there, an inertia table is not."""
    result = CliRunner().invoke(app, ["run", str(short_session(tmp_path, forces=False))])
    assert result.exit_code == 3 and "inertia.no_frames" in result.output
    found = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"geometry.json", "motion_squats.nc", "report.html", "squats_ik.mot"} <= found
    assert not {"inertia.json", "forces_squats.nc"} & found


@pytest.mark.usefixtures("no_report")
def test_inertia_can_be_left_out(tmp_path):
    """Disabled, the inertial fit is not missed: exit 0, forces predicted with the prior."""
    result = CliRunner().invoke(app, ["run", str(short_session(tmp_path, inertia={"enabled": False}))])
    assert result.exit_code == 0, result.output
    found = {path.name for path in (tmp_path / "out").iterdir()}
    assert "forces_squats.nc" in found and "inertia.json" not in found


def test_the_wrong_marker_set_is_said(tmp_path):
    """A marker set that fits no label ends with the labels and the remedy, before any fit."""
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("nothing: pelvis\n")
    result = CliRunner().invoke(app, ["run", str(short_session(tmp_path, markers=str(wrong)))])
    assert result.exit_code in (2, 3) and "markers" in result.output
    assert not (tmp_path / "out" / "geometry.json").exists()


@pytest.mark.usefixtures("no_report")
def test_results_in_the_folder_of_the_config_leave_the_users_files_alone(tmp_path):
    """``out: .`` keeps the config that the run started from; a file in the way is refused before any work."""
    config = short_session(tmp_path, inertia={"enabled": False}, out=".")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "squats_ik.mot").write_text("mine")
    refused = CliRunner().invoke(app, ["run", str(config)])
    assert refused.exit_code == 2 and "squats_ik.mot" in refused.output and "results.foreign" in refused.output
    assert not list((tmp_path / ".torchid" / "stages").iterdir())
    (tmp_path / "squats_ik.mot").unlink()
    for _ in range(2):
        result = CliRunner().invoke(app, ["run", str(config)])
        assert result.exit_code == 0, result.output
        assert all(path.read_bytes() == content for path, content in before.items())
    assert load_config(tmp_path / "config.resolved.yaml") == load_config(config)
    assert (tmp_path / "squats_ik.mot").is_file()


def test_every_file_that_a_run_writes_was_claimed_before():
    """No result comes as a surprise to ``result_names``."""
    small.outcome()
    names = [item.trial.name for item in small.session().trials]
    written = {path.name for path in out().iterdir() if path.is_file()} - {"config.yaml"}
    assert written <= set(result_names(names))


@pytest.mark.usefixtures("no_report")
def test_hidden_effects_are_hidden_from_the_fits(tmp_path):
    """A run's config tells nothing of how its recordings were made; it runs again, and other effects compute anew."""
    effect, reused = {"effect": "drag", "where": ["thorax"], "parameters": {"coefficient_Ns_m": 40.0}}, []
    config, written = tmp_path / "config.yaml", tmp_path / "out" / "config.yaml"
    document = {
        "subject": {"name": "S"}, "markers": "simulated", "seed": small.SEED, "out": str(tmp_path / "out"),
        "geometry": {"max_frames": 10, "iterations": 3, "static_frames": 4}, "inertia": {"enabled": False},
    }  # fmt: skip
    for effects, file in (([effect], config), ([effect], written), ([], config)):
        simulate = {"fit": ["squats"], "heldout": [], "duration_s": 2.0, "effects": effects}
        config.write_text(yaml.safe_dump({**document, "simulate": simulate}))
        outcome = run_experiment(load_config(file))
        reused.append(outcome.times["geometry"].reused)
        assert outcome.config.simulate is None and len(outcome.config.trials) == 2
        assert "drag" not in written.read_text()
        assert ("drag" in (tmp_path / "out" / "recordings" / "truth" / "subject.json").read_text()) == bool(effects)
    assert reused == [False, True, False]
