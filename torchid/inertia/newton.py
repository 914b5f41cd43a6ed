"""Newton steps that carry a solver's point to the stationarity that double precision allows.

Interior-point steps over exponential cones leave a stationarity residual of 1e-6. Once they have told which
constraints hold with equality, the optimum is a smooth problem: each step solves the linearised
Karush-Kuhn-Tucker system (Nocedal & Wright, Numerical Optimization, 2006, chapter 18).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Matrix = Float[np.ndarray, "params params"]
Vector = Float[np.ndarray, " params"]
Objective = Callable[[Vector], tuple[Vector, Matrix]]
"""Gradient and Hessian at a point."""

_STEPS = 100
"""Largest number of steps; two or three where the solver has told rightly what is touched."""
_DONE = 1e-10
"""Newton decrement at which steps end."""


@dataclass(frozen=True)
class QuadraticMisfit:
    """Squared residual x' hessian x - 2 pull' x + square of the data, in relative parameters."""

    hessian: Matrix
    pull: Vector
    square: float

    def excess(self, x: Vector, budget: float) -> float:
        """Squared residual above ``budget``."""
        return float(x @ self.hessian @ x - 2 * self.pull @ x + self.square) - budget

    def slope(self, x: Vector) -> Vector:
        """Return the gradient of the squared residual."""
        return 2 * (self.hessian @ x - self.pull)


@dataclass(frozen=True)
class Surface:
    """Parameters whose squared residual equals ``budget``, and the multiplier of it where the solver left it."""

    misfit: QuadraticMisfit
    budget: float
    multiplier: float


def polish(
    x: Vector,
    objective: Objective,
    rows: Float[np.ndarray, "touched params"],
    value: Float[np.ndarray, " touched"],
    convexity: float,
    surface: Surface | None = None,
) -> tuple[Vector, Float[np.ndarray, " touched"], float]:
    """Take damped Newton steps along ``rows @ x == value`` and the surface.

    Args:
        x: where the solver ended.
        objective: its gradient and Hessian.
        rows, value: linear constraints that hold with equality.
        convexity: smallest weight of a divergence in the objective; a small one shortens the first steps.
        surface: the error bound, where it holds with equality.

    Returns:
        The point, the multipliers of the rows, and that of the squared residual (0 without a surface).
    """
    dual, multiplier = np.zeros(len(rows)), surface.multiplier if surface else 0.0
    for _ in range(_STEPS):
        slope, bend = objective(x)
        normals, short, size = rows, value - rows @ x, 1.0
        if surface is not None:
            bend = bend + 2 * multiplier * surface.misfit.hessian
            normal = surface.misfit.slope(x)
            size = float(np.linalg.norm(normal))
            normals = np.vstack([rows, -normal / size])
            short = np.append(short, surface.misfit.excess(x, surface.budget) / size)
        system = np.block([[bend, -normals.T], [-normals, np.zeros((len(normals), len(normals)))]])
        solution = np.linalg.solve(system, np.concatenate([-slope, -short]))
        step, dual = solution[: len(x)], solution[len(x) :]
        if surface is not None:
            multiplier, dual = float(dual[-1]) / size, dual[:-1]
        decrement = float(np.sqrt(max(step @ bend @ step, 0.0)))
        # -log det times 2 * convexity is self-concordant with that constant (Nesterov, Lectures on Convex
        # Optimization, 2018, chapter 5); what is quadratic or linear changes nothing.
        x = x + step / (1 + decrement / np.sqrt(2 * convexity))
        if decrement < _DONE:
            break
    return x, dual, multiplier
