"""Courses in time as cubic B-splines, and the linear system of their coefficients.

A frame feels ``TOUCHED`` coefficients, so that a matrix of least squares couples each with three on either side. Taken
three by three they make it block-tridiagonal, and one Cholesky factor of it is found from the first block to the last
(Golub & Van Loan, Matrix Computations, 4th ed., 4.5).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

TOUCHED = 4
"""Resolution. Coefficients that a frame feels: of cubic splines (de Boor, A Practical Guide to Splines, ch. IX)."""
COUPLED = TOUCHED - 1
"""Resolution. Coefficients on either side with which one shares frames."""


@dataclass(frozen=True)
class Knots:
    """Uniform knots, between frames."""

    frames: int
    every: int
    """Frames from a knot to the next."""
    rate_hz: float

    @property
    def intervals(self) -> int:
        """Number of intervals between knots; the last may have fewer frames."""
        return -(-self.frames // self.every)

    @property
    def coefficients(self) -> int:
        """Number of coefficients of a course."""
        return self.intervals + COUPLED

    def basis(self, like: Tensor) -> Float[Tensor, "3 every 4"]:
        """Return the four splines of an interval and their first and second derivatives [1/s, 1/s^2], frame by frame.

        Args:
            like: whose device and precision they have.
        """
        u = (torch.arange(self.every).to(like) + 0.5) / self.every
        s, one, knots_s = 1.0 - u, torch.ones_like(u), self.rate_hz / self.every
        value = [s**3, 3 * u**3 - 6 * u**2 + 4, 3 * s**3 - 6 * s**2 + 4, u**3]
        slope = [-3 * s**2, 9 * u**2 - 12 * u, 12 * s - 9 * s**2, 3 * u**2]
        bend = [6 * s, 18 * u - 12 * one, 18 * s - 12 * one, 6 * u]
        scaled = zip((value, slope, bend), (1.0, knots_s, knots_s**2), strict=True)
        return torch.stack([torch.stack(four, 1) * scale / 6.0 for four, scale in scaled])

    def by_interval(self, x: Float[Tensor, "frames *some"]) -> Float[Tensor, "intervals every *some"]:
        """Return what is known of frames interval by interval, zero where frames are missing in the last."""
        missing = self.intervals * self.every - self.frames
        return torch.cat([x, x.new_zeros(missing, *x.shape[1:])]).unflatten(0, (self.intervals, self.every))

    def course(self, coefficients: Float[Tensor, "coefficients *some"]) -> Float[Tensor, "frames *some"]:
        """Return the values of a course at the frames."""
        touched = coefficients.unfold(0, TOUCHED, 1)
        value = self.basis(coefficients)[0]
        return torch.einsum("hp,i...p->ih...", value, touched).flatten(0, 1)[: self.frames]

    def gathered(self, parts: Float[Tensor, "intervals 4 *some"]) -> Float[Tensor, "coefficients *some"]:
        """Return sums over the intervals of what each has of its four coefficients."""
        found = parts.new_zeros(self.coefficients, *parts.shape[2:])
        for p in range(TOUCHED):
            found[p : p + self.intervals] += parts[:, p]
        return found


class BlockBand:
    """A symmetric matrix of blocks (n, n), one for each pair of coefficients that share frames."""

    def __init__(self, knots: Knots, size: int, like: Tensor) -> None:
        """Begin with zero.

        Args:
            size: of a block.
            like: whose device and precision it has.
        """
        self.knots = knots
        self.bands = torch.zeros(TOUCHED, knots.coefficients, size, size).to(like)
        """Block (d, k) stands in row k + d and column k."""

    def add(self, parts: Float[Tensor, "intervals 4 n 4 n"]) -> None:
        """Add what each interval has of its four coefficients, of a symmetric matrix."""
        for p in range(TOUCHED):
            for q in range(p + 1):
                self.bands[p - q, q : q + self.knots.intervals] += parts[:, p, :, q]

    def times(self, x: Float[Tensor, "coefficients n"]) -> Float[Tensor, "coefficients n"]:
        """Return the product with a vector."""
        found = (self.bands[0] @ x[..., None])[..., 0]
        for d in range(1, TOUCHED):
            blocks = self.bands[d, :-d]
            found[d:] += (blocks @ x[:-d, :, None])[..., 0]
            found[:-d] += (blocks.mT @ x[d:, :, None])[..., 0]
        return found

    def factor(self) -> "BandFactor":
        """Return the Cholesky factor; the matrix has to be positive definite."""
        bands, (_, count, n, _) = self.bands, self.bands.shape
        missing = -count % COUPLED
        bands = torch.cat([bands, bands.new_zeros(TOUCHED, missing, n, n)], 1)
        bands[0, count:] = torch.eye(n).to(bands)
        groups = bands.shape[1] // COUPLED
        on = bands.new_zeros(groups, COUPLED, n, COUPLED, n)
        beside = torch.zeros_like(on)
        for i in range(COUPLED):
            for j in range(COUPLED):
                if i >= j:
                    on[:, i, :, j] = bands[i - j, j::COUPLED]
                if i <= j:
                    beside[:, i, :, j] = bands[COUPLED + i - j, j::COUPLED]
        diagonal, below = [], []
        for block, lower in zip(on.flatten(3).flatten(1, 2), beside.flatten(3).flatten(1, 2), strict=True):
            own = torch.addmm(block, below[-1], below[-1].mT, alpha=-1.0) if below else block
            diagonal.append(torch.linalg.cholesky(own))
            below.append(torch.linalg.solve_triangular(diagonal[-1], lower.mT, upper=False).mT)
        return BandFactor(count, diagonal, below)


@dataclass(frozen=True)
class BandFactor:
    """Lower Cholesky factor of a block-tridiagonal matrix."""

    count: int
    """Number of coefficients; the last block is filled up with the identity."""
    diagonal: list[Float[Tensor, "m m"]]
    below: list[Float[Tensor, "m m"]]
    """Block below each one of the diagonal."""

    def solve(self, right: Float[Tensor, "coefficients n"]) -> Float[Tensor, "coefficients n"]:
        """Return the solution of the linear system."""
        return self._back(self._forth(right[..., None]))[..., 0]

    def draw(self, white: Float[Tensor, "coefficients n draws"]) -> Float[Tensor, "coefficients n draws"]:
        """Return draws whose covariance is the inverse of the matrix, of unit normal ones."""
        return self._back(list(self._grouped(white)))

    def _grouped(self, x: Float[Tensor, "coefficients n some"]) -> Float[Tensor, "groups m some"]:
        missing = len(self.diagonal) * COUPLED - self.count
        return torch.cat([x, x.new_zeros(missing, *x.shape[1:])]).unflatten(0, (-1, COUPLED)).flatten(1, 2)

    def _forth(self, right: Float[Tensor, "coefficients n some"]) -> list[Tensor]:
        found: list[Tensor] = []
        for k, own in enumerate(self._grouped(right)):
            left = own if k == 0 else own - self.below[k - 1] @ found[-1]
            found.append(torch.linalg.solve_triangular(self.diagonal[k], left, upper=False))
        return found

    def _back(self, right: list[Tensor]) -> Float[Tensor, "coefficients n some"]:
        found: list[Tensor] = []
        for k in reversed(range(len(right))):
            left = right[k] if not found else right[k] - self.below[k].mT @ found[-1]
            found.append(torch.linalg.solve_triangular(self.diagonal[k].mT, left, upper=True))
        whole = torch.stack(found[::-1])
        return whole.unflatten(1, (COUPLED, -1)).flatten(0, 1)[: self.count]
