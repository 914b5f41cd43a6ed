"""Bodies of a tree as points and sticks for drawing."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.kinematics.recursion import body_transforms
from torchid.model.model import Geometry, Model


def stick_points(
    model: Model, geometry: Geometry, q: Float[Tensor, " dofs"], tip: Float[Tensor, "bodies 3"]
) -> tuple[Float[Tensor, "bodies 4 4"], list[Float[Tensor, "2 3"]]]:
    """Poses of all bodies and the sticks of a posture: parent's joint to body's joint, and joint to tip of a last body.

    Args:
        tip: far end of each body that carries no other, in its axes (``tips``).
    """
    tree = model.tree
    X_WB = body_transforms(tree, q[None], geometry)[0]
    origin, sticks = X_WB[:, :3, 3], []
    for k, body in enumerate(tree.bodies):
        if body.parent >= 0:
            sticks.append(torch.stack([origin[body.parent], origin[k]]))
        if k not in tree.parents:
            sticks.append(torch.stack([origin[k], X_WB[k, :3, :3] @ tip[k] + origin[k]]))
    return X_WB, sticks


def tips(model: Model) -> Float[Tensor, "bodies 3"]:
    """Where a last body ends: the middle of its farthest landmarks, else twice its centre of mass."""
    mean = model.inertia.mean
    tip = 2.0 * mean[:, 1:4] / mean[:, :1].clamp(min=1e-9)
    for k, name in enumerate(model.tree.names):
        places = [mean.new_tensor(mark.p_BM_B) for mark in model.landmarks.values() if mark.segment == name]
        if places and k not in model.tree.parents and name.startswith("foot"):
            tip[k] = max(places, key=lambda place: float(place.norm()))
    return tip


def rest(model: Model) -> Float[Tensor, " dofs"]:
    """Coordinates of the neutral posture, the root at the origin of W."""
    return model.inertia.mean.new_tensor([dof.rest for dof in model.tree.dofs])


def facing(R_WB: Float[Tensor, "3 3"]) -> Float[Tensor, "3 3"]:
    """Horizontal forward, left and up of a body whose X points forward, as rows in W."""
    forward = R_WB[:, 0].clone()
    forward[2] = 0.0
    if float(forward.norm()) < 1e-6:
        forward = R_WB.new_tensor([1.0, 0.0, 0.0])
    forward = forward / forward.norm()
    up = R_WB.new_tensor([0.0, 0.0, 1.0])
    return torch.stack([forward, torch.linalg.cross(up, forward), up])
