"""Evidence of models that are linear in inertia, nuisances and effects, all integrated out.

In coordinates in which every prior is a unit normal, a model with columns I has log evidence (up to what all models
share) b' L^-1 b / 2 - log det L / 2 with L = G_II + 1. A candidate's gain over a base follows from the Schur
complement of the base: one factorisation serves the whole catalogue.

Reference: MacKay, Neural Computation 4 (1992), on evidence; Chib, JASA 90 (1995), on its chain rule over trials.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates import Candidate, Design
from torchid.model.model import InertialPrior
from torchid.regressor.equations import NormalEquations


@dataclass(frozen=True)
class Prior:
    """theta = mean + factor z with z unit normal."""

    mean: Float[Tensor, " all"]
    inertia: Float[Tensor, "params params"]
    """Lower Cholesky factor of the inertial parameters."""
    scale: Float[Tensor, " more"]

    def standard(self, sums: NormalEquations) -> tuple[Float[Tensor, "all all"], Float[Tensor, " all"]]:
        """Gram matrix and moment of z."""
        n = len(self.inertia)

        def turned(x: Tensor) -> Tensor:
            return torch.cat([self.inertia.T @ x[:n], self.scale.reshape(-1, *[1] * (x.dim() - 1)) * x[n:]])

        moment = turned(sums.moment - sums.gram @ self.mean)
        return turned(turned(sums.gram).T.contiguous()), moment

    def theta(self, z: Float[Tensor, " all"]) -> Float[Tensor, " all"]:
        """Back to the parameters."""
        n = len(self.inertia)
        return self.mean + torch.cat([self.inertia @ z[:n], self.scale * z[n:]])


def make_prior(inertia: InertialPrior, omega: float, design: Design) -> Prior:
    """Of all columns of a design; ``omega`` weighs the inertial prior as the inertial fit did."""
    factor = torch.linalg.cholesky(inertia.covariance / omega)
    mean = torch.cat([inertia.mean.reshape(-1), torch.zeros_like(design.scale)])
    return Prior(mean, factor, design.scale)


@dataclass(frozen=True)
class Fitted:
    """Posterior of one model: columns, factor of L, whitened moment, mean of z."""

    columns: Tensor
    factor: Float[Tensor, "n n"]
    whitened: Float[Tensor, " n"]

    @property
    def log_evidence(self) -> float:
        """Up to what all models of the same rows share."""
        return float(0.5 * self.whitened @ self.whitened - self.factor.diagonal().log().sum())

    @property
    def mean(self) -> Float[Tensor, " n"]:
        """Of z."""
        return torch.linalg.solve_triangular(self.factor.T, self.whitened[:, None], upper=True)[:, 0]

    @property
    def covariance(self) -> Float[Tensor, "n n"]:
        """Of z."""
        return torch.cholesky_inverse(self.factor)


def fit(standard: tuple[Tensor, Tensor], columns: Tensor) -> Fitted:
    """The model with these columns."""
    gram, moment = standard
    own = gram[columns][:, columns]
    factor = torch.linalg.cholesky(own + torch.eye(len(columns)).to(own))
    return Fitted(columns, factor, torch.linalg.solve_triangular(factor, moment[columns, None], upper=False)[:, 0])


def gains(
    standard: tuple[Tensor, Tensor], base: Fitted, candidates: Sequence[Candidate]
) -> Float[Tensor, " candidates"]:
    """Log evidence that each candidate alone would add to a base."""
    gram, moment = standard
    shared = torch.linalg.solve_triangular(base.factor, gram[base.columns], upper=False)
    left = moment - shared.T @ base.whitened
    found = moment.new_empty(len(candidates))
    sizes = {c.effect.size for c in candidates}
    for size in sizes:
        rows = [k for k, c in enumerate(candidates) if c.effect.size == size]
        index = torch.tensor([range(candidates[k].columns.start, candidates[k].columns.stop) for k in rows])
        own, part = gram[index[:, :, None], index[:, None, :]], shared[:, index].permute(1, 2, 0)
        L = torch.linalg.cholesky(own - part @ part.mT + torch.eye(size).to(own))
        u = torch.linalg.solve_triangular(L, left[index][..., None], upper=False)[..., 0]
        gain = 0.5 * u.square().sum(1) - L.diagonal(dim1=1, dim2=2).log().sum(1)
        # A parameter known to be positive has half the prior space: twice the density, and only its upper side counts.
        first = torch.linalg.solve_triangular(L.mT, u[..., None], upper=True)[:, 0, 0]
        upper = math.log(2.0) + torch.special.log_ndtr(first / torch.cholesky_inverse(L)[:, 0, 0].sqrt())
        positive = torch.tensor([candidates[k].effect.parameters[0].positive for k in rows])
        found[rows] = torch.where(positive, gain + upper, gain)
    return found
