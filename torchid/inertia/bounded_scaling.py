"""Coordinates in which the program of an error bound is well scaled.

Its variables are scaled by the Hessian of mu ||Y phi - F||^2 + d(phi) at the mu that the problem without cones has,
the root of the secular equation of a trust region (Conn, Gould & Toint, Trust-Region Methods, 2000).
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import brentq
from torch import Tensor

from torchid.inertia.cone import unit_axes
from torchid.inertia.newton import Matrix, QuadraticMisfit, Vector
from torchid.inertia.options import InertiaOptions
from torchid.inertia.problem import Problem
from torchid.inertia.solve import relative_precision
from torchid.inertia.spectrum import Spectrum

_NULL = 1e-14
"""Eigenvalue of the data's Hessian, over its largest, below which only rounding is left of it."""
ACTIVE = 1e-9
"""Multiplier of the bound times its budget up to which the bound does not matter."""
_DECADES = 40.0
"""Natural logarithms around 1 / budget within which the multiplier is looked for: seventeen decades each way."""


@dataclass(frozen=True)
class BoundedTask:
    """The question of a fit under an error bound, in relative parameters x."""

    problem: Problem
    spectrum: Spectrum
    budget: float
    options: InertiaOptions
    misfit: QuadraticMisfit
    precision: Matrix
    """Inverse covariance of the prior's Gaussian."""
    mass_hessian: Matrix
    mass_pull: Vector
    """Square of the weighed total mass: x' mass_hessian x - 2 mass_pull' x."""

    def active(self, multiplier: float) -> float:
        """The multiplier, or 0 where the bound does not matter."""
        return multiplier if multiplier * self.budget > ACTIVE else 0.0

    def relative(self, phi: Tensor) -> Vector:
        """Relative parameters of ``phi``."""
        return torch.linalg.solve(self.problem.T, phi.reshape(-1, 10, 1)).flatten().cpu().numpy()


@dataclass(frozen=True)
class ScaledProgram:
    """The program in w, x = centre + rotate @ w, of which the residual is ||root @ w - target||^2 + rest."""

    centre: Vector
    rotate: Matrix
    root: Float[np.ndarray, "rank params"]
    target: Float[np.ndarray, " rank"]
    radius: float
    """Square root of budget - rest."""
    multiplier: float
    """Multiplier of the squared residual in the problem without cones."""


def pose_bounded(problem: Problem, spectrum: Spectrum, budget: float, options: InertiaOptions) -> BoundedTask:
    """Bring data, prior and weighed mass to relative parameters."""
    block = torch.block_diag(*problem.T)

    def relative(gram: Tensor, moment: Tensor) -> tuple[Matrix, Vector]:
        return (block.mT @ gram @ block).cpu().numpy(), (block.mT @ moment).cpu().numpy()

    equations = problem.equations
    misfit = QuadraticMisfit(*relative(equations.gram, equations.moment), equations.square)
    mass_hessian, mass_pull = relative(*problem.data_terms(0.0))
    precision = relative_precision(problem).cpu().numpy()
    return BoundedTask(problem, spectrum, budget, options, misfit, precision, mass_hessian, mass_pull)


def secular_multiplier(spectrum: Spectrum, budget: float) -> float:
    """The mu at which the problem without cones meets the budget with equality; 0 where it is met anyway."""

    def excess(log_mu: float) -> float:
        return float(np.log(spectrum.residual(spectrum.solve(np.exp(log_mu), 1.0)) / budget))

    low, high = (-np.log(budget) + side * _DECADES for side in (-1.0, 1.0))
    if excess(low) <= 0:
        return 0.0
    if excess(high) >= 0:
        return float(np.exp(high))
    root = brentq(excess, low, high)
    assert isinstance(root, float)
    return float(np.exp(root))


def scale(task: BoundedTask) -> ScaledProgram | None:
    """The program around the optimum without cones; None when even the best parameters miss the budget."""
    problem, spectrum, misfit = task.problem, task.spectrum, task.misfit
    mu = secular_multiplier(spectrum, task.budget)
    centre = task.relative(spectrum.params(spectrum.solve(mu, 1.0)) if mu > 0 else problem.mean)
    rotate = unit_axes(mu * misfit.hessian + task.precision + task.mass_hessian)
    values, axes = np.linalg.eigh(rotate.T @ misfit.hessian @ rotate)
    solid = values > _NULL * max(float(values[-1]), np.finfo(float).tiny)
    gain = np.sqrt(values[solid])
    target = -(axes[:, solid].T @ (rotate.T @ misfit.slope(centre))) / (2 * gain)
    room = float(target @ target) - misfit.excess(centre, task.budget)
    return ScaledProgram(centre, rotate, gain[:, None] * axes[:, solid].T, target, room**0.5, mu) if room > 0 else None
