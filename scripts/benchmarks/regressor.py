"""Base regressor and normal equations against Pinocchio's full regressor in a Python loop."""

import time

import numpy as np
import pinocchio as pin
import roma
import torch
from torch import Tensor

from benchmarks.subject import by_turns
from torchid.conventions import GRAVITY
from torchid.dynamics import BodyRows, base_gram, base_rows, body_rows, dynamic_state, walk
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.tables import make_joints
from torchid.model.model import Geometry, Model
from torchid.model.tree import Tree
from torchid.model.whole_body import whole_body

CHUNK, LOOP = 1024, 200
JOINTS = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)


def bench_regressor(rounds: int, compiled: bool) -> dict[str, object]:
    """Microseconds per frame of both, kinematics included, and the largest difference of any entry."""
    model = whole_body(1.75, 70.0, "male")
    tree, geometry = model.tree, _straight(model)
    q, v, a = _motion(tree, CHUNK, np.random.default_rng(1))
    twin, joints = composite_twin(tree, geometry)
    data, states = twin.createData(), [_state(twin, tree, joints, q[:, t], v[:, t], a[:, t]) for t in range(LOOP)]

    def eager() -> BodyRows:
        return body_rows(dynamic_state(tree, geometry, q, v, a))

    def peer() -> None:
        for state in states:
            pin.computeJointTorqueRegressor(twin, data, *state)

    runs = {"pinocchio": peer, "eager": eager, "eager_scattered": lambda: base_rows(plan_tree(tree), eager())}
    if compiled:
        plan = plan_tree(tree)
        axes = make_joints(plan, geometry)
        fused = torch.compile(lambda q, v, a: body_rows(walk(plan, axes, q, v, a)), dynamic=False, fullgraph=True)
        fused(q, v, a)
        runs["compiled"] = lambda: fused(q, v, a)
    times = by_turns(runs, rounds)
    out: dict[str, object] = {f"{k}_us": t / (LOOP if k == "pinocchio" else CHUNK) * 1e6 for k, t in times.items()}
    Y = base_rows(plan_tree(tree), eager())
    out["difference"] = max(_difference(twin, data, tree, joints, state, Y[:, :, t]) for t, state in enumerate(states))
    return out | _normal_equations(tree, geometry, rounds)


def _normal_equations(tree: Tree, geometry: Geometry, rounds: int) -> dict[str, object]:
    frames, plan = 100_000, plan_tree(tree)
    q, v, a = (x.repeat(1, -(-frames // CHUNK))[:, :frames] for x in _motion(tree, CHUNK, np.random.default_rng(2)))
    wrench = torch.zeros(6, frames, dtype=q.dtype)
    spent = []
    for _ in range(rounds):
        start, gram = time.process_time(), 0.0
        for first in range(0, frames, CHUNK):
            part = slice(first, first + CHUNK)
            state = dynamic_state(tree, geometry, q[:, part], v[:, part], a[:, part])
            gram = gram + base_gram(plan, body_rows(state), wrench[:, part])[0]
        spent.append(time.process_time() - start)
    return {"normal_equations_100k_s": sorted(spent)[len(spent) // 2]}


def _straight(model: Model) -> Geometry:
    """Hinge axes without lean: Pinocchio's fastest joints."""
    geometry = model.geometry.geometry(model.geometry.mean)
    return Geometry(geometry.offset, torch.zeros_like(geometry.hinge))


def _motion(tree: Tree, frames: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    q, v, a = (torch.tensor(rng.normal(size=(len(tree.dofs), frames))) for _ in range(3))
    return 0.3 * q, v, a


def composite_twin(tree: Tree, geometry: Geometry) -> tuple[pin.Model, list[int]]:
    """One composite joint per segment, and its number for each body."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    joints = [model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), tree.names[0])]
    for k, body in enumerate(tree.bodies[1:], start=1):
        joint = pin.JointModelComposite()
        for turn in body.turns:
            if turn.moving:
                joint.addJoint(JOINTS[turn.axis](), pin.SE3.Identity())
        place = pin.SE3(np.eye(3), geometry.offset[k].numpy())
        joints.append(model.addJoint(joints[body.parent], joint, place, body.name))
    return model, joints


def _state(model: pin.Model, tree: Tree, joints: list[int], q: Tensor, v: Tensor, a: Tensor) -> tuple[np.ndarray, ...]:
    Q, V, A = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    R_WB = roma.rotvec_to_rotmat(q[3:6]).numpy()
    Q[:3], Q[3:7] = q[:3], pin.Quaternion(R_WB).coeffs()
    V[:3], V[3:6] = R_WB.T @ v[:3].numpy(), R_WB.T @ v[3:6].numpy()
    A[:3] = R_WB.T @ a[:3].numpy() - np.cross(V[3:6], V[:3])
    A[3:6] = R_WB.T @ a[3:6].numpy()
    for body, joint in zip(tree.bodies, joints, strict=True):
        at = model.joints[joint]
        for k, turn in enumerate(turn for turn in body.turns if turn.moving):
            Q[at.idx_q + k], V[at.idx_v + k], A[at.idx_v + k] = (turn.sign * x[turn.row] for x in (q, v, a))
    return Q, V, A


def _difference(
    model: pin.Model, data: pin.Data, tree: Tree, joints: list[int], state: tuple[np.ndarray, ...], Y: Tensor
) -> float:
    """Largest difference of an entry of the base rows, relative to the largest entry."""
    R_WB = pin.Quaternion(state[0][3:7]).matrix()
    full = pin.computeJointTorqueRegressor(model, data, *state)[:6]
    turned = np.concatenate([R_WB @ full[:3], R_WB @ full[3:]])
    order = np.concatenate([np.arange(10 * (joint - 1), 10 * joint) for joint in joints])
    return float(np.abs(turned[:, order] - Y.numpy()).max() / np.abs(turned).max())
