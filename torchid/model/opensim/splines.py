"""Coefficients of OpenSim's splines and broken lines.

SimmSpline, which OpenSim before version 3 calls NaturalCubicSpline, is a cubic spline whose third derivative at each
end is that of the cubic through the four points there; with three points it is zero, so that one parabola remains.

Cited. Forsythe, Malcolm, Moler, Computer Methods for Mathematical Computations, Prentice-Hall 1977, section 4.4.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.opensim.functions import PiecewiseCubic


def broken_line(x: Float[Tensor, " knots"], y: Float[Tensor, " knots"]) -> PiecewiseCubic:
    """Return straight lines from knot to knot; the first and the last go on.

    Args:
        x: knots, increasing.
    """
    slopes = y.diff() / x.diff()
    return _pieces(x, y, torch.cat([slopes, slopes[-1:]]), torch.zeros_like(x), torch.zeros_like(x))


def simm_spline(x: Float[Tensor, " knots"], y: Float[Tensor, " knots"]) -> PiecewiseCubic:
    """Return OpenSim's cubic spline through points; beyond the ends it goes on straight.

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
