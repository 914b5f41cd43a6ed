"""Where a joint with slides puts the body that carries its parent, as a function of its turns and slides."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.opensim.functions import Function
from torchid.model.opensim.rotations import about_axis, cross_matrix


@dataclass(frozen=True)
class ReversedSlide(Function):
    """A component of the place of a joint's parent frame in its child frame.

    With R of all turns and p of all slides the child stands at (R, p) in the parent, and so the parent at (R', -R' p)
    in the child.
    """

    component: int
    """0, 1 or 2: along X, Y or Z."""
    axes: Float[Tensor, "turns 3"]
    """Unit axes of the turns, each in the axes that the turns before it have reached."""
    directions: Float[Tensor, "slides 3"]
    """Directions of the slides."""

    @property
    def n_arguments(self) -> int:
        """One angle for every turn, then one way for every slide."""
        return len(self.axes) + len(self.directions)

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Return the component [m] at angles [rad] and ways [m]."""
        return -(self._column(self._turns(x)) * self._way(x)).sum(-1)

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return the derivatives: the rate of a turn is the turn times its axis's cross product."""
        turns, way, found = self._turns(x), self._way(x), []
        for k, axis in enumerate(self.axes):
            rate = cross_matrix(axis.to(x)) @ turns[k]
            found.append(-(self._column([*turns[:k], rate, *turns[k + 1 :]]) * way).sum(-1))
        along = -(self._column(turns) @ self.directions.to(x).T).expand(*x.shape[:-1], -1)
        return torch.cat([*(slope[..., None] for slope in found), along], dim=-1)

    def _turns(self, x: Tensor) -> list[Tensor]:
        return [about_axis(axis, x[..., k]) for k, axis in enumerate(self.axes)]

    def _way(self, x: Tensor) -> Tensor:
        return x[..., len(self.axes) :] @ self.directions.to(x)

    def _column(self, turns: list[Tensor]) -> Tensor:
        """The column of R, whose product with p is the component of R' p."""
        R = torch.eye(3).to(self.directions if not turns else turns[0])
        for turn in turns:
            R = R @ turn
        return R[..., :, self.component]
