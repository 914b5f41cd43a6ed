"""Axis values that follow from coordinates: the couplings of a tree whose joints are driven by functions.

A tree's axis values s are its coordinates q and, behind them, *followers* s_k = f_k(...), each a function of
coordinates and of followers before it. Functions of custom joints, coordinates that lead others and locked coordinates
are all followers. Poses and equations of motion see s; whoever asks for coordinates gets them by the chain rule:

    s' = J q',   s'' = J q'' + J' q',   tau_q = J^T tau_s,   J = ds/dq

Derivatives are exact: J by the chain rule, J' in forward mode (``torch.func``). All tensors have the frames last.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.opensim.functions import Constant, Function


def pushed(function: Callable[..., Tensor], at: tuple[Tensor, ...], along: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
    """Return a function's value and its derivative along a direction, exactly (forward mode).

    Args:
        function: of tensors, built of differentiable operations.
        at: its arguments.
        along: direction of each argument.
    """
    found = torch.func.jvp(function, at, along)
    return found[0], found[1]


@dataclass(frozen=True)
class CoupledAxis:
    """One axis value that is a function of others."""

    name: str
    rows: tuple[int, ...]
    """Rows of s that the function is given: coordinates, or followers before this one."""
    function: Function


@dataclass(frozen=True)
class Coupling:
    """All followers of a tree."""

    key: str
    """Two couplings of one key are the same (a hash of what they were made from)."""
    n_dofs: int
    """Number of coordinates; the followers' rows come behind them."""
    followers: tuple[CoupledAxis, ...] = field(compare=False)

    @cached_property
    def leads(self) -> tuple[frozenset[int], ...]:
        """Rows of q that each follower depends on."""
        found: list[frozenset[int]] = []
        for one in self.followers:
            reached = [found[row - self.n_dofs] if row >= self.n_dofs else frozenset({row}) for row in one.rows]
            found.append(frozenset().union(*reached))
        return tuple(found)

    def axes(self, q: Float[Tensor, "dofs frames"]) -> Float[Tensor, "axes frames"]:
        """Return s at q [rad, m]."""
        return torch.cat([q, self._values(q)])

    def _values(self, q: Tensor) -> Tensor:
        """Return the followers alone (followers, frames)."""
        rows = list(q)
        for one in self.followers:
            rows.append(one.function(self._given(rows, one)))
        return torch.stack(rows[self.n_dofs :]) if self.followers else q[:0]

    @staticmethod
    def _given(rows: list[Tensor], one: CoupledAxis) -> Tensor:
        """Return what a follower is given (frames, arguments)."""
        return torch.stack([rows[row] for row in one.rows], -1) if one.rows else rows[0].new_zeros(len(rows[0]), 0)

    def _rate(self, q: Tensor, v: Tensor) -> Tensor:
        """Return the followers' rates (followers, frames) by the chain rule."""
        rows, rates = list(q), list(v)
        for one in self.followers:
            given = self._given(rows, one)
            rows.append(one.function(given))
            rates.append((one.function.slopes(given) * self._given(rates, one)).sum(-1))
        return torch.stack(rates[self.n_dofs :])

    def rates(
        self, q: Float[Tensor, "dofs frames"], v: Float[Tensor, "dofs frames"], a: Float[Tensor, "dofs frames"]
    ) -> tuple[Float[Tensor, "axes frames"], Float[Tensor, "axes frames"]]:
        """Return s' and s''.

        Args:
            q: coordinates [rad, m].
            v: their rates; of the base, velocities in W.
            a: their accelerations, likewise.
        """
        if not self.followers:
            return v, a
        rate, acceleration = pushed(self._rate, (q, v), (v, a))
        return torch.cat([v, rate]), torch.cat([a, acceleration])

    def jacobian(self, q: Float[Tensor, "dofs frames"]) -> Float[Tensor, "followers dofs frames"]:
        """Return the derivatives of the followers by the coordinates.

        Args:
            q: coordinates [rad, m].
        """
        rows, J = list(q), q.new_zeros(len(self.followers), self.n_dofs, q.shape[1])
        for k, one in enumerate(self.followers):
            given = self._given(rows, one)
            rows.append(one.function(given))
            slopes = one.function.slopes(given)
            for row, slope in zip(one.rows, slopes.unbind(-1), strict=True):
                if row < self.n_dofs:
                    J[k, row] += slope
                else:
                    J[k] += slope * J[row - self.n_dofs]
        return J

    def fold(self, q: Float[Tensor, "dofs frames"], x: Float[Tensor, "axes *some frames"]) -> Tensor:
        """Return J^T x, what belongs to the coordinates (dofs, *some, frames).

        Args:
            q: coordinates [rad, m].
            x: covectors of the axes, such as forces, or derivatives by them.
        """
        if not self.followers:
            return x
        J = self.jacobian(q)
        return x[: self.n_dofs] + torch.einsum("kdt,k...t->d...t", J, x[self.n_dofs :])

    def hold(self, values: dict[int, float]) -> "Coupling":
        """Return the coupling in which some coordinates stay where they are; they are followers now.

        Args:
            values: value [rad, m] by row of q.
        """
        place = self.renumber(list(values))
        held = [CoupledAxis(f"held_{row}", (), Constant(value)) for row, value in values.items()]
        moved = [replace(one, rows=tuple(place[row] for row in one.rows)) for one in self.followers]
        key = f"{self.key} held {sorted(values.items())}"
        return Coupling(key, self.n_dofs - len(values), (*held, *moved))

    def renumber(self, values: Sequence[int]) -> dict[int, int]:
        """Return the new row of s of every old one under ``hold`` of these rows, in that order.

        Args:
            values: rows of q that are held.
        """
        kept = [row for row in range(self.n_dofs) if row not in values]
        order = [*kept, *values, *range(self.n_dofs, self.n_dofs + len(self.followers))]
        return {row: k for k, row in enumerate(order)}
