"""Joints by name, and everything beyond one displaced."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.displacement import below
from torchid.effects.marker_scene import CarriedMarkers
from torchid.effects.scene import Scene
from torchid.errors import ConfigError
from torchid.kinematics.recursion import cross


def joint_name(scene: Scene, body: int) -> str:
    """Return the name of the proximal joint of a body: that of its coordinates up to the last word.

    Where functions drive joints, whose coordinates may move several, it is the body's own.
    """
    if scene.tree.coupling is not None:
        return scene.tree.names[body]
    rows = [turn.row for turn in scene.tree.bodies[body].turns if turn.moving]
    return scene.tree.dof_names[rows[0]].rpartition("_")[0] if rows else scene.tree.names[body]


def carried_by(scene: Scene, joint: str) -> str:
    """Return the name of the body beyond a joint.

    Raises:
        ConfigError: the model has no such joint.
    """
    for k, name in enumerate(scene.tree.names):
        if k and joint == joint_name(scene, k):
            return name
    known = ", ".join(joint_name(scene, k) for k in range(1, len(scene.tree.names)))
    raise ConfigError("effect.joint", "the model has no such joint", place=joint, remedy=f"Known are {known}")


def before(scene: Scene, body: str) -> int:
    """Return the plan position of the body before the joint that carries ``body``."""
    tree = scene.tree
    return scene.at(tree.names[tree.bodies[tree.names.index(body)].parent])


def unit_ways(scene: Scene, joint: str, along: Sequence[int], turning: bool) -> CarriedMarkers:
    """Everything beyond a joint moved by a metre, or turned by a radian, along some of its axes, see ``directed``."""

    def bodies() -> Float[Tensor, "ways bodies 6 frames"]:
        ones = torch.eye(3).to(scene.q)[list(along), :, None].expand(-1, 3, len(scene.time))
        return torch.stack([directed(scene, joint, one, turning) for one in ones])

    return CarriedMarkers((joint, tuple(along), turning), bodies)


def directed(
    scene: Scene, joint: str, course: Float[Tensor, "3 frames"], turning: bool
) -> Float[Tensor, "bodies 6 frames"]:
    """Everything beyond a joint moved along the axes of the segment before it, or turned about those of the one there.

    Args:
        scene: motion of the bodies.
        joint: its name, see ``joint_name``.
        course: how far along [m], or about [rad], each axis.
        turning: whether it turns.

    Returns:
        Displacement of each body, in plan order: of its origin [m] and rotation [rad], in W.
    """
    body = carried_by(scene, joint)
    k, at = scene.at(body), scene.state.at
    world = torch.einsum("crt,ct->rt", at.R[k if turning else before(scene, body)], course)
    arm = at.p - at.p[k]
    moved = cross(world.expand_as(arm), arm) if turning else world.expand_as(arm)
    turn = world if turning else torch.zeros_like(world)
    return below(scene, body)[:, None, None] * torch.cat([moved, turn.expand_as(moved)], 1)
