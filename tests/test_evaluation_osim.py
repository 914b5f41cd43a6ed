"""A laboratory's own OpenSim model in an evaluation and in a stream: knees of functions, the low back, names, signs."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import xarray
import yaml
from device_cases import made, random_motion
from osim_session import FUNCTION_KNEES, Truth, identified
from test_devices_forces import moved
from torch.testing import assert_close
from typer.testing import CliRunner

from torchid.cli import app
from torchid.config import load_config
from torchid.cycles.conventions import chosen, spellings
from torchid.devices import device_forces, refuse_foreign
from torchid.devices.action import action
from torchid.devices.forces import states
from torchid.dynamics.equations_of_motion import body_rows, body_wrenches, dynamic_state
from torchid.effects.displacement import carriage
from torchid.effects.scene import make_scene
from torchid.errors import ConfigError
from torchid.evaluation.torque_shares.back import low_back, trunk_of
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import poses
from torchid.live.run import run_live
from torchid.model.model import Geometry, Model
from torchid.model.opensim.as_model import read_osim_model
from torchid.motion import Motion
from torchid.run import run_experiment
from torchid.torque.inverse import joint_torques

GAIT2354 = "opensim_subject01_gait2354/reference/subject01_RRA_adjusted.osim"
"""Knees that slide by functions, and whose coordinate is negative in flexion."""
MODELS = (
    FUNCTION_KNEES, GAIT2354, "hamner2013_subject04/unscaled_generic.osim",
    "opencap_subject4/Models/optimized_scale_and_markers.osim", "arnold2013_synthetic_truth/subject01/subject01.osim",
)  # fmt: skip
OVER_THE_KNEE = [
    {"type": "spring", "name": "knee", "between": ["femur_r", "tibia_r"], "coordinate": "knee_angle_r",
     "stiffness_Nm_rad": 30},
    {"type": "spring", "name": "hinge", "between": ["femur_l", "tibia_l"], "axis": [0, 1, 0], "stiffness_Nm_rad": 20},
    {"type": "cable", "name": "strap", "between": ["pelvis", "tibia_r"], "from_m": [-0.1, 0.05, 0.0],
     "to_m": [-0.04, 0.0, -0.2], "via": [{"segment": "femur_r", "point_m": [-0.06, 0.0, -0.3]}],
     "stiffness_N_m": 900, "rest_m": 0.1},
]  # fmt: skip


def model_of(name: str, data_dir: Path) -> tuple[Model, Geometry]:
    """A laboratory's model and its joints as shipped."""
    path = data_dir / name
    if not path.exists():
        pytest.skip(f"no {path}")
    model, _ = read_osim_model(path)
    return model, model.geometry.geometry(model.geometry.mean)


@pytest.mark.data
@pytest.mark.parametrize("name", MODELS)
def test_a_device_over_a_knee_of_functions_does_the_work_of_its_length(name: str, data_dir: Path, seed: int) -> None:
    """Moment arms are derivatives by the file's coordinates, functions included, by central differences; about an axis
    they are the turning of one body against the other. Power is torque times rate."""
    model, geometry = model_of(name, data_dir)
    tree, h = model.tree, 1e-6
    motion = random_motion(np.random.default_rng(seed), tree, 6)
    device = made(elements=OVER_THE_KNEE)
    for one in device.elements:
        state, ends = states(tree, geometry, motion, slice(None)), []
        act = action(one, state, motion.q.T)
        if one.name == "hinge":
            first, second = (state.plan.position[tree.index(name)] for name in one.between)
            turning = state.motion.w[second] - state.motion.w[first]
            assert_close(act.rate(motion.v.T), (turning * state.at.R[first, 1]).sum(0))
            continue
        for step in (h, -h):
            q = moved(motion, step)
            there = states(tree, geometry, Motion(motion.time, q, motion.v, motion.a, motion.smoother), slice(None))
            ends.append(action(one, there, q.T).length)
        assert_close(act.rate(motion.v.T), (ends[0] - ends[1]) / (2.0 * h), atol=1e-6, rtol=1e-6)
    found = device_forces(device, tree, geometry, motion)
    assert_close(found.power, (found.torque * motion.v).sum(1))
    assert float(found.torque[:, :6].abs().max()) < 1e-10 * float(found.torque.abs().max())


@pytest.mark.data
@pytest.mark.parametrize("name", MODELS)
def test_the_moment_at_l5_s1_is_that_of_what_it_carries(name: str, data_dir: Path, seed: int) -> None:
    """Sum over trunk, head and arms of their inertial and gravity wrenches about the file's back joint."""
    model, geometry = model_of(name, data_dir)
    tree, phi = model.tree, model.inertia.mean
    motion = random_motion(np.random.default_rng(seed), tree, 5)
    back, trunk = low_back(tree, geometry, phi, motion), trunk_of(tree)
    assert back is not None and trunk == "torso"
    state = dynamic_state(tree, geometry, *(x.T.contiguous() for x in (motion.q, motion.v, motion.a)))
    own = [state.plan.position[k] for k in tree.subtree(tree.index(trunk))]
    total = body_wrenches(state.plan, body_rows(state), phi)[own].sum(0)
    joint = state.at.p[state.plan.position[tree.index(trunk)]] - state.at.p[0]
    M_P = torch.einsum("crf,rf->fc", state.at.R[0], total[3:] - torch.linalg.cross(joint, total[:3], dim=0))
    found = back.moment(joint_torques(tree, geometry, phi, motion, ()))
    assert_close(found, torch.stack([-M_P[:, 1], M_P[:, 0], M_P[:, 2]], 1), rtol=1e-6, atol=1e-6)
    # The pelvis' own axes: X forward, Y left, Z up, whatever the file calls them.
    standing = poses(plan_tree(tree), torch.zeros(len(tree.dofs), 1, dtype=torch.float64), geometry)
    up = standing.p[state.plan.position[tree.index(trunk)]] - standing.p[state.plan.position[tree.index("tibia_r")]]
    assert float(up[2, 0]) > 0.3 > float(up[:2, 0].norm())


@pytest.mark.data
@pytest.mark.parametrize("name", MODELS)
def test_signs_of_isb_are_found_from_how_bodies_turn(name: str, data_dir: Path) -> None:
    """A knee that flexes takes the foot back, hips and shoulders what hangs on them forward, a trunk that flexes goes
    forward; the file's own convention keeps its names."""
    model, geometry = model_of(name, data_dir)
    tree, plan = model.tree, plan_tree(model.tree)
    spelling = spellings(model, "isb", True)
    assert spelling["knee_angle_l"].sign == (-1.0 if name == GAIT2354 or "hamner" in name else 1.0)
    carried = {"knee_flexion": "calcn", "hip_flexion": "calcn", "shoulder_flexion": "radius", "lower_spine_flexion": ""}
    seen = set()
    for row, dof in enumerate(tree.dof_names[6:], 6):
        isb, sign = spelling[dof]
        movement, _, side = isb.rpartition("_") if isb[-2:] in ("_l", "_r") else (isb, "", "")
        if movement not in carried:
            continue
        q = torch.zeros(len(tree.dofs), 2, dtype=torch.float64)
        q[row, 1] = 0.4 * sign
        at = poses(plan, q, geometry)
        k = plan.position[tree.index(f"{carried[movement]}_{side}" if side else "torso")]
        way = float(at.p[k][0].diff()) if side else float(at.R[k, 2, 0].diff())
        assert way < -0.03 if movement == "knee_flexion" else way > 0.03, (dof, way)
        seen.add(movement)
    assert seen >= {"knee_flexion", "hip_flexion", "lower_spine_flexion"}
    assert all(tuple(one) == (dof, 1.0) for dof, one in spellings(model, "torchid", True).items())


@pytest.mark.data
@pytest.mark.parametrize("name", MODELS)
def test_bands_carry_markers_by_the_files_coordinates(name: str, data_dir: Path, seed: int) -> None:
    """How bodies move per unit of each coordinate, from which bands of torques are drawn, by central differences."""
    model, geometry = model_of(name, data_dir)
    tree, h = model.tree, 1e-6
    motion = random_motion(np.random.default_rng(seed), tree, 3)
    rate = motion.v.clone()
    rate[:, :6] = 0.0
    scene = make_scene("trial", tree, geometry, motion, model.inertia.mean)
    moving = torch.einsum("frd,fd->fr", carriage(scene), rate).unflatten(1, (-1, 6))[:, :, :3]
    ahead, behind = (poses(plan_tree(tree), (motion.q + step * rate).T.contiguous(), geometry).p for step in (h, -h))
    assert_close(moving, ((ahead - behind) / (2.0 * h)).permute(2, 0, 1), atol=1e-6, rtol=1e-6)


@pytest.mark.data
def test_joints_and_devices_are_asked_for_by_either_name(data_dir: Path) -> None:
    """The built-in names find a file's coordinates; a segment that the file does not have is refused with its own."""
    model, _ = model_of(GAIT2354, data_dir)
    dofs = model.tree.dof_names[6:]
    assert chosen(("knee_flexion", "hip_flexion_r", "lower_spine_flexion", "elbow_flexion"), dofs) == (
        ("knee_angle_r", "knee_angle_l", "hip_flexion_r", "lumbar_extension"), ("elbow_flexion",)
    )  # fmt: skip
    refuse_foreign(made(elements=OVER_THE_KNEE), model.tree)
    part = {"segment": "thigh_l", "mass_kg": 1.0}
    coordinate = {**OVER_THE_KNEE[0], "coordinate": "knee_r_flexion"}
    point = {**OVER_THE_KNEE[2], "via": [{"segment": "thigh_r", "point_m": [0, 0, 0]}]}
    for sheet, code in (({"parts": [part]}, "device.segment"), ({"elements": [coordinate]}, "device.coordinate"),
                        ({"elements": [point]}, "device.segment")):  # fmt: skip
        with pytest.raises(ConfigError) as caught:
            refuse_foreign(made(**sheet), model.tree)
        assert caught.value.code == code and ("femur_r" in caught.value.remedy or "knee_angle_r" in caught.value.remedy)


def taken_up(folder: Path) -> tuple[dict, Truth]:
    """What a config in a folder has to say for a run there to take up the stages of the identified body's; the truth.

    Recordings are named where they are: a stage's key has their paths.
    """
    made, truth, _ = identified()
    shutil.copytree(made / "out", folder / "out")
    document = yaml.safe_load((made / "config.yaml").read_text())
    for trial in document["trials"]:
        trial["file"] = str(made / trial["file"])
    return document, truth


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.battery
@pytest.mark.usefixtures("tables_alone")
def test_an_evaluation_with_the_laboratorys_own_model(data_dir: Path, tmp_path: Path) -> None:
    """From files: a knee spring's share is the sheet's at the file's coordinate, the other body is the model as it was
    shipped, and report, files and written model speak the file's names; another sheet is refused at once."""
    model_of(FUNCTION_KNEES, data_dir)
    document, _ = taken_up(tmp_path)
    static, fit, heldout = document["trials"]
    document["trials"] = [static, fit | {"condition": "without"}, heldout, heldout | {"name": "on", "condition": "on"}]
    (tmp_path / "exo.yaml").write_text(yaml.safe_dump({"name": "knee spring", "elements": OVER_THE_KNEE[:1]}))
    cycles = [{"trial": name, "t0": t, "t1": t + 0.6} for name in ("fit", "on") for t in (0.7, 1.5, 2.3)]
    document |= {
        "conditions": {"without": {"reference": True}, "on": {"device": "exo.yaml"}},
        "evaluate": {"cycles": cycles, "joints": ["knee_flexion", "lower_spine_flexion"], "draws": 20,
                     "convention": "isb"},
    }  # fmt: skip
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(document))
    done = CliRunner().invoke(app, ["evaluate", str(tmp_path / "config.yaml")])
    assert done.exit_code == 0, done.output
    held = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert held["template_is"] == "model as shipped" and held["signs"] == "file_isb"
    assert set(held["joints"]) == {"knee_flexion_r", "knee_flexion_l", "lower_spine_flexion", "L5/S1", "cycle"}
    data = xarray.open_dataset(tmp_path / "out" / "cycles_on.nc", engine="h5netcdf")
    knee, angle = (list(data[name].values) for name in ("course", "coordinate"))
    share = data.device.values[..., knee.index("knee_flexion_r torque_Nm")]
    np.testing.assert_allclose(share, -30.0 * data.angle.values[..., angle.index("knee_flexion_r")], atol=1e-9)
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "model as shipped" in page.lower() and "scaled template" not in page.lower()
    (tmp_path / "exo.yaml").write_text(yaml.safe_dump({"name": "a", "parts": [{"segment": "thigh_l", "mass_kg": 1.0}]}))
    done = CliRunner().invoke(app, ["evaluate", str(tmp_path / "config.yaml")])
    assert done.exit_code == 2 and "device.segment" in done.output


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.usefixtures("tables_alone")
@pytest.mark.usefixtures("quick_children")
def test_a_stream_of_a_body_of_functions_is_identified_as_a_recording_is(data_dir: Path, tmp_path: Path) -> None:
    """With the geometry of the finished evaluation's run; masses agree with the run's within their deviations, and with
    the truth as the run's do. Advice, which knows the built-in joints alone, is refused before anybody moves."""
    model_of(FUNCTION_KNEES, data_dir)
    document, truth = taken_up(tmp_path)
    document["trials"][1]["condition"], document["trials"][2]["condition"] = "without", "other"
    document["conditions"] = {"without": {"reference": True}, "other": {}}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(document))
    config = load_config(tmp_path / "config.yaml")
    run = run_experiment(config)
    assert run.times["geometry"].reused
    live = run_live(config, "replay:fit", np.inf)
    assert live["geometry"] == "run" and live["lost"] == live["restarts"] == 0
    table = json.loads((config.out / "live.json").read_text())["segments"]
    assert set(table) == set(truth.model.tree.names) and run.identified is not None
    mass = torch.tensor([table[name]["mass_kg"] for name in truth.model.tree.names], dtype=torch.float64)
    sd = run.identified.fit.sd.mass
    assert float(((mass - run.phi[:, 0]) / sd).square().mean().sqrt()) < 1.0, (mass - run.phi[:, 0]) / sd
    assert float(((mass - truth.phi[:, 0]) / sd).square().mean().sqrt()) < 3.0
    words = ["live", str(tmp_path / "config.yaml"), "--source", "replay:fit", "--headless", "--speed", "inf", "--guide"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2 and "guidance.model" in done.output
