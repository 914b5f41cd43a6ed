"""Joints that came to rest on the far side: the same rotation by angles a joint can take.

Every rotation has two triples of angles about three different axes, and every angle is the same a full turn away. From
rest, an arm overhead may end on those beyond the joint's limits, where least squares stays for good: no angle changes
without leaving the markers. A robust loss then gave the limb's markers up for the limits' sake, an arm 0.3 m away from
them in 15 frames of 1000, a forearm in 130 of 600.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.problem import PosturePrior
from torchid.model.tree import Tree

FULL = 2.0 * torch.pi


def turned_back(tree: Tree, posture: PosturePrior, q: Float[Tensor, "dofs frames"]) -> Float[Tensor, "dofs frames"]:
    """Coordinates of the same poses, each joint by the angles that the posture prior finds likelier.

    A hinge without limits turns on as it does: from frame to frame it has no far side.
    """
    found = q.clone()
    bounded = (posture.upper - posture.lower).expand(len(q), -1)[:, 0] < 2.0 * FULL
    for body in tree.bodies:
        moving = [turn for turn in body.turns if turn.moving]
        rows = [turn.row for turn in moving]
        if len(moving) == len(body.turns) == len({turn.axis for turn in moving}) == 3:
            found[rows] = _likelier(posture.rows(rows), q[rows], _triples(q[rows]))
        else:
            for row in (row for row in rows if bounded[row]):
                found[[row]] = _likelier(posture.rows([row]), q[[row]], q[[row]][None])
    return found


def _triples(q: Float[Tensor, "3 frames"]) -> Float[Tensor, "2 3 frames"]:
    """Both triples of angles of one rotation; the other is (a1 + pi, pi - a2, a3 + pi)."""
    return torch.stack([q, torch.stack([q[0] + torch.pi, torch.pi - q[1], q[2] + torch.pi])])


def _likelier(
    posture: PosturePrior, q: Float[Tensor, "angles frames"], ways: Float[Tensor, "ways angles frames"]
) -> Float[Tensor, "angles frames"]:
    """As they are, or one of the ways with each angle within half a turn of the expected one."""
    options = torch.cat([q[None], ways - FULL * torch.round((ways - posture.mean) / FULL)])
    best = posture.cost(options).sum(1).argmin(0)
    return options.gather(0, best.expand(1, *q.shape))[0]
