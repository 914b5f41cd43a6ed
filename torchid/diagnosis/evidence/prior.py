"""The Gaussian prior of all parameters, and the coordinates in which it is a unit normal."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.statistics import TrialStatistics
from torchid.model.model import InertialPrior
from torchid.observation.statements import Statements


@dataclass(frozen=True)
class Prior:
    """Normal prior theta = mean + factor z with z unit normal; the factor is that of the inertia beside a diagonal."""

    mean: Float[Tensor, " all"]
    """Mean of theta."""
    inertia: Float[Tensor, "params params"]
    """Lower Cholesky factor of the covariance of the inertial parameters."""
    scale: Float[Tensor, " more"]
    """Standard deviations of all other parameters."""

    def standard(
        self, gram: Float[Tensor, "live live"], moment: Float[Tensor, " live"], live: Int[Tensor, " live"]
    ) -> TrialStatistics:
        """Return statistics of theta in terms of z.

        Args:
            gram: Gram matrix of theta's columns.
            moment: moment of theta's columns.
            live: columns of the design that they are.
        """
        n, L = len(self.inertia), len(live)
        scale, left = self.scale[live[n:] - n], moment - gram @ self.mean[live]
        both = gram.new_zeros(L + 1, L + 1)
        both[n:L, n:L] = (scale[:, None] * gram[n:, n:]).mul_(scale)
        both[:n, :n] = self.inertia.T @ gram[:n, :n] @ self.inertia
        both[:n, n:L] = (self.inertia.T @ gram[:n, n:]).mul_(scale)
        both[n:L, :n] = both[:n, n:L].T
        return TrialStatistics(live, both, torch.cat([self.inertia.T @ left[:n], scale * left[n:], left.new_zeros(1)]))

    def standard_statements(self, stated: Statements) -> Statements:
        """Return statements in terms of z; they are of columns behind the inertia's.

        Args:
            stated: of a trial, in terms of theta.
        """
        scale, left = self.scale[stated.columns - len(self.inertia)], stated.gram @ self.mean[stated.columns]
        return Statements(stated.columns, scale[:, None] * stated.gram * scale, scale * (stated.moment - left))

    def for_design(self, design: Design) -> "Prior":
        """Return the prior with the same inertia, for another design.

        Args:
            design: the other design.
        """
        n = len(self.inertia)
        return Prior(torch.cat([self.mean[:n], design.mean.to(self.mean)]), self.inertia, design.scale.to(self.mean))

    def theta(self, z: Float[Tensor, " all"]) -> Float[Tensor, " all"]:
        """Return the parameters theta.

        Args:
            z: coordinates in which the prior is a unit normal.
        """
        n = len(self.inertia)
        return self.mean + torch.cat([self.inertia @ z[:n], self.scale * z[n:]])


def make_prior(inertia: InertialPrior, omega: float, design: Design) -> Prior:
    """Return the prior of all columns of a design.

    Args:
        inertia: prior of the inertial parameters.
        omega: weight of that prior, as in the inertial fit.
        design: the design.
    """
    factor = torch.linalg.cholesky(inertia.covariance / omega)
    scale = design.scale.to(factor)
    return Prior(torch.cat([inertia.mean.reshape(-1), design.mean.to(factor)]), factor, scale)
