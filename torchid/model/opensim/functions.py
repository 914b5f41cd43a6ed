"""Functions of OpenSim in torch: batched, differentiable twice, with OpenSim's own continuation beyond the ends."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Function(ABC):
    """A scalar function of some coordinates."""

    @property
    def n_arguments(self) -> int:
        """Number of arguments that the function needs; 0 for one that ignores what it is given."""
        return 1

    @abstractmethod
    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Evaluate the function."""

    @abstractmethod
    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return the derivatives by the arguments: forward mode has the same, at forty times the cost of a value."""


@dataclass(frozen=True)
class Constant(Function):
    """A number, whatever the arguments."""

    value: float

    @property
    def n_arguments(self) -> int:
        """No argument is needed."""
        return 0

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Return the value for every entry of the batch."""
        return x.new_full(x.shape[:-1], self.value)

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return zeros."""
        return torch.zeros_like(x)


@dataclass(frozen=True)
class LinearFunction(Function):
    """A weighted sum of the arguments and a constant."""

    weights: Float[Tensor, " arguments"]
    intercept: float

    @property
    def n_arguments(self) -> int:
        """One argument for every weight."""
        return len(self.weights)

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Return weights times arguments, plus the intercept."""
        return x @ self.weights.to(x) + self.intercept

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return the weights for every entry of the batch."""
        return self.weights.to(x).expand(x.shape)


@dataclass(frozen=True)
class Polynomial(Function):
    """A polynomial of one argument."""

    coefficients: Float[Tensor, " powers"]
    """Coefficients from the highest power to the constant, the order of the file."""

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Evaluate by Horner's rule."""
        total = torch.zeros_like(x[..., 0])
        for coefficient in self.coefficients.to(x):
            total = total * x[..., 0] + coefficient
        return total

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Evaluate the derivative by Horner's rule."""
        highest = len(self.coefficients) - 1
        total = torch.zeros_like(x)
        for k, coefficient in enumerate(self.coefficients[:-1].to(x)):
            total = total * x + (highest - k) * coefficient
        return total


@dataclass(frozen=True)
class Multinomial(Function):
    """A polynomial of several arguments."""

    coefficients: Float[Tensor, " terms"]
    exponents: tuple[tuple[int, ...], ...]
    """Power of every argument in every term."""

    @property
    def n_arguments(self) -> int:
        """One argument for every exponent of a term."""
        return len(self.exponents[0])

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Return the sum of the terms."""
        return self._sum(x, torch.tensor(self.exponents), self.coefficients.to(x))

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return the sums of the terms' derivatives."""
        powers, found = torch.tensor(self.exponents), []
        for k in range(self.n_arguments):
            lower = powers.clone()
            lower[:, k] = (lower[:, k] - 1).clamp(min=0)
            found.append(self._sum(x, lower, self.coefficients.to(x) * powers[:, k].to(x)))
        return torch.stack(found, dim=-1)

    @staticmethod
    def _sum(x: Tensor, powers: Tensor, coefficients: Tensor) -> Tensor:
        return (x[..., None, :] ** powers.to(x.device)).prod(-1) @ coefficients


@dataclass(frozen=True)
class ScaledFunction(Function):
    """A multiple of another function."""

    function: Function
    scale: float

    @property
    def n_arguments(self) -> int:
        """The other function's arguments."""
        return self.function.n_arguments

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Return the scale times the other function."""
        return self.scale * self.function(x)

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return the scale times the other function's derivatives."""
        return self.scale * self.function.slopes(x)


@dataclass(frozen=True)
class Sine(Function):
    """A sine of one argument on a constant."""

    amplitude: float
    omega: float
    phase: float
    offset: float

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Return amplitude sin(omega x + phase) + offset."""
        return self.amplitude * torch.sin(self.omega * x[..., 0] + self.phase) + self.offset

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return amplitude omega cos(omega x + phase)."""
        return self.amplitude * self.omega * torch.cos(self.omega * x + self.phase)


@dataclass(frozen=True)
class PiecewiseCubic(Function):
    """A piecewise cubic (or linear) function, continued by the tangents at its ends."""

    x: Float[Tensor, " knots"]
    """Knots, increasing."""
    powers: Float[Tensor, "knots 4"]
    """Polynomial of the distance to each knot, from the constant to the cube; behind the last knot it is straight."""

    def __call__(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch"]:
        """Evaluate the piece that each argument lies on."""
        (a, b, c, d), step = self._piece(x[..., 0])
        curved = step.clamp(min=0.0)  # below the first knot the tangent goes on
        return a + b * step + curved * curved * (c + d * curved)

    def slopes(self, x: Float[Tensor, "*batch arguments"]) -> Float[Tensor, "*batch arguments"]:
        """Return the derivative of the piece that each argument lies on."""
        (_, b, c, d), step = self._piece(x)
        curved = step.clamp(min=0.0)
        return b + curved * (2.0 * c + 3.0 * d * curved)

    def _piece(self, value: Tensor) -> tuple[tuple[Tensor, ...], Tensor]:
        """Powers of the piece that each value lies on, and the way from its knot."""
        value = value.contiguous()
        knots, powers = self.x.to(value), self.powers.to(value)
        piece = (torch.searchsorted(knots, value.detach(), right=True) - 1).clamp(min=0)
        return powers[piece].unbind(-1), value - knots[piece]


def broken_line(x: Float[Tensor, " knots"], y: Float[Tensor, " knots"]) -> PiecewiseCubic:
    """Return straight lines from knot to knot; the first and the last go on.

    Args:
        x: knots, increasing.
    """
    slopes = y.diff() / x.diff()
    return _pieces(x, y, torch.cat([slopes, slopes[-1:]]), torch.zeros_like(x), torch.zeros_like(x))


def simm_spline(x: Float[Tensor, " knots"], y: Float[Tensor, " knots"]) -> PiecewiseCubic:
    """Return OpenSim's cubic spline through points; beyond the ends it goes on straight.

    SimmSpline, which OpenSim before version 3 calls NaturalCubicSpline, has a third derivative at each end that is that
    of the cubic through the four points there; with three points it is zero, so that one parabola remains (Forsythe,
    Malcolm, Moler, Computer Methods for Mathematical Computations, Prentice-Hall 1977, section 4.4).

    Args:
        x: knots, increasing, two at least.
    """
    if len(x) == 2:
        return broken_line(x, y)
    h, slopes = x.diff(), y.diff() / x.diff()
    sixth = torch.linalg.solve(_system(h), torch.cat([_ends(x, y), slopes.diff(), _ends(x.flip(0), y.flip(0))]))
    first = slopes - h * (2.0 * sixth[:-1] + sixth[1:])
    last = slopes[-1:] + h[-1:] * (sixth[-2:-1] + 2.0 * sixth[-1:])
    cubes = torch.cat([sixth.diff() / h, h.new_zeros(1)])
    squares = torch.cat([3.0 * sixth[:-1], h.new_zeros(1)])
    return _pieces(x, y, torch.cat([first, last]), squares, cubes)


def _system(h: Float[Tensor, " steps"]) -> Float[Tensor, "knots knots"]:
    """Return the matrix whose unknowns are a sixth of the second derivatives at the knots.

    Rows inside make the slope continuous; the first and the last state the third derivative of the end pieces.
    """
    n = len(h) + 1
    matrix = torch.zeros(n, n, dtype=h.dtype)
    inside = torch.arange(1, n - 1)
    matrix[inside, inside - 1], matrix[inside, inside + 1] = h[:-1], h[1:]
    matrix[inside, inside] = 2.0 * (h[:-1] + h[1:])
    matrix[0, 0], matrix[0, 1] = -1.0, 1.0
    matrix[-1, -2], matrix[-1, -1] = 1.0, -1.0
    return matrix


def _ends(x: Float[Tensor, " knots"], y: Float[Tensor, " knots"]) -> Float[Tensor, " one"]:
    """Return the rise of the unknown over the first piece: its length times the third divided difference."""
    if len(x) < 4:
        return x.new_zeros(1)
    differences = y[:4]
    for order in range(1, 4):
        differences = differences.diff() / (x[order:4] - x[: 4 - order])
    return differences * (x[1] - x[0])


def _pieces(x: Tensor, y: Tensor, *powers: Tensor) -> PiecewiseCubic:
    return PiecewiseCubic(x, torch.stack([y, *powers], dim=1))
