"""Model files: what is written means the same to Pinocchio, MuJoCo and OpenSim, and what is read is what it says."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.testing import assert_close
from trees import pinocchio_state, random_inertia, random_motion, random_tree

from torchid.conventions import Inertial
from torchid.dynamics.equations_of_motion import inverse_dynamics
from torchid.errors import ConfigError, DataError, InputError
from torchid.kinematics.chain import chain_points, chain_poses
from torchid.model.assembly import ModelLink, assemble
from torchid.model.files import load_model
from torchid.model.markup import MAX_BYTES
from torchid.model.mechanics import axis_rotation, matrix_to_rpy, rpy_to_matrix
from torchid.model.mjcf_words import WORDS
from torchid.model.model import Geometry, Model
from torchid.model.osim import osim_coordinates, osim_names, write_osim
from torchid.model.tree import BASE_DOFS, Tree
from torchid.model.tree_of_links import FileScatter
from torchid.model.urdf import write_urdf
from torchid.model.whole_body import whole_body

TIGHT = {"rtol": 1e-9, "atol": 1e-9}


def _subject(rng: np.random.Generator, case: int) -> tuple[Tree, Geometry, torch.Tensor]:
    """The whole body with random geometry for case 0, random trees for the others."""
    if case:
        tree, geometry = random_tree(rng)
        phi = random_inertia(rng, len(tree.bodies))
        phi[:, [Inertial.IXX, Inertial.IYY, Inertial.IZZ]] += 2e-4 * phi[:, :1]  # no thinner than 1 cm
        return tree, geometry, phi
    model = whole_body(1.75, 70.0)
    xi = model.geometry.mean + model.geometry.sd * torch.tensor(rng.normal(size=len(model.geometry.mean)))
    return model.tree, model.geometry.geometry(xi), model.inertia.mean


def _markers(rng: np.random.Generator, tree: Tree) -> dict[str, tuple[str, list[float]]]:
    return {f"M{k}": (name, rng.normal(size=3).tolist()) for k, name in enumerate(tree.names)}


def _read(path: Path) -> tuple[Model, Geometry]:
    model, _ = load_model(path)
    return model, model.geometry.geometry(model.geometry.mean)


def _renamed(tree: Tree, other: Tree, *values: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Rows of ``other``'s coordinates taken from ``tree``'s by name; the base's by order."""
    rows = [*range(BASE_DOFS), *(tree.dof_names.index(name) for name in other.dof_names[BASE_DOFS:])]
    return tuple(value[:, rows] for value in values)


@pytest.mark.parametrize("case", range(4))
def test_urdf_reads_back_as_written(case: int, seed: int, tmp_path: Path) -> None:
    """Poses, markers and inverse dynamics survive writing and reading; limits, names and inertia too."""
    rng = np.random.default_rng([seed, case])
    tree, geometry, phi = _subject(rng, case)
    markers = _markers(rng, tree)
    write_urdf(tree, geometry, phi, tmp_path / "a.urdf", markers)
    model, again = _read(tmp_path / "a.urdf")
    motion = random_motion(rng, tree, 3)
    moved = _renamed(tree, model.tree, *motion)
    kept = [tree.index(name) for name in model.tree.names]
    assert_close(chain_poses(model.tree, moved[0], again), chain_poses(tree, motion[0], geometry)[:, kept], **TIGHT)
    tau = inverse_dynamics(model.tree, again, model.inertia.mean, *(x.T.contiguous() for x in moved))
    expected = inverse_dynamics(tree, geometry, phi, *(x.T.contiguous() for x in motion))
    assert_close(tau.T, *_renamed(tree, model.tree, expected.T), **TIGHT)
    labels = list(markers)
    body = torch.tensor([model.tree.index(model.landmarks[label].segment) for label in labels])
    place = torch.tensor([model.landmarks[label].p_BM_B for label in labels], dtype=torch.float64)
    assert_close(chain_points(model.tree, moved[0], again, body, place), _points(tree, geometry, motion[0], markers))
    for dof in model.tree.dofs[BASE_DOFS:]:
        twin = tree.dofs[tree.dof_names.index(dof.name)]
        assert (dof.lower, dof.upper, dof.unit) == (twin.lower, twin.upper, twin.unit)


def _points(tree: Tree, geometry: Geometry, q: torch.Tensor, markers: dict) -> torch.Tensor:
    body = torch.tensor([tree.index(segment) for segment, _ in markers.values()])
    return chain_points(tree, q, geometry, body, torch.tensor([p for _, p in markers.values()], dtype=torch.float64))


def test_written_whole_body_keeps_its_shape(seed: int, tmp_path: Path) -> None:
    """Read back, the whole body has the same segments, coordinates, offsets and hinge count."""
    tree, geometry, phi = _subject(np.random.default_rng(seed), 0)
    write_urdf(tree, geometry, phi, tmp_path / "a.urdf")
    model, again = _read(tmp_path / "a.urdf")
    order = [model.tree.index(name) for name in tree.names]
    assert sorted(model.tree.names) == sorted(tree.names) and sorted(model.tree.dof_names) == sorted(tree.dof_names)
    assert_close(again.offset[order], geometry.offset, rtol=0, atol=1e-15)
    assert_close(model.inertia.mean[order], phi, rtol=1e-12, atol=1e-12)
    assert len(model.tree.hinges) == len(tree.hinges)


@pytest.mark.parametrize("case", range(3))
def test_urdf_means_the_same_to_pinocchio(case: int, seed: int, tmp_path: Path) -> None:
    """Pinocchio's poses and inverse dynamics of the written file are ours."""
    pin = pytest.importorskip("pinocchio")
    rng = np.random.default_rng([seed, case])
    tree, geometry, phi = _subject(rng, case)
    write_urdf(tree, geometry, phi, tmp_path / "a.urdf")
    twin = pin.buildModelFromUrdf(str(tmp_path / "a.urdf"), pin.JointModelFreeFlyer())
    twin.gravity.linear = np.array([0.0, 0.0, -9.80665])
    data = twin.createData()
    motion = random_motion(rng, tree, 2)
    expected = inverse_dynamics(tree, geometry, phi, *(x.T.contiguous() for x in motion))
    X = chain_poses(tree, motion[0], geometry)
    for t in range(2):
        Q, V, A, rows = _pinocchio_state(pin, twin, tree, *(x[t] for x in motion))
        tau = pin.rnea(twin, data, Q, V, A)
        R_WB = pin.Quaternion(Q[3:7]).matrix()
        found = np.array([*(R_WB @ tau[:3]), *(R_WB @ tau[3:6]), *tau[rows]])
        assert_close(torch.tensor(found), expected[:, t], **TIGHT)
        pin.framesForwardKinematics(twin, data, Q)
        for k, name in enumerate(tree.names):
            assert_close(torch.tensor(data.oMf[twin.getFrameId(name)].homogeneous), X[t, k], **TIGHT)


def _pinocchio_state(pin, twin, tree: Tree, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor):
    """State of the twin; unlimited turns are points of a circle there."""
    Q, V, A = pin.neutral(twin), np.zeros(twin.nv), np.zeros(twin.nv)
    base = Tree(tree.bodies[:1], tree.dofs[:BASE_DOFS])
    Q[:7], V[:6], A[:6] = (x[:n] for x, n in zip(pinocchio_state(twin, base, q, v, a), (7, 6, 6), strict=True))
    rows = []
    for k, name in enumerate(tree.dof_names[BASE_DOFS:], start=BASE_DOFS):
        joint = twin.joints[twin.getJointId(name)]
        Q[joint.idx_q : joint.idx_q + joint.nq] = q[k] if joint.nq == 1 else [np.cos(float(q[k])), np.sin(float(q[k]))]
        V[joint.idx_v], A[joint.idx_v] = v[k], a[k]
        rows.append(joint.idx_v)
    return Q, V, A, rows


def _opensim_subject(rng: np.random.Generator, case: int) -> tuple[Tree, Geometry, torch.Tensor]:
    """Trees whose joints do not turn twice about one axis: OpenSim's have three different ones."""
    while True:
        tree, geometry, phi = _subject(rng, case)
        axes = [[turn.axis for turn in body.turns if turn.moving] for body in tree.bodies]
        if all(len(set(row)) == len(row) for row in axes):
            return tree, geometry, phi


@pytest.mark.parametrize("case", range(4))
def test_osim_means_the_same_to_opensim(case: int, seed: int, tmp_path: Path) -> None:
    """OpenSim's marker places and inverse dynamics of the written file are ours."""
    opensim = pytest.importorskip("opensim")
    rng = np.random.default_rng([seed, case])
    tree, geometry, phi = _opensim_subject(rng, case)
    markers = _markers(rng, tree)
    write_osim(tree, geometry, phi, tmp_path / "a.osim", markers)
    opensim.Logger.setLevelString("Error")
    twin = opensim.Model(str(tmp_path / "a.osim"))
    state = twin.initSystem()
    motion = random_motion(rng, tree, 1)
    forces = inverse_dynamics(tree, geometry, phi, *(x.T.contiguous() for x in motion))[:, 0]
    E = _angles(*motion)[3]
    names = osim_names(tree)
    coordinates = [twin.getCoordinateSet().get(name) for name in names]
    assert twin.getNumCoordinates() == len(names)
    rows = [_row(coordinate, state) for coordinate in coordinates]
    udot = opensim.Vector(len(names), 0.0)
    for row, coordinate, *values in zip(rows, coordinates, *_angles(*motion)[:3], strict=True):
        coordinate.setValue(state, float(values[0]), False)
        coordinate.setSpeedValue(state, float(values[1]))
        udot.set(row, float(values[2]))
    twin.realizeVelocity(state)
    places = _points(tree, geometry, motion[0], markers)[0]
    for label, place in zip(markers, places, strict=True):
        x, y, z = (twin.getMarkerSet().get(label).getLocationInGround(state).get(k) for k in range(3))
        assert_close(torch.tensor([x, -z, y], dtype=torch.float64), place, rtol=0, atol=1e-9)
    tau = opensim.InverseDynamicsSolver(twin).solve(state, udot)
    found = torch.tensor([tau.get(row) for row in rows], dtype=torch.float64)
    expected = torch.cat([forces[:3], E.T @ forces[3:6], forces[6:]])
    assert_close(found, expected, rtol=1e-8, atol=1e-7)


def _row(coordinate, state) -> int:
    """Place of a coordinate in OpenSim's vector of speeds."""
    coordinate.setSpeedValue(state, 1.0)
    row = int(np.argmax(state.getU().to_numpy()))
    coordinate.setSpeedValue(state, 0.0)
    return row


def _angles(q: torch.Tensor, v: torch.Tensor, a: torch.Tensor):
    """One frame of our base coordinates in OpenSim's, with w = E(angles) rates."""
    values = osim_coordinates(q)[0]

    def matrix(angles: torch.Tensor) -> torch.Tensor:
        """Columns: the axes of tilt, list and rotation in W (OpenSim's Z, X, Y are our -Y, X, Z)."""
        tilt, sideways = -angles[0], angles[1]
        one, zero = torch.ones_like(tilt), torch.zeros_like(tilt)
        listed = torch.stack([tilt.cos(), zero, -tilt.sin()])
        turned = torch.stack([tilt.sin() * sideways.cos(), -sideways.sin(), tilt.cos() * sideways.cos()])
        return torch.stack([torch.stack([zero, -one, zero]), listed, turned], dim=1)

    E = matrix(values[3:6])
    rates = torch.linalg.solve(E, v[0, 3:6])
    _, Edot = torch.func.jvp(matrix, (values[3:6],), (rates,))
    accelerations = torch.linalg.solve(E, a[0, 3:6] - Edot @ rates)
    full = torch.cat([v[0, :3], rates, v[0, 6:]]), torch.cat([a[0, :3], accelerations, a[0, 6:]])
    return values, *full, E


def test_osim_base_angles_give_the_same_rotation(seed: int) -> None:
    """Tilt, list and rotation composed about OpenSim's Z, X, Y are the base's rotation, and do not jump."""
    rng = np.random.default_rng(seed)
    t = torch.linspace(0, 1, 400, dtype=torch.float64)[:, None]
    axis = torch.tensor([0.1, -0.2, 1.0], dtype=torch.float64)
    q = torch.cat([torch.tensor(rng.normal(size=(400, 3))), 9.0 * t * axis / axis.norm()], dim=1)
    found = osim_coordinates(q)[:, 3:].numpy()
    to_osim = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    R = to_osim @ Rotation.from_rotvec(q[:, 3:].numpy()).as_matrix() @ to_osim.T
    np.testing.assert_allclose(Rotation.from_euler("ZXY", found).as_matrix(), R, atol=1e-12)
    assert np.abs(np.diff(found, axis=0)).max() < 0.2


def test_osim_refuses_two_turns_about_one_line(seed: int, tmp_path: Path) -> None:
    """A joint that OpenSim has no form for is an error with the joint's name, and no file is left."""
    rng = np.random.default_rng(seed)
    while True:
        tree, geometry, phi = _subject(rng, 1)
        axes = [[turn.axis for turn in body.turns if turn.moving] for body in tree.bodies]
        if any(row[:1] == row[1:2] and row for row in axes):
            break
    with pytest.raises(DataError, match="osim.joint"):
        write_osim(tree, geometry, phi, tmp_path / "a.osim")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("roll_pitch_yaw", [(0.3, np.pi / 2, -1.0), (0.3, -np.pi / 2, 2.0), (3.0, 1.0, -3.0)])
def test_rpy_survives_gimbal_lock(roll_pitch_yaw: tuple[float, float, float]) -> None:
    """Roll, pitch, yaw give back the same rotation, also where they are not unique."""
    R = rpy_to_matrix(*roll_pitch_yaw)
    np.testing.assert_allclose(R, Rotation.from_euler("xyz", roll_pitch_yaw).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rpy_to_matrix(*matrix_to_rpy(R)), R, atol=1e-14)
    np.testing.assert_allclose(axis_rotation(1, 0.4), Rotation.from_euler("y", 0.4).as_matrix(), atol=1e-15)


MJCF = """<mujoco>
  <compiler angle="{angle}" eulerseq="{sequence}"/>
  <default>
    <joint damping="1"/>
    <geom density="1100"/>
    <default class="arm"><joint axis="0 1 0" range="-30 60"/><geom type="capsule" size="0.04 0.1"/>
      <default class="wrist"><joint axis="1 1 0.3"/></default></default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="trunk" pos="0.1 0.2 1.1" quat="0.9 0.1 -0.3 0.2"><freejoint/>
      <geom type="box" size="0.1 0.15 0.2" pos="0 0 0.1" euler="{euler}"/>
      <geom type="ellipsoid" size="0.05 0.1 0.07" fromto="0 0 0.3 0.1 0 0.6"/>
      <site name="chest" pos="0.1 0 0.2"/>
      <body name="shoulder" pos="0 0.2 0.3" axisangle="1 2 3 {turn}">
        <inertial pos="0.01 0.02 -0.1" quat="0.7 0.2 0.1 0.3" mass="2" diaginertia="0.02 0.015 0.01"/>
        <joint name="s1" axis="0 1 0" pos="0.03 0.01 0"/><joint name="s2" axis="1 0 0" pos="0.03 0.01 0"/>
        <joint name="s3" axis="0.2 0.1 -1" pos="0.03 0.01 0"/>
        <body name="forearm" pos="0 0 -0.3" zaxis="0.1 0.2 -1" childclass="arm">
          <joint name="elbow" pos="0 0 0.02"/><geom pos="0 0 0.1" xyaxes="1 0.2 0 0 1 0.1"/>
          <geom name="watch" type="cylinder" size="0.03 0.01" mass="0.2" pos="0 0.03 0.2"/>
          <body name="cuff" pos="0 0 0.15"><geom type="sphere" size="0.05"/>
            <site name="cuff_marker" pos="0 0.05 0"/></body>
          <body name="hand" pos="0 0 0.25" quat="0 1 0 0"><joint name="wrist" class="wrist"/>
            <geom type="capsule" fromto="0 0 0 0.05 0 -0.1" size="0.03"/></body>
        </body>
      </body>
      <body name="slider" pos="0 -0.2 0.3"><joint name="rail" type="slide" axis="0 0.6 -0.8" range="-0.1 0.2"/>
        <joint name="swivel" axis="0 0 -1"/>
        <inertial pos="0 0 0.1" mass="1.5" fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/></body>
    </body>
  </worldbody>
</mujoco>"""


@pytest.mark.parametrize(("angle", "sequence"), [("degree", "xyz"), ("radian", "ZYX"), ("radian", "xZx")])
def test_mjcf_means_what_mujoco_reads(angle: str, sequence: str, seed: int, tmp_path: Path) -> None:
    """Sites and inverse dynamics of the model read are those of MuJoCo, for random states."""
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(seed)
    unit = 180.0 / np.pi if angle == "degree" else 1.0
    euler = " ".join(str(x) for x in rng.normal(size=3) * unit)
    path = tmp_path / "a.xml"
    path.write_text(MJCF.format(angle=angle, sequence=sequence, euler=euler, turn=0.7 * unit))
    model, geometry = _read(path)
    tree, phi = model.tree, model.inertia.mean
    theirs = mujoco.MjModel.from_xml_path(str(path))
    theirs.opt.gravity[:] = 0.0, 0.0, -9.80665
    theirs.dof_damping[:] = 0.0
    theirs.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(theirs)
    q, v, a = random_motion(rng, tree, 1)
    R_WB = Rotation.from_rotvec(q[0, 3:6].numpy())
    data.qpos[:3], data.qpos[3:7] = q[0, :3], R_WB.as_quat()[[3, 0, 1, 2]]
    data.qvel[:3], data.qvel[3:6] = v[0, :3], R_WB.inv().apply(v[0, 3:6].numpy())
    data.qacc[:3], data.qacc[3:6] = a[0, :3], R_WB.inv().apply(a[0, 3:6].numpy())
    joints = [theirs.joint(name) for name in tree.dof_names[6:]]
    rows = [int(joint.dofadr[0]) for joint in joints]
    data.qpos[[int(joint.qposadr[0]) for joint in joints]] = q[0, 6:]
    data.qvel[rows], data.qacc[rows] = v[0, 6:], a[0, 6:]
    mujoco.mj_inverse(theirs, data)
    marks = {name: (mark.segment, list(mark.p_BM_B)) for name, mark in model.landmarks.items()}
    places = np.array([data.site(name).xpos for name in marks])
    assert_close(_points(tree, geometry, q, marks)[0], torch.tensor(places), **TIGHT)
    tau = inverse_dynamics(tree, geometry, phi, *(x.T.contiguous() for x in (q, v, a)))[:, 0]
    moment = R_WB.apply(data.qfrc_inverse[3:6])
    found = np.array([*data.qfrc_inverse[:3], *moment, *data.qfrc_inverse[rows]])
    assert_close(torch.tensor(found), tau, rtol=1e-9, atol=1e-8)
    limits = {dof.name: (dof.lower, dof.upper) for dof in tree.dofs[6:]}
    for name, joint in zip(tree.dof_names[6:], joints, strict=True):
        if theirs.jnt_limited[joint.id]:
            np.testing.assert_allclose(limits[name], joint.range, atol=1e-12)
        else:
            assert limits[name] == (-np.inf, np.inf)


def test_a_capsule_too_thin_for_a_volume_is_a_rod(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    geom = '<geom type="capsule" fromto="0 0 0 0 0 0.4" size="1e-320" mass="0.3"/>'
    path.write_text(f'<mujoco><worldbody><body name="a"><freejoint/>{geom}</body></worldbody></mujoco>')
    phi = _read(path)[0].inertia.mean[0]
    assert_close(phi, phi.new_tensor([0.3, 0.0, 0.0, 0.06, 0.016, 0.0, 0.016, 0.0, 0.0, 0.0]), rtol=0.0, atol=1e-6)


LINK = '<inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.01"/></inertial>'
POINT = LINK.replace("0.02", "0").replace("0.01", "0")
JOINT = '<joint name="j" type="{}"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>{}</joint>'


def _urdf(*parts: str, a: str = LINK, b: str = LINK) -> str:
    return f'<robot name="r">\n<link name="a">{a}</link>\n<link name="b">{b}</link>\n' + "\n".join(parts) + "</robot>"


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("xml.syntax", "<robot"),
        ("xml.root", "<sdf/>"),
        ("xml.doctype", '<!DOCTYPE robot [<!ENTITY a "b">]><robot name="&a;"/>'),
        ("xml.doctype", '<!DOCTYPE robot SYSTEM "http://localhost/x.dtd"><robot/>'),
        ("urdf.name", '<robot name="r"><link/></robot>'),
        ("urdf.xacro", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro/></robot>'),
        ("model.root", "<robot/>"),
        ("model.root", _urdf()),
        ("model.name_twice", _urdf('<link name="a"/>')),
        ("model.loop", _urdf(JOINT.format("revolute", ""), JOINT.format("fixed", ""))),
        ("urdf.mimic", _urdf(JOINT.format("revolute", '<mimic joint="x"/>'))),
        ("urdf.joint", _urdf(JOINT.format("planar", ""))),
        ("urdf.joint", _urdf(JOINT.format("floating", ""))),
        ("urdf.link", _urdf('<joint name="j" type="fixed"><parent link="a"/><child link="c"/></joint>')),
        ("urdf.limit", _urdf(JOINT.format("revolute", '<limit lower="1" upper="0"/>'))),
        ("urdf.inertial", _urdf(JOINT.format("revolute", ""), b='<inertial><mass value="2"/></inertial>')),
        ("urdf.axis", _urdf(JOINT.format("revolute", "").replace("0 1 0", "0 0 0"))),
        ("xml.number", _urdf(JOINT.format("revolute", "").replace("0 1 0", "0 nan 0"))),
        ("xml.number", _urdf(JOINT.format("revolute", '<origin xyz="1 2"/>'))),
        ("model.massless", _urdf(JOINT.format("revolute", ""), b="")),
        ("model.massless", _urdf(JOINT.format("revolute", ""), b=POINT.replace('"2"', '"0"'))),
        ("model.mass", _urdf(JOINT.format("revolute", ""), b=LINK.replace('"2"', '"-2"'))),
        ("model.inertia", _urdf(JOINT.format("revolute", ""), b=LINK.replace("0.01", "0.05"))),
        ("model.inertia", _urdf(JOINT.format("revolute", ""), b=LINK.replace("0.01", "-0.01"))),
    ],
)  # fmt: skip
def test_bad_urdf_is_refused(code: str, text: str, tmp_path: Path) -> None:
    """Every fault of a URDF is an error that names the file."""
    (tmp_path / "bad.urdf").write_text(text)
    with pytest.raises(InputError) as caught:
        load_model(tmp_path / "bad.urdf")
    assert caught.value.code == code and caught.value.source.endswith("bad.urdf") and caught.value.remedy


def test_a_link_that_stands_twice_is_named_with_both_lines(tmp_path: Path) -> None:
    """Both places are told, so that one of them can be renamed."""
    (tmp_path / "bad.urdf").write_text(
        '<robot name="r">\n<link name="a"/>\n<link name="b"/>\n<link name="a"/>\n</robot>'
    )
    with pytest.raises(InputError, match=r"line 4, <link name='a'>.*found: a, also in line 2.*model\.name_twice"):
        load_model(tmp_path / "bad.urdf")


def test_an_outer_default_without_a_name_is_everybodys(tmp_path: Path) -> None:
    """An empty name of the outermost class means the same as none, as it does to MuJoCo."""
    masses = []
    for name in ("", 'class=""', 'class="main"'):
        text = _mjcf('<body><joint/><geom size="0.1"/></body>', f'<default {name}><geom density="500"/></default>')
        (tmp_path / "a.xml").write_text(text)
        masses.append(load_model(tmp_path / "a.xml")[0].inertia.mean[:, 0])
    assert float(masses[0][0]) == pytest.approx(500 * 4 / 3 * np.pi * 1e-3)
    torch.testing.assert_close(masses[1], masses[0], rtol=0, atol=0)
    torch.testing.assert_close(masses[2], masses[0], rtol=0, atol=0)


def _mjcf(inside: str, before: str = "", root: str = "<freejoint/>") -> str:
    shape = '<geom size="0.1"/>'
    return f'<mujoco>{before}<worldbody><body name="a">{root}{shape}{inside}</body></worldbody></mujoco>'


HIPS = (
    '<body name="b"><joint type="{}" name="{}"/><geom size="1"/>'
    '<body name="c"><joint name="{}"/><geom size="1"/></body></body>'
)


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("mjcf.root", "<mujoco/>"),
        ("mjcf.unsupported", _mjcf("", '<include file="/etc/passwd"/>')),
        ("mjcf.unsupported", _mjcf("<frame/>")),
        ("mjcf.equality", _mjcf("", '<equality><weld body1="a"/></equality>')),
        ("mjcf.up", _mjcf("", '<option gravity="0 -9.81 0"/>')),
        ("mjcf.compiler", _mjcf("", '<compiler settotalmass="70"/>')),
        ("mjcf.default", _mjcf("", '<default><default><geom density="1"/></default></default>')),
        ("mjcf.class", _mjcf('<body><joint class="x"/></body>')),
        ("mjcf.class", _mjcf('<body><joint class=""/></body>')),
        ("mjcf.class", _mjcf('<body childclass=""><joint/></body>')),
        ("mjcf.shape", _mjcf('<body><joint/><geom type="mesh" mesh="m"/></body>')),
        ("mjcf.size", _mjcf('<body><joint/><geom type="box" size="1 1"/></body>')),
        ("mjcf.fromto", _mjcf('<body><joint/><geom type="capsule" size="1" fromto="0 0 1 0 0 1"/></body>')),
        ("mjcf.ref", _mjcf('<body><joint ref="1"/><geom size="1"/></body>')),
        ("mjcf.free", _mjcf('<body><freejoint/><geom size="1"/></body>')),
        ("mjcf.joint", _mjcf('<body><joint type="screw"/><geom size="1"/></body>')),
        ("mjcf.axis", _mjcf('<body><joint axis="0 0 0"/><geom size="1"/></body>')),
        ("mjcf.range", _mjcf('<body><joint range="30 -60"/><geom size="1"/></body>')),
        ("mjcf.anchor", _mjcf('<body><joint/><joint pos="0 0 1" axis="1 0 0"/><geom size="1"/></body>')),
        ("mjcf.orientation", _mjcf('<body quat="0 0 0 0"><geom size="1"/></body>')),
        ("mjcf.eulerseq", _mjcf('<body euler="0 0 1"><geom size="1"/></body>', '<compiler eulerseq="xyw"/>')),
        ("model.name_twice", _mjcf('<body name="a"><joint/><geom size="1"/></body>')),
        ("model.name_twice", _mjcf(HIPS.format("ball", "hip", "hip_x"))),
        ("model.slide_after_turn", _mjcf('<body><joint/><joint type="slide"/><geom size="1"/></body>')),
        ("model.slides", _mjcf('<body><joint type="slide"/><joint type="slide" axis="0 1 1"/><geom size="1"/></body>')),
        ("model.massless", _mjcf("<body><joint/></body>")),
        ("model.inertia", _mjcf('<body><joint/><inertial mass="1" pos="0 0 0" diaginertia="1 1 9"/></body>')),
    ],
)
def test_bad_mjcf_is_refused(code: str, text: str, tmp_path: Path) -> None:
    """Every fault of an MJCF is an error that names the file."""
    (tmp_path / "bad.xml").write_text(text)
    with pytest.raises(InputError) as caught:
        load_model(tmp_path / "bad.xml")
    assert caught.value.code == code and caught.value.source.endswith("bad.xml") and caught.value.remedy


def test_mjcf_root_without_free_joint_floats_and_says_so(tmp_path: Path) -> None:
    """A planar root becomes a floating one; a ball becomes three turns; armature is left out: each has its note."""
    inside = '<body name="b"><joint name="hip" type="ball" armature="0.1"/><geom size="0.1"/></body>'
    (tmp_path / "a.xml").write_text(_mjcf(inside, root='<joint type="slide" axis="1 0 0"/>'))
    model, notes = load_model(tmp_path / "a.xml")
    assert model.tree.dof_names[6:] == ("hip_x", "hip_y", "hip_z")
    assert {note.code for note in notes} == {"mjcf.base_floats", "mjcf.ball", "mjcf.armature"}


def test_thin_bodies_are_thickened_and_said(tmp_path: Path) -> None:
    """A point mass gets a millimetre, a note and a prior that can be inverted."""
    (tmp_path / "a.urdf").write_text(_urdf(JOINT.format("revolute", ""), b=POINT))
    model, notes = load_model(tmp_path / "a.urdf")
    assert "model.thin" in {note.code for note in notes}
    torch.linalg.cholesky(model.inertia.covariance)


def test_scatter_of_file_models(seed: int, tmp_path: Path) -> None:
    """The prior's covariance is positive definite, a mass scatters as asked, and zero fixes the geometry."""
    tree, geometry, phi = _subject(np.random.default_rng(seed), 1)
    write_urdf(tree, geometry, phi, tmp_path / "a.urdf")
    model, _ = load_model(tmp_path / "a.urdf", FileScatter(offset=0.0, mass=0.3))
    torch.linalg.cholesky(model.inertia.covariance)
    sd = model.inertia.covariance.diagonal().sqrt().reshape(-1, 10)
    assert_close(sd[:, Inertial.M], 0.3 * model.inertia.mean[:, Inertial.M])
    assert model.geometry.names == () and model.geometry.map.shape == (len(model.geometry.constant), 0)


def test_odd_marker_labels_become_plain_and_stay_apart(seed: int, tmp_path: Path) -> None:
    """Labels with odd characters, or those of a segment, are written under plain, different names."""
    tree, geometry, phi = _subject(np.random.default_rng(seed), 1)
    labels = ("a b", "a/b", "b0", "\x00é", "")
    write_urdf(tree, geometry, phi, tmp_path / "a.urdf", {label: ("b0", [0.0, 0.0, 0.1]) for label in labels})
    model, _ = load_model(tmp_path / "a.urdf")
    assert len(model.landmarks) == len(labels)


def test_bodies_without_mass_are_not_written(seed: int, tmp_path: Path) -> None:
    """An inertia without positive mass is refused by both writers."""
    tree, geometry, phi = _opensim_subject(np.random.default_rng(seed), 1)
    phi[1] = 0.0
    for write in (write_urdf, write_osim):
        with pytest.raises(DataError, match="model.massless"):
            write(tree, geometry, phi, tmp_path / "a")


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    """No file, a folder and a file larger than any model end before anything is parsed."""
    (tmp_path / "folder.xml").mkdir()
    with (tmp_path / "large.urdf").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    names = {"none.urdf": "xml.unreadable", "folder.xml": "xml.unreadable", "large.urdf": "xml.too_large"}
    for name, code in names.items():
        with pytest.raises(InputError) as caught:
            load_model(tmp_path / name)
        assert (caught.value.code, caught.value.source) == (code, str(tmp_path / name)) and caught.value.remedy


def test_a_link_whose_parent_is_not_there_is_refused() -> None:
    """A reader's links are checked where they are put together: the link is named by its place in the file."""
    links = [ModelLink("a", None, np.eye(4)), ModelLink("b", "c", np.eye(4), place="line 7, <body name='b'>")]
    with pytest.raises(InputError, match=r"a\.xml, line 7.*found: c\).*model\.parent"):
        assemble(links, "a.xml", {}, FileScatter())


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    """A suffix without reader is an error that says what there is."""
    with pytest.raises(ConfigError, match=r"found: \.sdf.*\.urdf.*model\.suffix"):
        load_model(tmp_path / "a.sdf")


@pytest.mark.parametrize(
    ("suffix", "text", "said"),
    [
        (".urdf", _urdf(JOINT.format("revolute", "")).replace("axis xyz", "axis xzy"), "<axis> xzy: not known"),
        (".urdf", _urdf(JOINT.format("revolute", "<lmit/>")), "<lmit>: not known"),
        (".urdf", _urdf(JOINT.format("revolute", '<axis xyz="0 0 1"/>')), "<axis>: only the first"),
        (".xml", _mjcf("", '<compilr angle="radian"/>'), "<compilr>: not known"),
        (".xml", _mjcf('<body><joint axes="0 0 1"/><geom size="1"/></body>'), "<joint> axes: not known"),
        (".xml", _mjcf("", '<default><gaom density="1"/></default>'), "<gaom>: not known"),
    ],
)
def test_names_that_the_format_lacks_are_said(suffix: str, text: str, said: str, tmp_path: Path) -> None:
    """A misspelt element or attribute is not read as if it were absent, without a word; neither is a second one."""
    (tmp_path / f"a{suffix}").write_text(text)
    _, notes = load_model(tmp_path / f"a{suffix}")
    assert any(said in note.message for note in notes if note.code in ("model.unread", "model.twice"))


def test_sound_models_have_no_strange_names(tmp_path: Path, seed: int) -> None:
    """Neither what torchid writes nor a model with everything that is read."""
    tree, geometry, phi = _subject(np.random.default_rng(seed), 0)
    write_urdf(tree, geometry, phi, tmp_path / "a.urdf", {"toe": (tree.names[-1], [0.0, 0.0, 0.1])})
    (tmp_path / "a.xml").write_text(MJCF.format(angle="radian", sequence="xyz", euler="0 0 1", turn=0.7))
    for name in ("a.urdf", "a.xml"):
        assert not {note.code for note in load_model(tmp_path / name)[1]} & {"model.unread", "model.twice"}


def test_the_words_of_mjcf_are_those_of_mujoco() -> None:
    """MuJoCo's own schema lists every element and attribute of the table, below the elements that are looked at."""
    schema = pytest.importorskip("mujoco").mj_printSchema(False, False)
    known = set(re.findall(r"[A-Za-z_0-9]+", schema))
    own = {word.rstrip("*") for pair in WORDS.values() for text in pair for word in text.split()}
    assert own - known == {"include", "frame", "replicate", "composite", "worldbody"} - known


def test_next_to_no_mass_is_none(tmp_path: Path) -> None:
    """A mass whose quotients overflow is refused as none."""
    inside = '<body><joint/><inertial pos="0 0 0" mass="1e-320" diaginertia="1 1 1"/></body>'
    (tmp_path / "a.xml").write_text(_mjcf(inside))
    with pytest.raises(InputError, match=r"model\.massless"):
        load_model(tmp_path / "a.xml")
