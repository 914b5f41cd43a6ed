"""A laboratory's own OpenSim model as the model of everything: poses, forces, fits, results in its own words."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import roma
import torch
import yaml
from harness.opensim_forces import as_free, osim_inverse_dynamics
from osim_dynamics import opensim_consistency, opensim_forces
from osim_files import MARKER, NAMES, joint, osim, transform
from osim_session import FUNCTION_KNEES, identified
from osim_trees import checked, drawn_state
from torch import Tensor
from torch.testing import assert_close

from torchid.config import load_config
from torchid.dynamics.rows import residual_rms
from torchid.errors import ConfigError
from torchid.kinematics.chain import chain_points, chain_poses
from torchid.model.opensim.as_model import LEAST_MASS, read_osim_model
from torchid.model.opensim.group_inertia import of_bodies, of_groups
from torchid.model.opensim.model import GROUND
from torchid.model.opensim.posing import body_poses, marker_places
from torchid.model.opensim.reading import read_osim
from torchid.model.opensim.rotations import R_OW
from torchid.model.opensim.tree_of_osim import tree_of_osim
from torchid.model.opensim.writing_back import identified_model, write_back
from torchid.model.pseudo import params_to_pseudo, pseudo_to_params
from torchid.model.tree_of_links import LEAST_EXTENT
from torchid.model.whole_body import lock_bodies
from torchid.session.opening import setup_of


def _path(name: str, data_dir: Path) -> Path:
    path = data_dir / name
    if not path.exists():
        pytest.skip(f"no {path}")
    return path


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_trees_pose_bodies_and_markers_as_the_file(name: str, data_dir: Path, seed: int) -> None:
    """Every body and marker of the tree stands where the file's own joints put it, and coordinates come back."""
    made, _ = read_osim_model(_path(name, data_dir))
    binding, tree = made.osim, made.tree
    assert binding is not None
    model, geometry = binding.model, made.geometry.geometry(made.geometry.mean)
    q, v, a = drawn_state(model, np.random.default_rng(seed))
    ours, _, _ = binding.to_tree(tree.dof_names, q, v, a)
    X_WT, X_GB = chain_poses(tree, ours, geometry), body_poses(model, q)
    for k, members in enumerate(binding.groups):
        for body in members:
            X_WB = X_WT[:, k] @ binding.X_TB[body]
            assert_close(R_OW @ X_WB[:, :3, :3], X_GB[:, body, :3, :3], rtol=0, atol=1e-9)
            assert_close(X_WB[:, :3, 3] @ R_OW.T, X_GB[:, body, :3, 3], rtol=0, atol=1e-9)
    names = [marker.name for marker in model.markers if marker.frame.body != GROUND]
    marks = [made.landmarks[one] for one in names]
    body = torch.tensor([tree.index(mark.segment) for mark in marks])
    places = chain_points(tree, ours, geometry, body, q.new_tensor([mark.p_BM_B for mark in marks]))
    assert_close(places @ R_OW.T, marker_places(model, q, names), rtol=0, atol=1e-9)
    again, _, _ = binding.to_tree(tree.dof_names, binding.from_tree(tree.dof_names, ours), v, a)
    assert_close(chain_poses(tree, again, geometry), X_WT, rtol=0, atol=1e-9)


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_forces_equal_opensims(name: str, data_dir: Path, seed: int) -> None:
    """Inverse dynamics on the file's coordinates equals OpenSim's to 1e-8 of the largest force.

    Rates are left out where several turns of a joint follow functions, of which OpenSim's accelerations are no rates of
    its velocities (see below). It rounds numbers of files older than version 4 to six digits.
    """
    pytest.importorskip("opensim")
    path = _path(name, data_dir)
    model, _ = read_osim(path)
    q, v, a = drawn_state(model, np.random.default_rng(seed), frames=3)
    plain = all(sum(bool(axis.rows) for axis in one.turns) <= len(one.rows) for one in model.joints)
    v = v if plain else 0.0 * v
    ours = osim_inverse_dynamics(as_free(model), q, v, a)
    theirs = opensim_forces(path, model.coordinate_names, *(x.tolist() for x in (q, v, a)))
    expected = torch.tensor(theirs, dtype=torch.float64)
    found = torch.stack([ours[name] for name in model.coordinate_names], dim=1)
    close = 1e-8 if model.version >= 40000 else 1e-6
    assert_close(found, expected, rtol=0, atol=close * float(expected.abs().max()))


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_forces_are_lagranges(name: str, data_dir: Path, seed: int) -> None:
    """Rates included, forces are those of Lagrange's equation for the energies of the file's own bodies."""
    model = as_free(read_osim(_path(name, data_dir))[0])
    q, v, a = drawn_state(model, np.random.default_rng(seed), frames=2)
    body_poses(model, q)  # frames remember their poses, which must not be made while derivatives are

    def kinetic(q: Tensor, v: Tensor) -> Tensor:
        X, rate = torch.func.jvp(lambda x: body_poses(model, x), (q,), (v,))
        spin = X[..., :3, :3].mT @ rate[..., :3, :3]
        w = torch.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], -1)
        speed = rate[..., :3, 3] + (rate[..., :3, :3] @ model.stated.centre[:, :, None])[..., 0]
        turning = (w * (model.stated.moments @ w[..., None])[..., 0]).sum()
        return 0.5 * (model.stated.mass * speed.square().sum(-1)).sum() + 0.5 * turning

    def potential(q: Tensor) -> Tensor:
        X = body_poses(model, q)
        centre = (X[..., :3, :3] @ model.stated.centre[:, :, None])[..., 0] + X[..., :3, 3]
        return -(model.stated.mass[:, None] * model.gravity * centre).sum()

    momentum = torch.func.grad(kinetic, argnums=1)
    expected = torch.func.jvp(momentum, (q, v), (v, a))[1]
    expected = expected - torch.func.grad(kinetic)(q, v) + torch.func.grad(potential)(q)
    ours = osim_inverse_dynamics(model, q, v, a)
    found = torch.stack([ours[name] for name in model.coordinate_names], dim=1)
    assert_close(found, expected, rtol=0, atol=1e-11 * float(expected.abs().max()))


@pytest.mark.data
def test_accelerations_of_opensims_function_knees_are_no_rates(data_dir: Path, seed: int) -> None:
    """What is left between OpenSim and Lagrange is OpenSim's: its shank's acceleration is not its velocity's rate."""
    pytest.importorskip("opensim")
    path = _path(FUNCTION_KNEES, data_dir)
    model, _ = read_osim(path)
    q, v, _ = drawn_state(model, np.random.default_rng(seed), frames=1)
    missed = {}
    for body in ("femur_r", "tibia_r"):
        asked = path, model.coordinate_names, body, q.tolist(), torch.ones_like(v).tolist()
        difference, acceleration = (np.array(x) for x in opensim_consistency(*asked))
        missed[body] = np.abs(difference - acceleration).max() / np.abs(difference).max()
    assert missed["femur_r"] < 1e-8 and missed["tibia_r"] > 1e-6, missed


@pytest.mark.data
def test_leading_coordinates_bear_what_follows_them(data_dir: Path, seed: int) -> None:
    """Force of a knee is that of OpenSim's free knee and that of its kneecap's coordinate, by virtual work."""
    model, _ = read_osim(_path(FUNCTION_KNEES, data_dir))
    q, v, a = drawn_state(model, np.random.default_rng(seed))
    free, held = osim_inverse_dynamics(as_free(model), q, v, a), osim_inverse_dynamics(model, q, v, a)
    for one in model.couplers:
        leading, following = (model.coordinate_names[row] for row in (*one.independents, one.dependent))
        slope = torch.func.jvp(one.function, (q[:, one.independents],), (torch.ones(len(q), 1).to(q),))[1]
        assert_close(held[leading], free[leading] + slope * free[following], rtol=1e-9, atol=1e-9)
        assert following not in held


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_identified_models_are_what_opensim_opens(name: str, data_dir: Path, seed: int, tmp_path: Path) -> None:
    """Other masses, joint centres and markers: the written file means in OpenSim what the tree means here."""
    pytest.importorskip("opensim")
    made, _ = read_osim_model(_path(name, data_dir))
    binding, rng = made.osim, np.random.default_rng(seed)
    assert binding is not None
    phi = made.inertia.mean * torch.tensor(rng.uniform(0.8, 1.2, size=(len(made.tree.bodies), 1)))
    xi = made.geometry.mean + 0.01 * torch.tensor(rng.normal(size=len(made.geometry.mean)))
    geometry = made.geometry.geometry(xi)
    places = {
        name: torch.tensor(made.landmarks[name].p_BM_B, dtype=torch.float64) + 0.01
        for name in [one.name for one in binding.model.markers if one.frame.body != GROUND][:5]
    }
    write_back(identified_model(binding, geometry, phi, places), tmp_path / "a.osim")
    again, _ = read_osim(tmp_path / "a.osim")
    tree, read, other = tree_of_osim(again)
    assert tree.names == made.tree.names and tree.dof_names == made.tree.dof_names
    assert_close(read.offset, geometry.offset, rtol=0, atol=1e-12)
    assert_close(of_groups(other, again.inertias.phi), phi, rtol=1e-9, atol=1e-9)
    q, v, a = drawn_state(again, rng, frames=2)
    ours = osim_inverse_dynamics(as_free(again), q, 0.0 * v, a)
    theirs = opensim_forces(tmp_path / "a.osim", again.coordinate_names, *(x.tolist() for x in (q, 0.0 * v, a)))
    expected = torch.tensor(theirs, dtype=torch.float64)
    found = torch.stack([ours[name] for name in again.coordinate_names], dim=1)
    assert_close(found, expected, rtol=0, atol=1e-6 * float(expected.abs().max()))
    moved = marker_places(again, q, list(places))
    body = torch.tensor([tree.index(made.landmarks[name].segment) for name in places])
    states, _, _ = other.to_tree(tree.dof_names, q, v, a)
    expected = chain_points(tree, states, geometry, body, torch.stack(list(places.values())))
    assert_close(moved, expected @ R_OW.T, rtol=0, atol=1e-9)


@pytest.mark.data
def test_bodies_share_what_their_group_is(data_dir: Path, seed: int) -> None:
    """Inertia of welded bodies, divided among them, is again that of the group; what did not change stays."""
    made, _ = read_osim_model(_path(FUNCTION_KNEES, data_dir))
    assert made.osim is not None
    same = of_bodies(made.osim, of_groups(made.osim, made.osim.model.inertias.phi))
    assert_close(same.phi, made.osim.model.inertias.phi, rtol=1e-9, atol=1e-12)
    rng = np.random.default_rng(seed)
    new = of_groups(made.osim, made.osim.model.inertias.phi) * torch.tensor(
        rng.uniform(0.7, 1.4, size=(len(made.tree.bodies), 1))
    )
    shift = torch.eye(4).double().repeat(len(new), 1, 1)
    shift[:, :3, 3] = 0.05 * torch.tensor(rng.normal(size=(len(new), 3)))
    new = pseudo_to_params(shift @ params_to_pseudo(new) @ shift.mT)
    divided = of_bodies(made.osim, new)
    assert_close(of_groups(made.osim, divided.phi), new, rtol=1e-9, atol=1e-12)
    assert bool((torch.linalg.eigvalsh(params_to_pseudo(divided.phi)) > -1e-12).all())


@pytest.mark.data
def test_torques_in_the_files_coordinates_do_the_same_work(data_dir: Path, seed: int) -> None:
    """Power of the file's generalised forces equals that of the tree's, whatever either calls its coordinates."""
    made, _ = read_osim_model(_path(FUNCTION_KNEES, data_dir))
    binding, rng = made.osim, np.random.default_rng(seed)
    assert binding is not None
    q, v, a = drawn_state(binding.model, rng)
    q[:, binding.root.rows[1]] = 0.4 * q[:, binding.root.rows[1]].sin()  # short of the pole of the root's angles
    states = binding.to_tree(made.tree.dof_names, q, v, a)
    tau = torch.tensor(rng.normal(size=states[0].shape))
    found = binding.forces(made.tree.dof_names, q, tau)
    rows = [binding.model.coordinate_names.index(name) for name in found]
    power = (torch.stack(list(found.values()), dim=1) * v[:, rows]).sum(1)
    assert_close(power, (tau * states[1]).sum(1), rtol=1e-9, atol=1e-9)


@pytest.mark.data
@pytest.mark.parametrize("case", range(3))
def test_torques_of_laboratories_are_opensims(case: int, data_dir: Path) -> None:
    """On two recordings, with OpenSim's filter and splines, torques are the reference's within 2 % of each range.

    Trunk and pelvis of the second are so where the torso's centre is what it was when the reference was made; legs
    anyway (``docs/opensim.md``).
    """
    path = Path(__file__).resolve().parents[1] / "scripts" / "opensim_torques.py"
    spec = importlib.util.spec_from_file_location("opensim_torques", path)
    assert spec is not None and spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = script  # its dataclasses look for their module there
    spec.loader.exec_module(script)
    one = script.CASES[case]
    _path(one.reference, data_dir)
    found = {name: row["reference_rms_pct"] for name, row in script.compared(one, again=False).items()}
    legs = {
        name: value for name, value in found.items() if name.startswith(("hip", "knee", "ankle", "subtalar", "mtp"))
    }
    assert max(legs.values()) < (2.0 if case == 0 else 0.01), legs
    assert case == 1 or max(found.values()) < (2.0 if case == 0 else 0.01), found


SIX = ("q0", "q1", "q2", "q3", "q4", "q5")


STRAIGHT = "<LinearFunction><coefficients>{0} {1}</coefficients></LinearFunction>"
LEANING = {
    "rotation1": ("q0", "1 0.2 0", STRAIGHT.format(1, 0)),
    "rotation2": ("q1", "0 1 0", STRAIGHT.format(1, 0)),
    "rotation3": ("q2", "0 0 1", STRAIGHT.format(-1, 0.3)),
    "translation1": ("q3", "1 0 0.4", STRAIGHT.format(1, 0)),
    "translation2": ("q4", "0 1 0", STRAIGHT.format(1, 0.2)),
    "translation3": ("q5", "0 0 1", STRAIGHT.format(1, 0)),
}
"""Axes of a root that do not stand at right angles."""
MARKS = "<MarkerSet><objects>{0}</objects></MarkerSet>"
PIN = {"parent": "/bodyset/a", "child": "/bodyset/b"}
ROOTS = {
    "planar": (joint("PlanarJoint", *SIX[:3]), joint("PinJoint", "q6", **PIN)),
    "pinned": (joint("PinJoint", "q0"), joint("PinJoint", "q6", **PIN)),
    "still": (joint("WeldJoint"), joint("PinJoint", "q6", **PIN)),
    "inwards": (joint("PlanarJoint", *SIX[:3], parent="/bodyset/a", child="/ground"), joint("PinJoint", "q6", **PIN)),
    "leaning": (joint("CustomJoint", *SIX, rest=transform(LEANING)), joint("PinJoint", "q6", **PIN)),
}
"""Roots that are no floating base."""
BESIDE = {
    "on ground": (
        joint("PinJoint", "q7", child="/bodyset/c"), joint("PlanarJoint", *SIX[:3]), joint("PinJoint", "q6", **PIN)
    ),
    "below": (
        joint("WeldJoint", child="/bodyset/c"), joint("PlanarJoint", *SIX[:3], parent="/bodyset/c"),
        joint("PinJoint", "q6", **PIN),
    ),
    "moving below": (
        joint("SliderJoint", "q7", child="/bodyset/c"), joint("FreeJoint", *SIX, parent="/bodyset/c"),
        joint("PinJoint", "q6", **PIN),
    ),
}  # fmt: skip
"""Files in which body c is no part of the person a, b."""


@pytest.mark.parametrize("case", ROOTS)
def test_a_person_floats_whatever_the_root_leaves_free(case: str, seed: int, tmp_path: Path) -> None:
    """Poses are the file's, coordinates come back from them, and what the file does not show is said."""
    made, notes = checked(tmp_path, osim(*ROOTS[case], bodies="ab"), np.random.default_rng(seed))
    assert made.tree.dof_names[6:] == ("q6",)
    assert [note.code for note in notes if note.code.startswith("osim.")] == ["osim.floats"]


@pytest.mark.parametrize("case", BESIDE)
def test_what_stands_beside_a_person_stays_in_the_file(case: str, seed: int, tmp_path: Path) -> None:
    """Neither body nor coordinate of it is identified; written back it has its own numbers, the person others."""
    text = osim(*BESIDE[case], bodies="abc", rest=MARKS.format(MARKER.format("M", "/bodyset/a")))
    made, notes = checked(tmp_path, text, np.random.default_rng(seed))
    assert made.osim is not None
    assert made.tree.names == ("a", "b") and made.tree.dof_names[6:] == ("q6",) and set(made.landmarks) == {"M"}
    assert "c: no part of the person" in next(note.message for note in notes if note.code == "osim.beside")
    phi = made.inertia.mean * torch.tensor([[1.3], [0.8]])
    geometry = made.geometry.geometry(made.geometry.mean)
    write_back(identified_model(made.osim, geometry, phi, {}), tmp_path / "b.osim")
    model, _ = read_osim(tmp_path / "b.osim")
    assert_close(model.inertias.mass, torch.tensor([2.6, 1.6, 2.0]).double())
    old, new = (path.read_text().partition('<Body name="c">')[2] for path in (tmp_path / "a.osim", tmp_path / "b.osim"))
    assert old.partition("</Body>")[0] == new.partition("</Body>")[0]


def test_a_shoulder_blade_is_no_person_of_its_own(seed: int, tmp_path: Path) -> None:
    """It slides on a thorax that is fixed on ground and bears no markers: its slides follow its turns."""
    radii = "<thoracic_ellipsoid_radii_x_y_z>0.07 0.15 0.07</thoracic_ellipsoid_radii_x_y_z>"
    blade = joint("ScapulothoracicJoint", *SIX[:4], **PIN, rest=radii)
    made, _ = checked(tmp_path, osim(joint("WeldJoint"), blade, bodies="ab"), np.random.default_rng(seed))
    assert made.tree.names == ("a", "b") and made.tree.dof_names[6:] == SIX[:4]


def test_a_marker_on_a_treadmill_makes_it_no_person(seed: int, tmp_path: Path) -> None:
    """One on the belt, more on the person."""
    marks = [MARKER.format(f"M{k}", f"/bodyset/{body}") for k, body in enumerate("caab")]
    text = osim(*BESIDE["moving below"], bodies="abc", rest=MARKS.format("".join(marks)))
    made, _ = checked(tmp_path, text, np.random.default_rng(seed))
    assert made.tree.names == ("a", "b") and set(made.landmarks) == {"M1", "M2", "M3"}


def test_angles_of_a_limited_root_do_not_jump(tmp_path: Path) -> None:
    """Three turns about the vertical are three turns."""
    (tmp_path / "a.osim").write_text(osim(*ROOTS["pinned"], bodies="ab"))
    made, _ = read_osim_model(tmp_path / "a.osim")
    assert made.osim is not None
    q = torch.zeros(60, 2, dtype=torch.float64)
    q[:, 0] = torch.linspace(0.0, 9.4, 60)
    states = made.osim.to_tree(made.tree.dof_names, q, 0.0 * q, 0.0 * q)
    found = made.osim.from_tree(made.tree.dof_names, states[0])
    assert_close(found - found[:1], q - q[:1], rtol=0, atol=1e-8)


def test_a_limited_root_shows_the_nearest_pose(seed: int, tmp_path: Path) -> None:
    """No pose within reach of a planar root is nearer to one that is not, by squares of turn and way."""
    (tmp_path / "a.osim").write_text(osim(*ROOTS["planar"], bodies="ab"))
    made, _ = read_osim_model(tmp_path / "a.osim")
    assert made.osim is not None
    rng, names = np.random.default_rng(seed), made.tree.dof_names
    q = torch.tensor(rng.normal(scale=0.6, size=(5, len(names))))
    found = made.osim.from_tree(names, q)

    def missed(coordinates: Tensor) -> Tensor:
        pose = made.osim.to_tree(names, coordinates, 0.0 * coordinates, 0.0 * coordinates)[0]
        turns = [roma.rotvec_to_rotmat(one[:, 3:6]) for one in (q, pose)]
        turn = torch.as_tensor(roma.rotmat_to_rotvec(turns[0] @ turns[1].mT))
        return (q[:, :3] - pose[:, :3]).square().sum(1) + turn.square().sum(1)

    least = missed(found)
    for _ in range(20):
        other = found.clone()
        other[:, :3] += torch.tensor(rng.normal(scale=0.02, size=(5, 3)))
        assert bool((missed(other) > least).all())


def test_couplers_with_where_the_person_is_are_opened(seed: int, tmp_path: Path) -> None:
    """A coordinate that would follow the pelvis is free, and that is said."""
    coupler = (
        "<ConstraintSet><objects><CoordinateCouplerConstraint name='k'><coupled_coordinates_function>"
        f"{STRAIGHT.format(1, 0)}</coupled_coordinates_function><independent_coordinate_names>q0"
        "</independent_coordinate_names><dependent_coordinate_name>q6</dependent_coordinate_name>"
        "</CoordinateCouplerConstraint></objects></ConstraintSet>"
    )
    text = osim(joint("FreeJoint", *SIX), joint("PinJoint", "q6", **PIN), bodies="ab", rest=coupler)
    made, notes = checked(tmp_path, text, np.random.default_rng(seed))
    assert made.tree.dof_names[6:] == ("q6",)
    assert [note.message.partition(":")[0] for note in notes if note.code == "osim.uncoupled"] == ["k"]


def test_every_kind_of_joint_hangs_in_a_tree(seed: int, tmp_path: Path) -> None:
    """Joints of all kinds, outwards or inwards, functions and constants: the tree's poses are the file's."""
    rng, names = np.random.default_rng(seed), iter(f"q{k}" for k in range(6, 99))
    plain = {"PinJoint": 1, "UniversalJoint": 2, "BallJoint": 3, "SliderJoint": 1, "PlanarJoint": 3, "FreeJoint": 6}
    for kind, count in plain.items():
        own = [next(names) for _ in range(count)]
        for parent, child in (("/bodyset/a", "/bodyset/b"), ("/bodyset/b", "/bodyset/a")):
            second = joint(kind, *own, parent=parent, child=child).replace(f"{kind}_a", "second", 1)
            checked(tmp_path, osim(joint("FreeJoint", *SIX), second, bodies="ab"), rng)
    line, bend = (f"<LinearFunction><coefficients>{x}</coefficients></LinearFunction>" for x in ("1 0", "-1 0"))
    curve = "<PolynomialFunction><coefficients>0.3 -0.2 0.4 0.1</coefficients></PolynomialFunction>"
    axes = {
        "rotation1": ("q6", "0.3 0.1 1", line),
        "rotation2": ("", "1 0 0", "<Constant><value>0.4</value></Constant>"),
        "rotation3": ("q6", "0 1 0", curve),
        "translation1": ("q6", "1 0 0", bend),
        "translation2": ("q6", "0.6 0.8 0", curve),
        "translation3": ("", "0 0 1", "<Constant><value>0.05</value></Constant>"),
    }
    for parent, child in (("/bodyset/a", "/bodyset/b"), ("/bodyset/b", "/bodyset/a")):
        custom = joint("CustomJoint", "q6", parent=parent, child=child, rest=transform(axes))
        checked(tmp_path, osim(joint("FreeJoint", *SIX), custom, bodies="ab"), rng)


def test_bodies_without_mass_get_a_little_and_it_is_said(tmp_path: Path) -> None:
    """A massless body between two joints keeps the fit's matrices invertible; welded ones are one body."""
    middle = joint("PinJoint", "q6", parent="/bodyset/a", child="/bodyset/b")
    outer = joint("PinJoint", "q7", parent="/bodyset/b", child="/bodyset/c").replace("PinJoint_c", "outer")
    weld = joint("WeldJoint", parent="/bodyset/c", child="/bodyset/d")
    text = osim(joint("FreeJoint", *SIX), middle, outer, weld, bodies="abcd")
    a, b, rest = text.partition('<Body name="b"><mass>2</mass>')
    (tmp_path / "a.osim").write_text(a + b.replace("2", "0", 1) + rest)
    made, notes = read_osim_model(tmp_path / "a.osim")
    assert float(made.inertia.mean[made.tree.index("b"), 0]) == pytest.approx(LEAST_MASS)
    assert len(made.tree.bodies) == 3
    assert {"osim.massless", "osim.welded"} <= {note.code for note in notes}


def _config(folder: Path, markers: str) -> Path:
    """A config of ``a.osim`` in a folder, with an empty recording."""
    (folder / "a.trc").write_text("")
    trials = [{"name": "a", "file": "a.trc"}]
    settings = {"subject": {"name": "a"}, "model": "a.osim", "markers": markers, "trials": trials}
    (folder / "a.yaml").write_text(yaml.safe_dump(settings))
    return folder / "a.yaml"


def test_what_a_run_does_not_use_is_said(tmp_path: Path) -> None:
    """Locked coordinates and another gravity are named; without markers in the file there is no ``markers: model``."""
    text = osim(joint("FreeJoint", *SIX), joint("PinJoint", "q6", parent="/bodyset/a", child="/bodyset/b"), bodies="ab")
    locked = '<Coordinate name="q6"><locked>true</locked>'
    moon = '<Ground name="ground"/><gravity>0 -1.62 0</gravity>'
    text = text.replace('<Coordinate name="q6">', locked).replace('<Ground name="ground"/>', moon)
    (tmp_path / "a.osim").write_text(text)
    made, notes = read_osim_model(tmp_path / "a.osim")
    assert {"osim.locked", "osim.gravity"} <= {note.code for note in notes}
    assert made.tree.dof_names[6:] == ()
    with pytest.raises(ConfigError, match=r"markers\.own"):
        setup_of(load_config(_config(tmp_path, "model")))


def test_marker_sets_may_name_any_body_of_the_file(tmp_path: Path) -> None:
    """A body that is welded to another stands for it in a marker set of the user's own."""
    weld = joint("WeldJoint", parent="/bodyset/a", child="/bodyset/b")
    (tmp_path / "a.osim").write_text(osim(joint("FreeJoint", *SIX), weld, bodies="ab"))
    (tmp_path / "m.yaml").write_text("M1: b\nM2: a\n")
    setup = setup_of(load_config(_config(tmp_path, "m.yaml")))
    model, markers = setup.model, setup.markers
    assert {spec.segment for spec in markers.specs.values()} == set(model.tree.names)


@pytest.mark.data
def test_bodies_without_markers_go_on_following(data_dir: Path, seed: int) -> None:
    """Kneecaps that no marker shows stay on their knees; toes that no marker shows stay at rest."""
    made, _ = read_osim_model(_path(FUNCTION_KNEES, data_dir))
    held, notes = lock_bodies(made, ("patella_r", "toes_r"))
    assert set(made.tree.dof_names) - set(held.tree.dof_names) == {"mtp_angle_r"}
    assert "mtp_angle_r" in notes[0].message and "knee_angle_r" not in notes[0].message
    assert made.osim is not None
    q, v, a = drawn_state(made.osim.model, np.random.default_rng(seed))
    q[:, made.osim.model.coordinate_names.index("mtp_angle_r")] = 0.0
    before, after = (
        chain_poses(
            one.tree, made.osim.to_tree(one.tree.dof_names, q, v, a)[0], one.geometry.geometry(one.geometry.mean)
        )
        for one in (made, held)
    )
    assert_close(before, after, rtol=0, atol=1e-12)


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.usefixtures("no_report")
def test_a_body_of_functions_is_recovered_by_a_run(data_dir: Path) -> None:
    """Somebody whose knees and kneecaps follow functions, on two plates: masses and joint centres within their
    deviations, and the written model means the same body in OpenSim's words."""
    _path(FUNCTION_KNEES, data_dir)
    folder, truth, outcome = identified()
    assert outcome.identified is not None and outcome.fit.uncertainty is not None
    tree = outcome.fit.model.tree
    assert tree.names == truth.model.tree.names
    named = len(outcome.fit.prior.mean)
    sd = outcome.fit.uncertainty.sd[:named]
    rows = [truth.model.geometry.names.index(name) for name in outcome.fit.prior.names]
    true = (truth.geometry.offset.reshape(-1)[3:])[rows]
    wrong = (outcome.fit.xi[:named] - true) / sd
    assert float(wrong.square().mean().sqrt()) < 2.0, wrong
    mass = outcome.phi[:, 0] - truth.phi[:, 0]
    known = outcome.identified.fit.sd.mass
    assert float((mass / known).square().mean().sqrt()) < 3.0, mass / known
    unused = [item.wrench for name, item in outcome.followed.items() if name == "heldout" and item.wrench is not None]
    after, before = residual_rms(unused, outcome.phi), residual_rms(unused, outcome.prior.mean)
    # The noise of markers alone leaves 10 N and 4 N m: what the template has less of cannot be halved.
    assert after[0] * after[1] < 0.6 * before[0] * before[1] and after[0] < 1.1 * before[0], (after, before)
    written, notes = read_osim(folder / "out" / "model.osim")
    _, read, binding = tree_of_osim(written)
    assert_close(read.offset, outcome.fit.geometry.offset, rtol=0, atol=1e-9)
    # A body that the fit leaves thinner than a reader takes is given that extent by it, and the reader says so.
    thin = any(note.code == "osim.inertia" for note in notes)
    given = 2.0 * LEAST_EXTENT**2 * outcome.phi[:, :1] * thin
    off = (of_groups(binding, written.inertias.phi) - outcome.phi).abs()
    assert bool((off <= 1e-6 * outcome.phi.abs() + given + 1e-9).all()), (off, notes)
