"""Base regressor and normal equations against Pinocchio's full regressor in a Python loop."""

import time
from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin
import roma
import torch
from torch import Tensor

from benchmarks.row_sums import base_gram
from benchmarks.subject import by_turns
from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import (
    BodyRows,
    base_rows,
    body_rows,
    dynamic_state,
    inertial_columns,
    walk,
)
from torchid.kinematics.plan import Plan, plan_tree
from torchid.kinematics.tables import Joints, make_joints
from torchid.model.model import Geometry, Model
from torchid.model.tree import Tree
from torchid.model.whole_body import whole_body

CHUNK, FUSED, LOOP = 1024, 384, 200
"""Frames per call: eager, compiled (whose intermediates are few), and of Pinocchio's loop."""
STREAM = 8
"""Calls in a row: a recording is a stream of chunks."""
JOINTS = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)


def bench_regressor(rounds: int, compiled: bool) -> dict[str, object]:
    """Microseconds per frame of both, kinematics included, and the largest difference of any entry."""
    model = whole_body(1.75, 70.0, "male")
    tree, geometry, plan = model.tree, _straight(model), plan_tree(model.tree)
    q, v, a = _motion(tree, CHUNK, np.random.default_rng(1))
    twin, joints = composite_twin(tree, geometry)
    data, states = twin.createData(), [_state(twin, tree, joints, q[:, t], v[:, t], a[:, t]) for t in range(LOOP)]
    short = [x[:, :FUSED].contiguous() for x in (q, v, a)]
    fused = fused_rows(plan, make_joints(plan, geometry)) if compiled else None

    def eager(q: Tensor, v: Tensor, a: Tensor) -> BodyRows:
        return body_rows(dynamic_state(tree, geometry, q, v, a))

    def peer() -> None:
        for state in states:
            pin.computeJointTorqueRegressor(twin, data, *state)

    def stream(call: Callable[[], object], calls: int) -> Callable[[], object]:
        return lambda: [call() for _ in range(calls)]

    runs = {
        "pinocchio": peer,
        "eager": stream(lambda: eager(q, v, a), STREAM),
        "eager_scattered": stream(lambda: base_rows(plan, eager(q, v, a)), STREAM),
    }
    if fused:
        state = walk(plan, make_joints(plan, geometry), *short)
        known = state.at.R, state.at.p, state.motion.w, state.motion.alpha, state.motion.a
        columns = torch.compile(inertial_columns, dynamic=False, fullgraph=True)
        runs["compiled"] = stream(lambda: fused(*short), STREAM)
        runs["compiled_without_kinematics"] = stream(lambda: columns(*known), STREAM)
    chunk = {name: FUSED if name.startswith("compiled") else CHUNK for name in runs}
    frames = {name: STREAM * frames for name, frames in chunk.items()} | {"pinocchio": LOOP}
    out: dict[str, object] = {f"{k}_us": t / frames[k] * 1e6 for k, t in by_turns(runs, rounds).items()}
    Y = base_rows(plan, eager(q, v, a))
    out["difference"] = max(_difference(twin, data, tree, joints, state, Y[:, :, t]) for t, state in enumerate(states))
    out["normal_equations_100k_s"] = _normal_equations(plan, eager, CHUNK, rounds)
    if fused:
        out["normal_equations_100k_compiled_s"] = _normal_equations(plan, fused, FUSED, rounds)
        out["compiled_difference"] = _relative(base_rows(plan, fused(*short)), Y[:, :, :FUSED])
    return out


def fused_rows(plan: Plan, axes: Joints) -> Callable[[Tensor, Tensor, Tensor], BodyRows]:
    """The base rows of a fixed number of frames, fused by the compiler."""
    return torch.compile(lambda q, v, a: body_rows(walk(plan, axes, q, v, a)), dynamic=False, fullgraph=True)


def _relative(a: Tensor, b: Tensor) -> float:
    return float((a - b).abs().max() / b.abs().max())


def _normal_equations(plan: Plan, rows: Callable[..., BodyRows], chunk: int, rounds: int) -> float:
    """CPU seconds from the motion of 100 000 frames to the sums; the last chunk is cut behind the last frame."""
    frames, tree = 100_000, plan.tree
    padded = -(-frames // chunk) * chunk
    q, v, a = (x.repeat(1, -(-padded // CHUNK))[:, :padded] for x in _motion(tree, CHUNK, np.random.default_rng(2)))
    wrench = torch.zeros(6, padded, dtype=q.dtype)

    def stream() -> Iterator[tuple[BodyRows, Tensor]]:
        for first in range(0, padded, chunk):
            found = rows(*(x[:, first : first + chunk].contiguous() for x in (q, v, a)))
            if first + chunk > frames:
                found = BodyRows(*(x[..., : frames - first].contiguous() for x in found))
            yield found, wrench[:, first : min(frames, first + chunk)]

    spent = []
    for _ in range(rounds):
        start = time.process_time()
        base_gram(plan, stream())
        spent.append(time.process_time() - start)
    return sorted(spent)[len(spent) // 2]


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
