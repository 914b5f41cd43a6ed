"""Where bodies and markers of an OpenSim model are at given coordinates, in torch, batched and differentiable."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError
from torchid.model.opensim.model import GROUND, OsimJoint, OsimModel, TransformAxis
from torchid.model.opensim.rotations import about_axis, inverse, moved, pose


def coordinate_values(
    model: OsimModel, values: Mapping[str, Float[Tensor, "*batch"] | float]
) -> Float[Tensor, "*batch coordinates"]:
    """Return the rows of q of named values; coordinates without one have their default, and couplers hold.

    Args:
        values: name: values [rad, m], all of one shape or numbers.

    Raises:
        DataError: ``osim.no_coordinate`` for a name that the model does not have.
    """
    unknown = sorted(set(values) - set(model.coordinate_names))
    if unknown:
        remedy = f"The model has {', '.join(model.coordinate_names)}."
        found = ", ".join(unknown)
        raise DataError(
            "osim.no_coordinate", "no coordinate of the model", source=model.source, found=found, remedy=remedy
        )
    rows = [values.get(one.name, one.default) for one in model.coordinates]
    tensors = [torch.as_tensor(row, dtype=torch.float64) for row in rows]
    return coupled(model, torch.stack(torch.broadcast_tensors(*tensors), dim=-1))


def coupled(model: OsimModel, q: Float[Tensor, "*batch coordinates"]) -> Float[Tensor, "*batch coordinates"]:
    """Return the coordinates with every dependent one set to what its coupler demands.

    Args:
        q: values [rad, m]; those of dependent coordinates are passed over.
    """
    rows = list(q.unbind(-1))
    for coupler in model.couplers:
        leading = [rows[row] for row in coupler.independents]
        rows[coupler.dependent] = coupler.function(torch.stack(leading, dim=-1) if leading else q[..., :0])
    return torch.stack(rows, dim=-1) if rows else q


def body_poses(model: OsimModel, q: Float[Tensor, "*batch coordinates"]) -> Float[Tensor, "*batch bodies 4 4"]:
    """Return the poses of all bodies in ground, in the order of ``model.bodies``; couplers hold.

    Args:
        q: values of all coordinates [rad, m].
    """
    q = coupled(model, q)
    ground = torch.eye(4).to(q).expand(*q.shape[:-1], 4, 4)
    poses: dict[int, Tensor] = {GROUND: ground}
    for joint in model.joints:
        poses[joint.carried.body] = poses[joint.carrier.body] @ _across(joint, q)
    return torch.stack([poses[body] for body in range(len(model.bodies))], dim=-3)


def body_pose(model: OsimModel, body: int, q: Float[Tensor, "*batch coordinates"]) -> Float[Tensor, "*batch 4 4"]:
    """Return the pose of one body in ground; of ``body_poses`` the chain that leads to it.

    Args:
        body: index of the body, or ``GROUND``.
        q: values of all coordinates [rad, m], couplers obeyed.
    """
    X_GB = torch.eye(4).to(q).expand(*q.shape[:-1], 4, 4)
    carried = {joint.carried.body: joint for joint in model.joints}
    while body != GROUND:
        X_GB = _across(carried[body], q) @ X_GB
        body = carried[body].carrier.body
    return X_GB


def _across(joint: OsimJoint, q: Float[Tensor, "*batch coordinates"]) -> Float[Tensor, "*batch 4 4"]:
    """Pose of the body that a joint carries in the one that carries it."""
    X = joint_pose(joint, q)
    step = X if joint.outward else inverse(X)
    return joint.carrier.X_BF.to(q) @ step @ inverse(joint.carried.X_BF.to(q))


def joint_pose(joint: OsimJoint, q: Float[Tensor, "*batch coordinates"]) -> Float[Tensor, "*batch 4 4"]:
    """Return the pose of a joint's child frame in its parent frame.

    Args:
        q: values of all coordinates of the model [rad, m].
    """
    R = torch.eye(3).to(q).expand(*q.shape[:-1], 3, 3)
    for turn in joint.turns:
        R = R @ about_axis(turn.unit, _driven(turn, q))
    p = q.new_zeros(*q.shape[:-1], 3)
    for slide in joint.slides:
        p = p + _driven(slide, q)[..., None] * slide.unit.to(q)
    return pose(R, p)


def _driven(axis: TransformAxis, q: Float[Tensor, "*batch coordinates"]) -> Float[Tensor, "*batch"]:
    return axis.function(q[..., list(axis.rows)])


def marker_places(
    model: OsimModel, q: Float[Tensor, "*batch coordinates"], names: Sequence[str] | None = None
) -> Float[Tensor, "*batch markers 3"]:
    """Return the places of markers in ground [m]; couplers hold.

    Args:
        q: values of all coordinates [rad, m].
        names: markers that are wanted; all in the order of the model by default.

    Raises:
        DataError: ``osim.no_marker`` for a name that the model does not have.
    """
    known = {marker.name: marker for marker in model.markers}
    unknown = [name for name in names or () if name not in known]
    if unknown:
        remedy = "Name markers of the model's MarkerSet."
        found = ", ".join(unknown)
        raise DataError("osim.no_marker", "no marker of the model", source=model.source, found=found, remedy=remedy)
    wanted = model.markers if names is None else [known[name] for name in names]
    if not wanted:
        return q.new_zeros(*q.shape[:-1], 0, 3)
    poses = body_poses(model, q)
    rows = [marker.frame.body for marker in wanted]
    fixed = [row == GROUND for row in rows]
    places = moved(poses[..., rows, :, :], torch.stack([marker.p_BM_B for marker in wanted]).to(q))
    if any(fixed):  # GROUND picks the last body; ground does not move
        still = torch.stack([marker.p_BM_B for marker in wanted]).to(q).expand_as(places)
        places = torch.where(torch.tensor(fixed)[:, None], still, places)
    return places
