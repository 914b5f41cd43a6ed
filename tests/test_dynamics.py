"""Kinematics and equations of motion against Pinocchio on random trees."""

import numpy as np
import pytest
import roma
import torch
from benchmarks.row_sums import base_gram
from torch.testing import assert_close
from trees import coupled_tree, mjcf_of, pinocchio_state, pinocchio_twin, random_inertia, random_motion, random_tree

from torchid.dynamics.equations_of_motion import base_rows, body_rows, dynamic_state, inverse_dynamics

pin = pytest.importorskip("pinocchio")
FRAMES = 3


@pytest.mark.parametrize("case", range(6))
def test_joint_and_base_rows_equal_pinocchio(case: int, seed: int) -> None:
    """Inverse dynamics and the base rows of the regressor equal Pinocchio's on any tree."""
    rng = np.random.default_rng([seed, case])
    tree, geometry = random_tree(rng)
    phi = random_inertia(rng, len(tree.bodies))
    q, v, a = (x.T.contiguous() for x in random_motion(rng, tree, FRAMES))
    tau = inverse_dynamics(tree, geometry, phi, q, v, a)
    state = dynamic_state(tree, geometry, q, v, a)
    predicted = torch.einsum("ipt,p->it", base_rows(state.plan, body_rows(state)), phi.reshape(-1))
    assert_close(predicted, tau[:6], rtol=1e-10, atol=1e-9)
    twin = pinocchio_twin(tree, geometry, phi)
    for t in range(FRAMES):
        assert_close(tau[:, t], _pinocchio_rnea(twin, tree, q[:, t], v[:, t], a[:, t]), rtol=1e-10, atol=1e-9)


def _pinocchio_rnea(twin, tree, q, v, a) -> torch.Tensor:
    Q, V, A = pinocchio_state(twin, tree, q, v, a)
    data = twin.createData()
    tau = pin.rnea(twin, data, Q, V, A)
    R_WB = pin.Quaternion(Q[3:7]).matrix()
    out = [*(R_WB @ tau[:3]), *(R_WB @ tau[3:6])]
    out += [tau[twin.joints[twin.getJointId(f"q{k}")].idx_v] for k in range(6, len(tree.dofs))]
    return torch.tensor(np.array(out))


@pytest.mark.parametrize("case", range(4))
def test_forces_of_leading_coordinates_bear_those_of_followers(case: int, seed: int) -> None:
    """Where functions drive joints, forces are Pinocchio's by the principle of virtual work, base rows are the same."""
    rng = np.random.default_rng([seed, case])
    tree, geometry = random_tree(rng)
    tree, phi = coupled_tree(rng, tree), random_inertia(rng, len(tree.bodies))
    q, v, a = (x.T.contiguous() for x in random_motion(rng, tree, FRAMES))
    tau = inverse_dynamics(tree, geometry, phi, q, v, a)
    (sv, sa), s = tree.rates(q, v, a), tree.axes(q)
    twin = pinocchio_twin(tree.uncoupled, geometry, phi)
    theirs = [_pinocchio_rnea(twin, tree.uncoupled, s[:, t], sv[:, t], sa[:, t]) for t in range(FRAMES)]
    expected = torch.stack(theirs, dim=1)
    assert_close(tau, tree.fold(q, expected), rtol=1e-9, atol=1e-9)
    assert_close(tau[:6], expected[:6], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("case", range(4))
def test_forces_equal_mujocos(case: int, seed: int) -> None:
    """Inverse dynamics of any tree equals that of MuJoCo."""
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng([seed, case])
    tree, geometry = random_tree(rng)
    phi = random_inertia(rng, len(tree.bodies))
    q, v, a = (x.T.contiguous() for x in random_motion(rng, tree, FRAMES))
    tau = inverse_dynamics(tree, geometry, phi, q, v, a)
    model = mujoco.MjModel.from_xml_string(mjcf_of(tree, geometry, phi))
    data = mujoco.MjData(model)
    for t in range(FRAMES):
        expected = _mujoco_inverse(mujoco, model, data, tree, q[:, t], v[:, t], a[:, t])
        assert_close(tau[:, t], expected, rtol=1e-8, atol=1e-8 * float(expected.abs().max()))


def _mujoco_inverse(mujoco, model, data, tree, q, v, a) -> torch.Tensor:
    """MuJoCo's forces in our order; its free joint has rates and torques of turning in the body's axes."""
    R_WB = roma.rotvec_to_rotmat(q[3:6])
    data.qpos[:3], data.qpos[3:7] = q[:3], np.roll(roma.rotvec_to_unitquat(q[3:6]).numpy(), 1)
    data.qvel[:6], data.qacc[:6] = (np.concatenate([x[:3], R_WB.T @ x[3:6]]) for x in (v, a))
    rows = [model.joint(dof.name).dofadr[0] for dof in tree.dofs[6:]]
    data.qpos[[row + 1 for row in rows]], data.qvel[rows], data.qacc[rows] = q[6:], v[6:], a[6:]
    mujoco.mj_inverse(model, data)
    found = torch.tensor(data.qfrc_inverse.copy())
    return torch.cat([found[:3], R_WB @ found[3:6], found[rows]])


def test_sums_of_a_stream_equal_the_rows(seed):
    """Normal equations without the base rows are those of the rows, whatever the chunks and the order of the bodies."""
    rng = np.random.default_rng(seed)
    tree, geometry = random_tree(rng, bodies=7)
    q, v, a = (x.T.contiguous() for x in random_motion(rng, tree, 40))
    wrench = torch.tensor(rng.normal(size=(6, 40)))
    state = dynamic_state(tree, geometry, q, v, a)
    Y = base_rows(state.plan, body_rows(state))
    parts = [slice(0, 17), slice(17, 40)]
    stream = ((body_rows(dynamic_state(tree, geometry, q[:, p], v[:, p], a[:, p])), wrench[:, p]) for p in parts)
    gram, rhs = base_gram(state.plan, stream)
    assert_close(gram, torch.einsum("ipt,iqt->pq", Y, Y), rtol=0, atol=1e-12 * float(gram.abs().max()))
    assert_close(rhs, torch.einsum("ipt,it->p", Y, wrench), rtol=0, atol=1e-12 * float(rhs.abs().max()))
