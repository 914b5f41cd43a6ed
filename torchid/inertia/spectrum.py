"""Data and prior in the axes in which both are diagonal, where every weight costs O(n) instead of O(n^3).

With Sigma = L L' the prior's covariance and L' G L = U diag(gain) U', the substitution phi = mean + (L U) w turns the
objective into

    omega_1 (gain . w^2 - 2 pull . w + square) + omega_2 w . w + (lever . w - miss)^2,

the last term being a weighed total mass: a rank-one update, handled by Sherman-Morrison.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import Inertial
from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError

Vector = Float[np.ndarray, " params"]
SIGNAL_TO_NOISE = 3e5
"""Largest believed ratio of the norm of all wrenches to the noise of one row (an hour of gait reaches 1e5).

A Gram matrix holds 1e-16 of its scale: at a ratio of 1e6, noise-free data, its rounding alone moves the solution along
the directions that the data do not determine by 1e-6 standard deviations, the limit of the certificate.
"""


@dataclass(frozen=True)
class Spectrum:
    """The Gaussian problem (no LMI) after diagonalisation."""

    mean: Float[Tensor, " params"]
    basis: Float[Tensor, "params params"]
    """L U: phi = mean + basis @ w."""
    gain: Float[np.ndarray, " params"]
    """Information of the data along each axis relative to the prior's. NumPy: short vectors, looked at often."""
    pull: Float[np.ndarray, " params"]
    square: float
    """Squared residual at the prior mean."""
    smallest: float
    """Squared residual below which everything is rounding."""
    rows: int | float
    lever: Float[np.ndarray, " params"]
    """Total mass along each axis, over its standard deviation; zeros when the mass is not given."""
    miss: float
    """(given mass - prior mass) over its standard deviation."""

    def residual(self, w: Vector) -> float:
        """||Y phi - F||^2 at w."""
        return max(float(self.square - 2 * self.pull @ w + self.gain @ (w * w)), self.smallest)

    def precision(self, omega_1: float, omega_2: float) -> tuple[Vector, float]:
        """Diagonal d of the Hessian and the denominator 1 + lever' d^-1 lever of its rank-one update."""
        diagonal = omega_1 * self.gain + omega_2
        return diagonal, 1 + float(self.lever @ (self.lever / diagonal))

    def solve(self, omega_1: float, omega_2: float) -> Vector:
        """Minimiser w of the objective."""
        diagonal, denominator = self.precision(omega_1, omega_2)
        w = (omega_1 * self.pull + self.miss * self.lever) / diagonal
        return w - self.lever / diagonal * (float(self.lever @ w) / denominator)

    def params(self, w: Vector) -> Float[Tensor, " params"]:
        """Inertial parameters at w."""
        return self.mean + self.basis @ self.mean.new_tensor(w)

    def covariance(self, omega_1: float, omega_2: float) -> Float[Tensor, "params params"]:
        """Covariance of the parameters given data, prior and mass."""
        diagonal, denominator = self.precision(omega_1, omega_2)
        mass = self.basis @ self.mean.new_tensor(self.lever / diagonal)
        return (self.basis / self.mean.new_tensor(diagonal)) @ self.basis.mT - torch.outer(mass, mass) / denominator

    def inverse_diagonal(self, omega_1: float, omega_2: float) -> Vector:
        """Diagonal of the inverse Hessian in the axes w."""
        diagonal, denominator = self.precision(omega_1, omega_2)
        return 1 / diagonal - (self.lever / diagonal) ** 2 / denominator


def cholesky(covariance: Float[Tensor, "params params"]) -> Float[Tensor, "params params"]:
    """Factor of a prior covariance; ConfigError when it is not positive definite after scaling to unit diagonal."""
    sd = covariance.diagonal().clamp_min(0).sqrt()
    if bool(torch.isfinite(covariance).all()) and bool((sd > 0).all()):
        factor, info = torch.linalg.cholesky_ex(covariance / sd[:, None] / sd)
        if int(info) == 0:
            return sd[:, None] * factor
    raise ConfigError(
        "prior.covariance", "the prior covariance of the inertial parameters is not positive definite",
        remedy="Give every parameter a standard deviation above zero and no two a correlation of one",
    )  # fmt: skip


def total_mass(basis: Float[Tensor, "params params"]) -> Vector:
    """Total mass along each axis of ``basis`` [kg]."""
    return basis[Inertial.M :: len(Inertial)].sum(0).cpu().numpy()


def diagonalise(
    equations: NormalEquations,
    mean: Float[Tensor, " params"],
    covariance: Float[Tensor, "params params"],
    mass: tuple[float, float] | None,
) -> Spectrum:
    """Bring data and prior to common axes.

    Args:
        equations: whitened sums, checked.
        mean, covariance: of the prior, flattened.
        mass: total mass and its standard deviation [kg], or None.
    """
    factor = cholesky(covariance)
    inner = factor.mT @ equations.gram @ factor
    gain, axes = torch.linalg.eigh(0.5 * (inner + inner.mT))
    basis = factor @ axes
    lever, miss = np.zeros(len(mean)), 0.0
    if mass is not None:
        lever = total_mass(basis) / mass[1]
        miss = (mass[0] - float(mean[Inertial.M :: len(Inertial)].sum())) / mass[1]
    return Spectrum(
        mean=mean,
        basis=basis,
        gain=gain.clamp_min(0).cpu().numpy(),
        pull=(basis.mT @ (equations.moment - equations.gram @ mean)).cpu().numpy(),
        square=equations.residual_square(mean),
        smallest=equations.rows / SIGNAL_TO_NOISE**2 * max(float(mean @ equations.gram @ mean), equations.square),
        rows=equations.rows,
        lever=lever,
        miss=miss,
    )
