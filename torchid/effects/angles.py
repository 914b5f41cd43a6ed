"""Angles that effects follow.

What a joint of three axes calls its flexion depends on the order of its turns. Of an arm, the flexion before rotation
and adduction is not that before abduction and rotation, which is where the arm points; lifted sideways, they were 0.2
rad apart. A glide of 7 mm at such a shoulder followed the one: fitted with the other, it was found 6 mm off along the
arm, where its standard deviation was 0.3 mm, with skin that did not slide.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.place import Place
from torchid.effects.scene import Scene
from torchid.errors import ConfigError
from torchid.model.tree import Tree, Turn
from torchid.motion.rotations import rotation_to_turns, turns_to_rotation

BEFORE = " before "
"""Between two coordinates: the angle of the first if the second were the next turn, as in ``hip_l_flexion before
hip_l_rotation``."""
APART = 0.1
"""By which that must differ from the model's coordinate to be worth a place of its own, root mean square of a trial
[rad]."""


def bend(scene: Scene, place: Place) -> Float[Tensor, "2 frames"]:
    """Sine and one minus cosine of the angle that a place follows, from its rest.

    Raises:
        ConfigError: the model has no such angle.
    """
    angle = _angle(scene, str(place.follows))
    return torch.stack([torch.sin(angle), 1.0 - torch.cos(angle)])


def lively(scenes: Sequence[Scene], body: int) -> tuple[str, ...]:
    """Coordinates of a body's joint that move at least half as much as the one that moves most, and first; the root
    has none."""
    tree = scenes[0].tree
    rows = [turn.row for turn in tree.bodies[body].turns if turn.moving]
    spread = {row: max(float(s.q[row].std()) for s in scenes) for row in rows}
    order = sorted(rows, key=lambda row: -spread[row])
    return tuple(tree.dof_names[row] for row in order if spread[row] >= 0.5 * spread[order[0]])


def readings(scenes: Sequence[Scene], dof: str) -> tuple[str, ...]:
    """What effects may follow that follow a coordinate: itself, and the same before another turn."""
    tree = scenes[0].tree
    turns = _three(tree, dof)
    if not turns:
        return (dof,)
    other = dof + BEFORE + tree.dof_names[turns[2].row]
    apart = max(float((_angle(s, dof) - _angle(s, other)).square().mean().sqrt()) for s in scenes)
    return (dof, other) if apart > APART else (dof,)


def _angle(scene: Scene, follows: str) -> Float[Tensor, " frames"]:
    tree = scene.tree
    dof, _, following = follows.partition(BEFORE)
    turns = _three(tree, dof)
    second = [turn for turn in turns[1:] if tree.dof_names[turn.row] == following]
    if dof not in tree.dof_names or (following and not second):
        raise ConfigError(
            "effect.follows", "the model has no such angle", place=follows,
            remedy=f"Name one of its coordinates, or the first of a joint's three{BEFORE}one of the others",
        )  # fmt: skip
    row = tree.dof_names.index(dof)
    rest = tree.dofs[row].rest
    if not second:
        return scene.q[row] - rest
    other = (turns[0], *second, *(turn for turn in turns[1:] if turn not in second))
    q, near = (torch.stack([scene.q[turn.row] for turn in some], 1) for some in (turns, other))
    return rotation_to_turns(other, turns_to_rotation(turns, q), near)[:, 0] - rest


def _three(tree: Tree, dof: str) -> tuple[Turn, ...]:
    """The turns of a joint of three axes whose first is this coordinate; none of any other."""
    joints = (body.turns for body in tree.bodies if len(body.turns) == 3 and all(turn.moving for turn in body.turns))
    return next((tuple(turns) for turns in joints if tree.dof_names[turns[0].row] == dof), ())
