"""Where a body is that slides on an ellipsoid, as a function of its joint's turns."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.opensim.functions import Function
from torchid.model.opensim.rotations import about_axis, cross_matrix


@dataclass(frozen=True)
class OnEllipsoid(Function):
    """A component of the place of a joint's child frame.

    With R of the first three turns and A of a fourth one, about an axis through c on the body,

        p = diag(r) R z + R (c - A c):

    the point of the ellipsoid whose normal is R z (Simbody's MobilizedBody::Ellipsoid), and what the fourth turn moves
    the origin by.
    """

    component: int
    """0, 1 or 2: along X, Y or Z."""
    radius: float
    """Half axis of the ellipsoid along it [m]."""
    axes: Float[Tensor, "turns 3"]
    """Unit axes of three or four turns, each in the axes that the turns before it have reached."""
    centre: Float[Tensor, "3"]
    """A point of the fourth axis [m]."""

    @property
    def n_arguments(self) -> int:
        """One angle for every turn."""
        return len(self.axes)

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Return the component [m] at angles [rad]."""
        turns = self._turns(x)
        return self._place(turns[:3], self._shift(x) - self._moved(turns))

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return the derivatives by the angles: the rate of a turn is the turn times its axis's cross product."""
        turns, found = self._turns(x), []
        shift = self._shift(x) - self._moved(turns)
        rates = [cross_matrix(axis.to(x)) @ turn for axis, turn in zip(self.axes, turns, strict=True)]
        for k in range(3):
            found.append(self._place([*turns[:k], rates[k], *turns[k + 1 : 3]], shift))
        if len(turns) > 3:
            R = turns[0] @ turns[1] @ turns[2]
            found.append((R @ -self._moved([*turns[:3], rates[3]])[..., None])[..., self.component, 0])
        return torch.stack(found, dim=-1)

    def _turns(self, x: Tensor) -> list[Tensor]:
        return [about_axis(axis, angle) for axis, angle in zip(self.axes, x.unbind(-1), strict=True)]

    def _shift(self, x: Tensor) -> Tensor:
        return self.centre.to(x).expand(*x.shape[:-1], 3)

    def _moved(self, turns: Sequence[Tensor]) -> Tensor:
        """Return A c, and c itself where there is no fourth turn."""
        centre = self.centre.to(turns[0]).expand(*turns[0].shape[:-2], 3)
        return (turns[3] @ centre[..., None])[..., 0] if len(turns) > 3 else centre

    def _place(self, turns: Sequence[Tensor], shift: Tensor) -> Tensor:
        row = (turns[0] @ turns[1] @ turns[2])[..., self.component, :]
        return self.radius * row[..., 2] + (row * shift).sum(-1)
