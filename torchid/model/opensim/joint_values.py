"""Values of a joint's coordinates that bring what it carries to a given pose, or as near as the joint lets it."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.coupling import pushed
from torchid.model.opensim.functions import Function
from torchid.model.opensim.model import CoordinateKind, OsimJoint, OsimModel
from torchid.model.opensim.posing import body_poses, joint_pose
from torchid.model.opensim.rotations import inverse
from torchid.model.rotation import rotation_vector
from torchid.model.tree import BASE_DOFS

SQUARE = 1e-9
"""Resolution. Largest product of two of a joint's unit axes that stand at right angles."""
STEPS, SETTLED = 50, 1e-12
"""Resolution. Most Gauss-Newton steps to the pose nearest to a given one, and the step that is none [rad, m]."""


def with_pose(
    model: OsimModel, joint: OsimJoint, step: Float[Tensor, "frames 4 4"], q: Float[Tensor, "frames coordinates"]
) -> Float[Tensor, "frames coordinates"]:
    """Return coordinates in which those of a joint make a pose, without jumps of angles.

    Where the joint leaves less than six freedoms the pose is the nearest: by squares of the turn between the two [rad]
    and of the way [m].

    Args:
        step: pose of the joint's carried frame in its carrier's.
        q: all coordinates of the file [rad, m].
    """
    if is_floating(joint):
        rows = torch.tensor(joint.rows)
        return q.index_copy(1, rows, _floating_values(joint, step if joint.outward else inverse(step)))
    rows = list(joint.rows)
    for _ in range(STEPS if rows else 0):
        X = _carried(joint, q)
        turn = rotation_vector(step[:, :3, :3] @ X[:, :3, :3].mT)
        miss = torch.cat([step[:, :3, 3] - X[:, :3, 3], turn], dim=1)
        columns = twists(lambda x: _carried(joint, x), q, rows)
        change = torch.linalg.lstsq(columns, miss[..., None], driver="gelsd").solution[..., 0]
        q = q.index_add(1, torch.tensor(rows), change)
        if float(change.abs().max()) < SETTLED:
            break
    turns = [row for row in rows if model.coordinates[row].motion is CoordinateKind.ROTATIONAL]
    return q.index_copy(1, torch.tensor(turns, dtype=torch.long), _unwrapped(q[:, turns]))


def closed(model: OsimModel, q: Float[Tensor, "frames coordinates"]) -> Float[Tensor, "frames coordinates"]:
    """Return coordinates in which those of joints that close loops fit the bodies, as near as the joints let them.

    Args:
        q: all coordinates of the file [rad, m], couplers obeyed.
    """
    if not model.closing:
        return q
    X_GB = torch.cat([body_poses(model, q), torch.eye(4).to(q).expand(len(q), 1, 4, 4)], dim=1)  # GROUND is the last
    for joint in model.closing:
        parent, child = (X_GB[:, frame.body] @ frame.X_BF.to(q) for frame in (joint.parent, joint.child))
        q = with_pose(model, joint, inverse(parent) @ child, q)
    return q


def _carried(joint: OsimJoint, q: Float[Tensor, "frames coordinates"]) -> Float[Tensor, "frames 4 4"]:
    X = joint_pose(joint, q)
    return X if joint.outward else inverse(X)


def twists(
    pose_of: Callable[[Tensor], Tensor], q: Float[Tensor, "frames coordinates"], rows: Sequence[int]
) -> Float[Tensor, "frames 6 rows"]:
    """Return velocity of the origin and angular velocity of a pose, at unit rates of coordinates.

    Args:
        pose_of: poses (frames, 4, 4) of coordinates.
        q: all coordinates [rad, m].
        rows: the coordinates that move.
    """
    X, columns = pose_of(q), [q.new_zeros(len(q), 6, 0)]
    for row in rows:
        seed = torch.zeros_like(q)
        seed[:, row] = 1.0
        rate = pushed(pose_of, (q,), (seed,))[1]
        twist = torch.cat([rate[:, :3, 3], vee(rate[:, :3, :3] @ X[:, :3, :3].mT)], dim=1)
        columns.append(twist[..., None])
    return torch.cat(columns, dim=2)


def is_floating(joint: OsimJoint) -> bool:
    """Return whether a joint leaves all six freedoms: turns about and slides along three axes at right angles, each led
    by a coordinate of its own that moves nothing else."""
    axes = (*joint.turns, *joint.slides)
    led = sorted(row for axis in axes for row in axis.rows)
    if led != sorted(joint.rows) or len(joint.turns) != 3 or len(joint.slides) != 3:
        return False
    units = [torch.stack([axis.unit for axis in kind]) for kind in (joint.turns, joint.slides)]
    square = all(float((unit @ unit.T - torch.eye(3).to(unit)).abs().max()) <= SQUARE for unit in units)
    return square and all(affine(axis.function) is not None for axis in axes)


def affine(function: Function) -> tuple[float, float] | None:
    """Return slope and intercept of a function of one coordinate; None where it is not straight."""
    if function.n_arguments != 1:
        return None
    low, start, high = (float(function(torch.tensor([x], dtype=torch.float64))) for x in (-7.3, 0.0, 7.3))
    slope = (high - start) / 7.3
    straight = abs(high + low - 2.0 * start) <= 1e-12 * max(abs(high), abs(low), 1.0)
    return (slope, start) if straight and slope != 0.0 else None


def _floating_values(joint: OsimJoint, X: Float[Tensor, "frames 4 4"]) -> Float[Tensor, "frames 6"]:
    """Values of a floating joint's coordinates at poses X of its child in its parent, without jumps of angles."""
    axis = torch.stack([turn.unit for turn in joint.turns]).to(X)
    R = X[:, :3, :3]
    # R = Rot(u1, a1) Rot(u2, a2) Rot(u3, a3) of axes at right angles: u1' R u3 tells a2, rows and columns the others.
    hand = torch.linalg.det(axis)
    inner = axis @ R @ axis.T  # (i, k): u_i' R u_k
    second = hand * inner[:, 0, 2].clamp(-1.0, 1.0).asin()
    first = torch.atan2(-hand * inner[:, 1, 2], inner[:, 2, 2])
    third = torch.atan2(-hand * inner[:, 0, 1], inner[:, 0, 0])
    angles = _unwrapped(torch.stack([first, second, third], dim=1))
    along = torch.stack([slide.unit for slide in joint.slides], dim=1).to(X)
    shifts = torch.linalg.solve(along, X[:, :3, 3].T).T
    out = X.new_empty(len(X), BASE_DOFS)
    for one, value in zip((*joint.turns, *joint.slides), (*angles.unbind(1), *shifts.unbind(1)), strict=True):
        line = affine(one.function)
        assert line is not None, "a joint that floats is straight"
        out[:, joint.rows.index(one.rows[0])] = (value - line[1]) / line[0]
    return out


def _unwrapped(angles: Float[Tensor, "frames angles"]) -> Float[Tensor, "frames angles"]:
    step = torch.diff(angles, dim=0)
    turns = torch.round(step / (2.0 * torch.pi)).cumsum(0)
    return torch.cat([angles[:1], angles[1:] - 2.0 * torch.pi * turns])


def vee(S: Float[Tensor, "frames 3 3"]) -> Float[Tensor, "frames 3"]:
    """Return the vector of a skew matrix."""
    return torch.stack([S[:, 2, 1], S[:, 0, 2], S[:, 1, 0]], dim=1)
