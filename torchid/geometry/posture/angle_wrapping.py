"""This module expresses a joint's rotation by those of its equivalent angles that the joint can take.

Every rotation has two triples of angles about three different axes, and every angle is the same a full turn away. From
rest, an arm overhead may end on those beyond the joint's limits, where least squares stays for good: no angle changes
without leaving the markers. A robust loss would then give up the limb's markers for the limits' sake.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.problem import PosturePrior
from torchid.model.tree import Tree

FULL = 2.0 * torch.pi
"""A full turn [rad]."""


def turned_back(tree: Tree, posture: PosturePrior, q: Float[Tensor, "dofs frames"]) -> Float[Tensor, "dofs frames"]:
    """Return coordinates of the same poses, each joint by the angles that the posture prior finds likeliest.

    A hinge without limits stays as it is, because from frame to frame it has no far side; so does a coordinate that
    drives more than its turn, which is elsewhere after a full one.

    Args:
        tree: joints with their axes.
        posture: prior of the coordinates, with soft limits.
        q: coordinates.
    """
    found = q.clone()
    bounded = (posture.upper - posture.lower).expand(len(q), -1)[:, 0] < 2.0 * FULL
    for k, body in enumerate(tree.bodies):
        moving = tree.own_turns(k)
        rows = [turn.row for turn in moving]
        if len(moving) == len(body.turns) == len({turn.axis for turn in moving}) == 3:
            found[rows] = _likelier(posture.rows(rows), q[rows], _triples(q[rows]))
        else:
            for row in (row for row in rows if bounded[row]):
                found[[row]] = _likelier(posture.rows([row]), q[[row]], q[[row]][None])
    return found


def _triples(q: Float[Tensor, "3 frames"]) -> Float[Tensor, "2 3 frames"]:
    """Return both triples of angles of one rotation; the other one is (a1 + pi, pi - a2, a3 + pi)."""
    return torch.stack([q, torch.stack([q[0] + torch.pi, torch.pi - q[1], q[2] + torch.pi])])


def _likelier(
    posture: PosturePrior, q: Float[Tensor, "angles frames"], ways: Float[Tensor, "ways angles frames"]
) -> Float[Tensor, "angles frames"]:
    """Return the likeliest of q and the ways, these with each angle within half a turn of the expected one."""
    options = torch.cat([q[None], ways - FULL * torch.round((ways - posture.mean) / FULL)])
    best = posture.cost(options).sum(1).argmin(0)
    return options.gather(0, best.expand(1, *q.shape))[0]
