"""Angles that effects follow.

What a joint of three axes calls its flexion depends on the order of its turns (Senk & Cheze, Clin Biomech 21 (2006),
on the shoulder). The flexion of an arm before rotation and adduction is not that before abduction and rotation, which
is where the arm points: effects may follow either.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.place import Angle, Place
from torchid.effects.scene import Scene
from torchid.errors import ConfigError
from torchid.model.tree import Tree, Turn
from torchid.motion.rotations import rotation_to_turns, turns_to_rotation

APART = 0.1
"""Proposal. Root mean square of a trial by which another order's angle must differ from the model's to be worth a
place of its own [rad]."""
POLE = 0.3
"""Proposal. Cosine of the second turn below which the first and the third are hardly told apart."""


def bend(scene: Scene, place: Place) -> Float[Tensor, "2 frames"]:
    """Sine and one minus cosine of the angle that a place follows, counted from the joint's rest.

    Raises:
        ConfigError: the model has no such angle.
    """
    angle = _angle(scene, place.follows)
    return torch.stack([torch.sin(angle), 1.0 - torch.cos(angle)])


def lively(scenes: Sequence[Scene], body: int) -> tuple[str, ...]:
    """Coordinates of a body's joint that move at least half as much as the one that moves most, that one first.

    Args:
        scenes: trials whose largest standard deviation counts.
        body: number of a body in the tree; the root has no such coordinate.
    """
    tree = scenes[0].tree
    rows = [turn.row for turn in tree.bodies[body].turns if turn.moving and turn.row < len(tree.dofs)]
    rows = rows or list(tree.driving(body))
    spread = {row: max(float(s.q[row].std()) for s in scenes) for row in rows}
    order = sorted(rows, key=lambda row: -spread[row])
    return tuple(tree.dof_names[row] for row in order if spread[row] >= 0.5 * spread[order[0]])


def orders(scenes: Sequence[Scene], dof: str) -> tuple[Angle, ...]:
    """The angles that may stand for a coordinate: itself, and the same before another turn of its joint.

    The second is left out where it is nearly the first, or where the joint passes the pole of that order.
    """
    tree, own = scenes[0].tree, Angle(dof)
    turns = _three(tree, dof)
    if not turns:
        return (own,)
    other = Angle(dof, tree.dof_names[turns[2].row])
    apart = max(float((_angle(s, own) - _angle(s, other)).square().mean().sqrt()) for s in scenes)
    second = torch.cat([_turned(turns, _reordered(tree, other), _own(s, turns))[:, 1] for s in scenes])
    return (own, other) if apart > APART and float(torch.cos(second).abs().min()) > POLE else (own,)


def _angle(scene: Scene, follows: Angle | None) -> Float[Tensor, " frames"]:
    """The angle that is followed, counted from the joint's rest [rad]."""
    tree = scene.tree
    if follows is None or follows.dof not in tree.dof_names:
        raise _unknown(follows)
    if follows.before is None:
        row = tree.dof_names.index(follows.dof)
        return scene.q[row] - tree.dofs[row].rest
    turns, other = _three(tree, follows.dof), _reordered(tree, follows)
    rest = scene.q.new_tensor([[tree.dofs[turn.row].rest for turn in turns]])
    angle = _turned(turns, other, _own(scene, turns))[:, 0]
    # Whenever the second turn passes its pole, the nearest branch is another: half a turn away, from frame to frame.
    leaps = torch.round(torch.diff(angle) / torch.pi).cumsum(0) * torch.pi
    return torch.cat([angle[:1], angle[1:] - leaps]) - _turned(turns, other, rest)[0, 0]


def _own(scene: Scene, turns: Sequence[Turn]) -> Float[Tensor, "frames 3"]:
    """The coordinates of some turns [rad]."""
    return torch.stack([scene.q[turn.row] for turn in turns], 1)


def _turned(turns: Sequence[Turn], other: Sequence[Turn], q: Float[Tensor, "frames 3"]) -> Float[Tensor, "frames 3"]:
    """Angles of the same rotations by turns in another order [rad]."""
    near = q[:, [list(turns).index(turn) for turn in other]]
    return rotation_to_turns(other, turns_to_rotation(turns, q), near)


def _reordered(tree: Tree, follows: Angle) -> tuple[Turn, ...]:
    """The turns of the joint whose first coordinate is followed, with that of ``before`` as the second."""
    turns = _three(tree, follows.dof)
    second = [turn for turn in turns[1:] if tree.dof_names[turn.row] == follows.before]
    if not second:
        raise _unknown(follows)
    return (turns[0], *second, *(turn for turn in turns[1:] if turn not in second))


def _three(tree: Tree, dof: str) -> tuple[Turn, ...]:
    """The turns about three different axes of the joint whose first is this coordinate; none of any other."""
    for k, body in enumerate(tree.bodies):
        turns = tuple(tree.own_turns(k))
        alone = len({turn.axis for turn in turns}) == len(turns) == len(body.turns) == 3
        if alone and tree.dof_names[turns[0].row] == dof:
            return turns
    return ()


def _unknown(follows: Angle | None) -> ConfigError:
    return ConfigError(
        "effect.follows", "the model has no such angle", place=str(follows),
        remedy=f"Name a coordinate, or the first of a joint's three as in {Angle('hip_l_flexion', 'hip_l_rotation')}",
    )  # fmt: skip
