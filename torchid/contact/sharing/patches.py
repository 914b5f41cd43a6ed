"""What contacts other than feet press with, what is likely of them, and the part of a body's need that nobody bears."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.contact.sharing.expected import FAINT_N
from torchid.contact.sharing.records import Needed

GRIP_N = 150.0
"""Chosen: standard deviation of each component of a grip's force [N]: who is helped up by a rail, or walks on a cane,
bears 10 to 30 % of his weight with it."""
GRIP_NM = 2.0
"""Chosen: standard deviation of the moment that a grip exerts about the middle of its points [N m]."""
SURFACE_LEAN = 0.2
"""Chosen: standard deviation of a surface's tangential over its normal force."""
SURFACE_TWIST_M = 0.02
"""Chosen: standard deviation of a surface's moment about its normal over the normal force [m]."""
LEAST_M = 0.01
"""Chosen: no patch counts as smaller [m]."""
APART_M = 1.0
"""Chosen: distance of the points by which nobody bears, from where moments are taken [m]; three of them exert every
wrench, whatever it is."""


@dataclass(frozen=True)
class Patch:
    """Points at which a segment is touched."""

    points: Float[Tensor, "frames points 3"]
    """In W [m]."""
    axes: Float[Tensor, "3 3"]
    """Two tangents and the direction in which the support pushes, as rows, in W."""
    friction: float
    """Coefficient; infinite for a grip."""

    @property
    def middle(self) -> Float[Tensor, "frames 3"]:
        """Return the middle of the points in W [m]."""
        return self.points.mean(dim=1)


def axes_about(normal: Float[Tensor, " 3"]) -> Float[Tensor, "3 3"]:
    """Return two tangents and a unit normal as rows.

    Args:
        normal: of any length.
    """
    n = normal / normal.norm()
    other = torch.zeros_like(n)
    other[int(n.abs().argmin())] = 1.0
    first = torch.linalg.cross(other, n)
    first = first / first.norm()
    return torch.stack([first, torch.linalg.cross(n, first), n])


def patch_rows(patch: Patch, load: Float[Tensor, " frames"]) -> Float[Tensor, "frames rows 6"]:
    """Return rows on a contact's wrench about the world's origin over their standard deviations; all aim at zero.

    A grip's force and its moment about the middle of its points are as large as grips' are; a surface is pressed
    anywhere on its patch alike, leans and twists somewhat.

    Args:
        load: that a surface may bear, to which its deviations are in proportion [N].
    """
    zero, axes = torch.zeros(3, 3).to(patch.axes), patch.axes
    c = patch.middle
    # About the middle c the moment is m - c x f; its part along e is e.m - (e x c).f.
    turned = -torch.linalg.cross(axes.expand(len(c), 3, 3), c[:, None].expand(-1, 3, -1))
    moment = torch.cat([turned, axes.expand(len(c), 3, 3)], dim=2)
    force = torch.cat([axes, zero], dim=1).expand(len(c), 3, 6)
    if math.isinf(patch.friction):
        return torch.cat([force / (GRIP_N), moment / GRIP_NM], dim=1)
    arm = (patch.points - c[:, None]) @ axes.T
    along, across = (arm[..., k].std(dim=1, correction=0).clamp(min=LEAST_M) / math.sqrt(3.0) for k in (0, 1))
    size = load.clamp(min=FAINT_N)
    sd = torch.stack([across * size, along * size, SURFACE_TWIST_M * size], dim=1)
    return torch.cat([moment / sd[..., None], force[:, :2] / (SURFACE_LEAN * size)[:, None, None]], dim=1)


@dataclass(frozen=True)
class Rest:
    """A part of what a body needs that no contact bears: the error of that need, beside contacts that cannot bear all.

    A hand that holds on to a point exerts no moment there; what six equations ask of it beyond is the body's error.
    """

    points: Float[Tensor, "frames 3 3"]
    rows: Float[Tensor, "frames 6 6"]
    """On its wrench about the world's origin, over the standard deviations of the need."""


def rest_of(needed: Needed) -> Rest:
    """Return the rest of a body's need, to be shared as if it were a contact.

    Args:
        needed: what the body needs, and how well that is known.
    """
    about = torch.zeros_like(needed.wrench[:, :3]) if needed.about is None else needed.about
    points = about[:, None] + APART_M * torch.eye(3).to(about)
    return Rest(points, torch.linalg.inv(needed.factor))
