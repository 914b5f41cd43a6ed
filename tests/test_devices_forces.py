"""What a device does to the body: virtual work, MuJoCo's tendons and springs, laws."""

import sys
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest
import roma
import torch
from device_cases import filled, made, person, random_motion, with_parts

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from mujoco_laboratory.device import inverse, worn

from torchid.devices import Device, device_forces, told_of
from torchid.devices.action import action
from torchid.devices.forces import states
from torchid.dynamics.equations_of_motion import inverse_dynamics
from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.motion import Motion

CLOSE = 1e-8
CABLE = {"type": "cable", "name": "cable", "between": ["thorax", "thigh_l"], "from_m": [-0.1, 0, 0.2],
         "to_m": [-0.05, 0, -0.2], "via": [{"segment": "pelvis", "point_m": [-0.15, 0.1, 0]}]}  # fmt: skip
HIP = {"type": "spring", "name": "hip", "between": ["pelvis", "thigh_r"], "coordinate": "hip_r_flexion"}
KNEE = {"type": "spring", "name": "knee", "between": ["thigh_l", "shank_l"], "axis": [0, 1, 0]}
LIFT = {"type": "ground", "name": "lift", "between": ["pelvis", "world"], "from_m": [0, 0, 0.1], "to_m": [0.2, 0, 2.6]}


@pytest.fixture
def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def worn_device() -> Device:
    """Springs, a cable over a pulley, and a part."""
    return made(
        parts=[{"segment": "pelvis", "mass_kg": 2, "com_m": [-0.1, 0, 0.1], "inertia_kgm2": [0.01, 0.02, 0.015]}],
        elements=[
            {**HIP, "stiffness_Nm_rad": 120, "rest_rad": 0.1},
            {**CABLE, "stiffness_N_m": 500, "rest_m": 0.7},
            {"type": "spring", "name": "calf", "between": ["shank_l", "foot_l"], "from_m": [-0.05, 0, -0.1],
             "to_m": [-0.05, 0, -0.03], "stiffness_N_m": 800, "rest_m": 0.2, "damping_Ns_m": 20},
        ],
    )  # fmt: skip


def test_forces_are_mujocos(rng: np.random.Generator) -> None:
    """Tendons, joint springs and the part of a device, and what is left to the person."""
    model, tree, geometry = person()
    device, motion = worn_device(), random_motion(rng, tree)
    mine = device_forces(device, tree, geometry, motion)
    q, v, a = (x.numpy() for x in (motion.q, motion.v, motion.a))
    own = worn(tree, geometry, model.inertia.mean.numpy(), device)
    truth = inverse(own, q, v, a, {}, {})
    scale = np.abs(truth.device).max()
    assert np.abs(truth.device - mine.torque.numpy()).max() < CLOSE * scale
    assert 0 < int((mine.elements["cable"].force > 0).sum()) < len(q), "the cable is slack in some postures"
    phi = with_parts(model.inertia.mean, tree, device)
    needed = inverse_dynamics(tree, geometry, phi, motion.q.T, motion.v.T, motion.a.T).T
    human = (needed - mine.torque)[:, 6:].numpy()
    assert np.abs(human - truth.human[:, 6:]).max() < CLOSE * np.abs(human).max()


def moved(motion: Motion, step: float) -> torch.Tensor:
    """Coordinates after a small step along the rates."""
    q = motion.q + step * motion.v
    R = roma.rotvec_to_rotmat(step * motion.v[:, 3:6]) @ roma.rotvec_to_rotmat(motion.q[:, 3:6])
    q[:, 3:6] = roma.rotmat_to_rotvec(R)
    return q


@pytest.mark.parametrize("element", [{**CABLE, "stiffness_N_m": 1}, {**HIP, "stiffness_Nm_rad": 1},
                                     {**LIFT, "force_N": 1}, {**LIFT, "rail": [1, 0, 0], "force_N": 1}])  # fmt: skip
def test_a_force_does_the_work_of_its_length(element: dict, rng: np.random.Generator) -> None:
    """J v is the rate of the length, by central differences; the generalised force is -J times the tension."""
    _, tree, geometry = person()
    one, motion, h = made(elements=[element]).elements[0], random_motion(rng, tree), 1e-6
    ends = []
    for step in (h, -h):
        q = moved(motion, step)
        state = states(tree, geometry, Motion(motion.time, q, motion.v, motion.a, motion.smoother), slice(None))
        ends.append(action(one, state, q.T).length)
    act = action(one, states(tree, geometry, motion, slice(None)), motion.q.T)
    torch.testing.assert_close(act.rate(motion.v.T), (ends[0] - ends[1]) / (2.0 * h), atol=1e-7, rtol=1e-7)
    sense = 1.0 if one.turns else -1.0
    torch.testing.assert_close(act.unit, sense * act.jacobian)


def test_power_is_torque_times_rate(rng: np.random.Generator) -> None:
    """Over all elements inside the body; and no part of them is left in the rows of the base."""
    _, tree, geometry = person()
    device = made(elements=[{**CABLE, "stiffness_N_m": 500, "rest_m": 0.5}, {**HIP, "stiffness_Nm_rad": 80},
                            {**KNEE, "stiffness_Nm_rad": 40, "damping_Nms_rad": 2}])  # fmt: skip
    motion = random_motion(rng, tree)
    found = device_forces(device, tree, geometry, motion)
    torch.testing.assert_close(found.power, (found.torque * motion.v).sum(1))
    assert not found.external
    assert float(found.torque[:, :6].abs().max()) < 1e-12 * float(found.torque.abs().max())


def test_an_axis_turns_as_a_hinge_does(rng: np.random.Generator) -> None:
    """Where the hinge's own axis is the joint's, its angle is the coordinate and its torque the coordinate's."""
    _, tree, geometry = person()
    motion = random_motion(rng, tree)
    straight = geometry.hinge.clone()
    straight[[tree.hinges.index(name) for name in tree.hinges if name.startswith("knee_l")]] = 0.0
    geometry = type(geometry)(geometry.offset, straight)
    device = made(elements=[{**KNEE, "stiffness_Nm_rad": 40, "rest_rad": 0.2}])
    row = tree.dof_names.index("knee_l_flexion")
    found = device_forces(device, tree, geometry, motion)
    torch.testing.assert_close(found.elements["knee"].length, motion.q[:, row])
    torch.testing.assert_close(found.torque[:, row], -40.0 * (motion.q[:, row] - 0.2))


def test_a_cable_pulls_and_never_pushes() -> None:
    """max(0, k (l - l0)) exactly; free play, preload and a table as they are defined."""
    _, tree, geometry = person()
    q = torch.zeros(5, len(tree.dofs), dtype=torch.float64)
    q[:, tree.dof_names.index("knee_l_flexion")] = torch.linspace(-0.3, 0.3, 5, dtype=torch.float64)
    zero = torch.zeros_like(q)
    motion = random_motion(np.random.default_rng(0), tree, 5)
    motion = Motion(motion.time, q, zero, zero, motion.smoother)
    knee = {"type": "spring", "between": ["thigh_l", "shank_l"], "coordinate": "knee_l_flexion", "name": "knee"}
    x = q[:, tree.dof_names.index("knee_l_flexion")]

    def torque(**law: object) -> torch.Tensor:
        return device_forces(made(elements=[{**knee, **law}]), tree, geometry, motion).elements["knee"].force

    torch.testing.assert_close(torque(stiffness_Nm_rad=10, tension_only=True), -(10.0 * x).clamp_min(0.0))
    play = torch.sign(x) * (x.abs() - 0.1).clamp_min(0.0)
    torch.testing.assert_close(torque(stiffness_Nm_rad=10, free_play_rad=0.1, preload_Nm=2), -(10.0 * play + 2.0))
    table = torque(table=[[-0.3, -6.0], [0.0, 0.0], [0.3, 3.0]])
    torch.testing.assert_close(table, -torch.where(x < 0.0, 20.0 * x, 10.0 * x))


def test_profiles_and_channels_drive(rng: np.random.Generator) -> None:
    """Gain times what was commanded, late by the lag, over time, phase and angle."""
    _, tree, geometry = person()
    motion = random_motion(rng, tree, 50)
    base = {"type": "torque", "name": "ankle", "between": ["shank_l", "foot_l"], "coordinate": "ankle_l_flexion"}
    row = tree.dof_names.index("ankle_l_flexion")
    wanted = torch.sin(2.0 * torch.pi * motion.time)
    late = made(elements=[{**base, "channel": "wish", "gain": 2, "lag_s": 0.05}])
    found = device_forces(late, tree, geometry, motion, {"wish": wanted}).torque[:, row]
    torch.testing.assert_close(found[5:], 2.0 * wanted[:-5])
    table = [[0, 0], [0.5, -20], [1, 0]]
    over = made(elements=[{**base, "profile": {"over": "phase", "table": table}}])
    phase = torch.linspace(0.0, 1.0, 50, dtype=torch.float64)
    found = device_forces(over, tree, geometry, motion, {"phase": phase}).torque[:, row]
    torch.testing.assert_close(found, -40.0 * torch.minimum(phase, 1.0 - phase))
    by_angle = made(elements=[{**base, "profile": {"over": "angle", "table": [[-2, -2], [2, 2]]}}])
    found = device_forces(by_angle, tree, geometry, motion).torque[:, row]
    torch.testing.assert_close(found, motion.q[:, row].clamp(-2.0, 2.0))


def test_a_sensor_is_believed_where_it_reads(rng: np.random.Generator) -> None:
    """An element carries what its own sensor reads, and what its law says in frames without a reading."""
    _, tree, geometry = person()
    motion = random_motion(rng, tree, 50)
    row = tree.dof_names.index("hip_r_flexion")
    sheet = {**HIP, "stiffness_Nm_rad": 120, "sensor": {"torque": "read"}}
    law = device_forces(made(elements=[sheet]), tree, geometry, motion).torque[:, row]
    read = torch.as_tensor(rng.normal(size=50))
    lost = torch.as_tensor(rng.random(50) < 0.3)
    recorded = {"read": torch.where(lost, torch.nan, read)}
    found = device_forces(made(elements=[sheet]), tree, geometry, motion, recorded).torque[:, row]
    torch.testing.assert_close(found[~lost], read[~lost])
    torch.testing.assert_close(found[lost], law[lost])


def test_what_a_sensor_reads_needs_no_number(rng: np.random.Generator) -> None:
    """An element without a stiffness stays where its sensor reads in every trial; nobody knows the others."""
    _, tree, geometry = person()
    motion = random_motion(rng, tree, 20)
    device = made(elements=[{**HIP, "stiffness_Nm_rad": "unknown", "sensor": {"torque": "read"}}])
    read = torch.as_tensor(rng.normal(size=20))
    kept = told_of(device, [{"read": read}])
    found = device_forces(kept, tree, geometry, motion, {"read": read})
    torch.testing.assert_close(found.elements["hip"].force, read)
    silent = read.clone()
    silent[3] = torch.nan
    for trials in ([], [{"read": read}, {}], [{"read": read}, {"read": silent}]):
        assert not told_of(device, trials).elements
    with pytest.raises(ConfigError, match="device.unknown"):
        device_forces(device, tree, geometry, motion, {"read": silent})


@pytest.mark.parametrize("zero", [0.0, torch.nan])
def test_a_dead_sensor_is_not_believed(zero: float, rng: np.random.Generator) -> None:
    """One that reads zero or nothing throughout: the law counts, and without numbers nobody knows the element."""
    _, tree, geometry = person()
    motion = random_motion(rng, tree, 20)
    sheet, dead = {**HIP, "stiffness_Nm_rad": 120, "sensor": {"torque": "read"}}, torch.full_like(motion.time, zero)
    law, found = (device_forces(made(elements=[sheet]), tree, geometry, motion, x) for x in ({}, {"read": dead}))
    torch.testing.assert_close(found.torque, law.torque)
    assert float(law.torque.abs().max()) > 1.0
    assert not told_of(made(elements=[{**sheet, "stiffness_Nm_rad": "unknown"}]), [{"read": dead}]).elements


def test_a_few_lost_samples_are_lost_alone(rng: np.random.Generator) -> None:
    """Of a command, a handle and a sensor, filters do not carry a gap into other frames; what drives and is read as
    well is read."""
    _, tree, geometry = person()
    motion = replace(random_motion(rng, tree, 60), smoother=Smoother(6.0, 100.0))
    motor = {"type": "torque", "name": "ankle", "between": ["shank_l", "foot_l"], "coordinate": "ankle_l_flexion",
             "channel": "wish"}  # fmt: skip
    hand = {"type": "ground", "name": "hand", "between": ["hand_l", "world"], "from_m": [0, 0, -0.05],
            "channels": ["wish", "wish", "wish"]}  # fmt: skip
    both = {**motor, "name": "both", "channel": "read", "gain": 3, "sensor": {"torque": "read"}}
    wish = torch.sin(2.0 * torch.pi * motion.time) + 2.0
    lost = torch.zeros(60, dtype=torch.bool)
    lost[20:23] = True
    device = made(elements=[motor, hand, both])
    found = device_forces(device, tree, geometry, motion, dict.fromkeys(("wish", "read"), wish.masked_fill(lost, nan)))
    for values in (found.elements["ankle"].force, found.external["hand_l"][:, 2], found.elements["both"].force):
        assert torch.equal(torch.isnan(values), lost)
        torch.testing.assert_close(values[~lost], wish[~lost], atol=0.05, rtol=0.0)


def test_supports_are_external(rng: np.random.Generator) -> None:
    """A constant lift under a rail pulls up with its force, a handle with what was recorded; neither is in torque."""
    _, tree, geometry = person()
    motion = random_motion(rng, tree, size=0.1)
    hand = {"type": "ground", "name": "hand", "between": ["hand_l", "world"], "from_m": [0, 0, -0.05],
            "channels": ["x", "y", "z"]}  # fmt: skip
    device = made(elements=[{**LIFT, "to_m": [0, 0, 50.0], "rail": [1, 0, 0], "force_N": 120}, hand])
    recorded = {name: torch.full_like(motion.time, value) for name, value in zip("xyz", (1.0, 2.0, -30.0), strict=True)}
    found = device_forces(device, tree, geometry, motion, recorded)
    assert float(found.torque.abs().max()) == 0.0
    assert float((found.external["pelvis"][:, :3].norm(dim=1) - 120.0).abs().max()) < 1e-9
    assert float(found.external["pelvis"][:, 0].abs().max()) < 1e-9, "nothing along the rail"
    torch.testing.assert_close(found.external["hand_l"][0, :3], torch.tensor([1.0, 2.0, -30.0], dtype=torch.float64))


@pytest.mark.parametrize("code, element, recorded", [
    ("device.unknown", {**HIP, "stiffness_Nm_rad": "unknown"}, {}),
    ("device.coordinate", {**HIP, "coordinate": "hip", "stiffness_Nm_rad": 3}, {}),
    ("device.segment", {**CABLE, "between": ["thorax", "thigh"], "stiffness_N_m": 3}, {}),
    ("device.channel", {"type": "torque", "between": ["shank_l", "foot_l"], "coordinate": "ankle_l_flexion",
                        "channel": "wish"}, {}),
])  # fmt: skip
def test_what_is_missing_is_said(code: str, element: dict, recorded: dict) -> None:
    """Nothing is put in place of a number, a name or a channel."""
    _, tree, geometry = person()
    motion = random_motion(np.random.default_rng(1), tree, 4)
    with pytest.raises(ConfigError) as caught:
        device_forces(made(elements=[element]), tree, geometry, motion, recorded)
    assert caught.value.code == code


def test_numbers_are_filled() -> None:
    """By element and parameter."""
    device = filled(made(elements=[{**HIP, "stiffness_Nm_rad": "unknown"}]), hip={"stiffness": 12.0})
    assert device.elements[0].unknown == () and device.unknown == ()
