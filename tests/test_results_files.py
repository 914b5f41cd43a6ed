"""Files for other programs: one table of all numbers, strides, and what OpenSim's tool needs."""

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
import xarray
from balance import in_balance
from draws import seed_of

from torchid.config import load_config
from torchid.contact.sharing.records import ContactWrenches, WrenchSource
from torchid.cycles.measures import STRIDE
from torchid.io.storage import read_storage
from torchid.report.gait import gait_section
from torchid.run import run_experiment
from torchid.run.opensim_setup import ToolFiles, applied, write_tool_files
from torchid.session import Outcome
from torchid.session.joint_cycles import JOINTS, joint_cycles
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession, simulate_session, write_session

WALK = "walk"
OPTIONS = SimulateOptions(fit=("squats",), heldout=(WALK,), duration_s=5.0, rate_hz=50.0)
EDGE = 3
"""Frames at either end of a setup, in which OpenSim's splines know one side alone."""
AGREES = 5e-3
"""Largest difference of a force or a moment over its range, or over 1 N or 1 N m where it hardly changes."""
CLOSE_DEG = 5.0
"""RMS by which angles of an identified body may differ from the true ones."""


@dataclass(frozen=True)
class Walked:
    """A simulated session with walks, and its run."""

    session: SimulatedSession
    outcome: Outcome
    out: Path


@pytest.fixture(scope="module")
def walked(tmp_path_factory) -> Walked:
    folder = tmp_path_factory.mktemp("walked")
    session = in_balance(lambda attempt: simulate_session(OPTIONS, attempt), seed_of(__name__))
    config = write_session(session, OPTIONS, folder).config
    loaded = load_config(config, ["geometry.max_frames=60", "geometry.temporal=false", "diagnosis.enabled=false"])
    return Walked(session, run_experiment(loaded), loaded.out)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_number_of_the_table_is_that_of_the_json_files(walked):
    """Masses, centres, inertias and lengths with their deviations, each with a unit or a share, and a meaning."""
    table = {(row["group"], row["item"], row["quantity"]): row for row in rows(walked.out / "results.csv")}
    body, geometry = (json.loads((walked.out / f"{name}.json").read_text()) for name in ("inertia", "geometry"))
    assert float(table["body", "whole", "mass"]["value"]) == body["total_mass"]["value_kg"]
    for name, own in body["segments"].items():
        assert float(table["segment", name, "mass"]["sd"]) == own["sd"]["mass_kg"]
        assert float(table["segment", name, "com_z"]["value"]) == own["com_m"][2]
        assert float(table["segment", name, "inertia_xz"]["value"]) == own["inertia_kgm2"][0][2]
    for name, own in geometry["segments"].items():
        assert float(table["length", name, "length"]["value"]) == own["length_m"]
    assert {row["item"] for row in rows(walked.out / "results.csv") if row["group"] == "trial"} == set(
        walked.outcome.session.trials
    )
    assert all(row["meaning"] and row["subject"] for row in table.values())


def test_strides_are_those_of_the_walks_and_their_angles_the_true_ones(walked):
    found = joint_cycles(walked.outcome)
    assert found is not None and found.joints == JOINTS
    assert {cycle.trial for cycle in found.cycles} == {WALK}
    truth = {item.trial.name: item.truth.motion for item in walked.session.trials}
    names = walked.session.subject.model.tree.dof_names
    for k, cycle in enumerate(found.cycles):
        own = [names.index(joint.replace("_", f"_{cycle.side}_", 1)) for joint in found.joints]
        true = math.degrees(1.0) * truth[cycle.trial].q[cycle.frames][:, own]
        ends = found.angle_deg[k, [0, -1]] - true[[0, -1]]
        assert float(ends.square().mean().sqrt()) < CLOSE_DEG, cycle
    speed, time, length = (
        found.values[:, STRIDE.index(name)] for name in ("speed_m_s", "stride_time_s", "stride_length_m")
    )
    torch.testing.assert_close(speed * time, length)


def test_the_table_of_strides_is_what_the_motion_file_says(walked):
    """At a strike, which is a frame, angle, moment and power are that frame's."""
    table, found = rows(walked.out / "cycles.csv"), joint_cycles(walked.outcome)
    assert found is not None and len(table) == found.angle_deg.numel()
    first = [row for row in table if row["percent"] == "0"]
    for row in first:
        with xarray.open_dataset(walked.out / f"motion_{row['trial']}.nc") as motion:
            frame = motion.isel(time=int(np.abs(motion.time.values - float(row["start_s"])).argmin()))
            dof = frame.sel(dof=row["joint"].replace("_", f"_{row['side']}_", 1))
            assert float(row["angle_deg"]) == pytest.approx(math.degrees(float(dof.q)), rel=1e-5, abs=1e-6)
            torque = float(dof.torque)
            assert (row["moment_Nm"] == "") == math.isnan(torque)
            if row["moment_Nm"]:
                assert float(row["moment_Nm"]) == pytest.approx(torque, rel=1e-5, abs=1e-6)
                assert float(row["power_W"]) == pytest.approx(torque * float(dof.v), rel=1e-4, abs=1e-5)


def test_the_page_shows_strides_where_somebody_walks(walked):
    section = gait_section(joint_cycles(walked.outcome))
    assert section is not None and "steps a minute" in section.finding
    assert 'id="gait"' in (walked.out / "report.html").read_text(encoding="utf-8")
    assert gait_section(None) is None


def test_force_point_and_torque_are_the_wrench_in_every_frame(seed):
    """Also of a foot in the air, where the point is that of the nearest contact; the torque is vertical under load."""
    rng = torch.Generator().manual_seed(seed)
    wrench = torch.randn(50, 6, generator=rng, dtype=torch.float64) * torch.tensor([30.0, 30, 0, 40, 40, 9])
    wrench[10:30, 2] = 700.0 * torch.rand(20, generator=rng, dtype=torch.float64) + 30.0
    force, point, torque = applied(wrench).split(3, dim=1)
    R = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=torch.float64)
    torch.testing.assert_close(force @ R, wrench[:, :3])
    torch.testing.assert_close((torque + torch.linalg.cross(point, force)) @ R, wrench[:, 3:])
    assert torque[10:30, [0, 2]].abs().max() < 1e-9
    assert torch.equal(point[:10], point[10:11].expand(10, 3)) and torch.equal(point[30:], point[29:30].expand(20, 3))


def test_a_setup_covers_the_longest_time_in_which_all_is_known(tmp_path):
    """Frames with an unknown contact are outside; where there is no other, no setup is written."""
    wrench = torch.zeros(40, 2, 6, dtype=torch.float64)
    source = torch.full((40, 2), int(WrenchSource.MEASURED))
    source[:5], source[20] = int(WrenchSource.UNKNOWN), int(WrenchSource.UNKNOWN)
    none, some = torch.zeros(0, dtype=torch.long), torch.zeros(0, 12, 1)
    time = 0.01 * torch.arange(40, dtype=torch.float64)
    files = ToolFiles(*(tmp_path / name for name in ("a_grf.mot", "a.xml", "a_setup.xml", "a_ik.mot")))
    write_tool_files(ContactWrenches(("foot_l", "foot_r"), wrench, source, none, some), time, files)
    assert "<time_range>0.21 0.39</time_range>" in files.setup.read_text()
    files.setup.unlink(), files.loads.unlink()
    source[:] = int(WrenchSource.UNKNOWN)
    write_tool_files(ContactWrenches(("foot_l", "foot_r"), wrench, source, none, some), time, files)
    assert files.forces.exists() and not files.setup.exists() and not files.loads.exists()


def test_opensim_gives_the_same_moments_from_the_files(walked, monkeypatch):
    """OpenSim's own tool, with its splines, from kinematics, forces, loads and setup as they were written."""
    opensim = pytest.importorskip("opensim")
    opensim.Logger.setLevelString("Error")
    monkeypatch.chdir(walked.out)
    assert opensim.InverseDynamicsTool(f"{WALK}_id_setup.xml").run()
    ours, theirs = (read_storage(walked.out / name) for name in (f"{WALK}_id.sto", f"{WALK}_id_setup_result.sto"))
    columns = [name for name in theirs.columns if name.endswith(("moment", "force"))]
    assert set(columns) == set(ours.columns)
    for name in columns:
        there = theirs.values[EDGE:-EDGE, theirs.columns.index(name)]
        own = np.interp(theirs.time, ours.time, ours.values[:, ours.columns.index(name)])[EDGE:-EDGE]
        assert np.abs(own - there).max() < AGREES * max(np.ptp(own), 1.0), name
