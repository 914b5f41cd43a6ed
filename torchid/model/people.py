"""How people of a group differ from tables of anthropometry, in scores: standard deviations of what tables say.

A person has theta = B s + e. The columns of B are orthonormal: what left and right have in common of each unknown, what
a body has in its middle, lengths, and cuts. The mean s of the group is N(0, 1 - r), and what is each person's own, e,
is N(0, r) in these directions and N(0, 1) in all others: the total mass, and what makes left other than right. So a
person of a group of whom nothing is known scatters as tables have it, whatever r.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.skeleton import SEGMENTS

LATENT = 10
"""Unknowns per segment: log mass, centre (3), log extents (3), normalised products of inertia (3)."""
PARTS = tuple(name[:-2] if name[-2:] in ("_l", "_r") else name for name in SEGMENTS)
"""Segments without their side."""
SIDEWAYS = (2, 7, 9)
"""Unknowns of a segment that change their sign where left and right are exchanged: y of the centre, products xy, yz."""
SCALE, TOTAL, CUTS = LATENT * len(SEGMENTS), LATENT * len(SEGMENTS) + 1, 2
"""Indices of the length scale and of the total mass behind the segments' scores, and how many cuts follow."""
SCORES = TOTAL + 1 + CUTS
"""Number of scores of a person."""


@dataclass(frozen=True)
class People:
    """What sessions of a group say of one more person of it."""

    score: Float[Tensor, " scores"]
    """Mean of the scores."""
    covariance: Float[Tensor, "scores scores"]
    """Their covariance."""
    count: int
    """People who tell it."""
    own: float
    """Share r of the tables' variance that is each person's own."""


def shared() -> Float[Tensor, "scores means"]:
    """Return B: what a mean of a group changes of a person's scores."""
    columns: dict[tuple[str, int], Tensor] = {}
    for segment, part in enumerate(PARTS):
        sided = PARTS.count(part) > 1
        right = segment > PARTS.index(part)
        for k in range(LATENT):
            if sided or k not in SIDEWAYS:
                column = columns.setdefault((part, k), torch.zeros(SCORES, dtype=torch.float64))
                column[LATENT * segment + k] = -1.0 if right and k in SIDEWAYS else 1.0
    others = torch.eye(SCORES, dtype=torch.float64)[[SCALE, *range(TOTAL + 1, SCORES)]]
    found = torch.cat([torch.stack(list(columns.values())), others]).T
    return found / found.norm(dim=0)


def own_covariance(own: float) -> Float[Tensor, "scores scores"]:
    """Return the covariance of what is each person's own.

    Args:
        own: share r of the variance in the directions that a group may share.
    """
    B = shared()
    return torch.eye(SCORES, dtype=torch.float64) - (1.0 - own) * B @ B.mT


def axes() -> Float[Tensor, "scores scores"]:
    """Return orthonormal axes as columns, first as many as B has and in its directions, in which what is each person's
    own is independent."""
    return torch.linalg.qr(shared(), mode="complete")[0]
