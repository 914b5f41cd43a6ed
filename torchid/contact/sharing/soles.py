"""Soles as seen from above: their axes, places on them, and the patch that they may press."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

LEAST_M = 0.05
"""Chosen: no sole seen from above counts as shorter, however steeply it stands on its toes [m]."""


@dataclass(frozen=True)
class SoleAxes:
    """A sole's axis on the ground at every frame: its place from the heel (0) to the tip of the toes (1)."""

    heel: Float[Tensor, "frames 2"]
    along: Float[Tensor, "frames 2"]
    length: Float[Tensor, " frames"]

    @property
    def across(self) -> Float[Tensor, "frames 2"]:
        """Unit vectors to the left of the axis."""
        return torch.stack([-self.along[:, 1], self.along[:, 0]], dim=1)

    def frames(self, part: slice) -> "SoleAxes":
        """Some of the frames."""
        return SoleAxes(self.heel[part], self.along[part], self.length[part])

    def place(self, point: Float[Tensor, "frames 2"]) -> tuple[Float[Tensor, " frames"], Float[Tensor, " frames"]]:
        """Return where points lie: along, as a part of the length, and across [m]."""
        arm = point - self.heel
        return (arm * self.along).sum(1) / self.length, (arm * self.across).sum(1)

    def point(self, part: Float[Tensor, " frames"], aside: Float[Tensor, " frames"]) -> Float[Tensor, "frames 2"]:
        """Return points on the ground, from their places along and across."""
        return self.heel + self.along * (self.length * part)[:, None] + self.across * aside[:, None]


def sole_axes(sole: Float[Tensor, "frames points 3"]) -> SoleAxes:
    """Return the axes of a sole whose first point is the heel and whose last the tip of the toes."""
    arm = sole[:, -1, :2] - sole[:, 0, :2]
    length = arm.norm(dim=1).clamp(min=LEAST_M)
    return SoleAxes(sole[:, 0, :2], arm / length[:, None], length)


def sole_patch(sole: Float[Tensor, "frames points 3"], height: float, margin_m: float) -> Float[Tensor, "frames 4 3"]:
    """Return the corners of the rectangle on the ground that holds a sole and a margin around it.

    Args:
        sole: points in W, heel first, tip of the toes last [m].
        height: of the ground [m].
        margin_m: what landmarks and shoes add to it on every side [m].
    """
    axes = sole_axes(sole)
    arm = sole[..., :2] - axes.heel[:, None]
    along, across = ((arm * way[:, None]).sum(2) for way in (axes.along, axes.across))
    ends = along.amin(1) - margin_m, along.amax(1) + margin_m
    sides = across.amin(1) - margin_m, across.amax(1) + margin_m
    corners = [axes.heel + axes.along * a[:, None] + axes.across * b[:, None] for a in ends for b in sides]
    flat = torch.stack(corners, dim=1)
    return torch.cat([flat, torch.full_like(flat[..., :1], height)], dim=2)
