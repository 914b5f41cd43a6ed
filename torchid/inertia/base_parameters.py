"""Base parameters: the combinations of inertial parameters that the data determine, and no others.

Columns of the regressor that depend on earlier ones are regrouped: with unit columns and a pivoted QR factorisation
Y Pi = Q [R1 R2], the base parameters are phi_1 + R1^-1 R2 phi_2 (Gautier, J. Robotic Systems 8(4), 1991).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.conventions import INERTIAL_NAMES
from torchid.dynamics.row_equations import NormalEquations
from torchid.inertia.spectrum import cholesky

_SHOWN = 8
_NEGLIGIBLE = 1e-3
"""Terms whose normalised coefficient is smaller are left out of the name (never of the matrix)."""


@dataclass(frozen=True)
class Structure:
    """Gram matrix with unit columns, factorised."""

    norm: Float[Tensor, " params"]
    """Length of each column of the regressor; 0 where the data do not touch the parameter."""
    root: Float[Tensor, "rank params"]
    """S with S' S the Gram matrix of unit columns, null directions left out."""
    condition: float
    """Largest over smallest singular value kept; inf when nothing is."""

    @property
    def rank(self) -> int:
        """Number of independent columns."""
        return len(self.root)


@dataclass(frozen=True)
class BaseParameters:
    """Identifiable combinations ``matrix @ phi``; Y phi equals Y[:, independent] @ (matrix @ phi)."""

    matrix: Float[Tensor, "rank params"]
    independent: Int[Tensor, " rank"]
    """The parameter that stands for each combination, with coefficient 1 and its unit."""
    value: Float[Tensor, " rank"]
    sd: Float[Tensor, " rank"]
    weight: Float[Tensor, "rank params"]
    """``matrix`` for columns of unit length: how much each parameter matters in the data."""
    bodies: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Such as ``mc_z(shank_l) + 0.41*m(foot_l)``, terms of larger weight first."""
        parameters = [f"{parameter}({body})" for body in self.bodies for parameter in INERTIAL_NAMES]
        rows, weight = self.matrix.cpu().numpy(), self.weight.cpu().numpy()
        leads = self.independent.tolist()
        return tuple(_name(weight[k], rows[k], lead, parameters) for k, lead in enumerate(leads))

    def under(self, covariance: Float[Tensor, "params params"]) -> "BaseParameters":
        """The same with the standard deviations of another covariance of the parameters."""
        return replace(self, sd=_deviations(self.matrix, covariance))

    def project(self, phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, " rank"]:
        """Base parameters of ``phi``."""
        return self.matrix @ phi.flatten()

    def distance(
        self,
        phi: Float[Tensor, "bodies 10"],
        other: Float[Tensor, "bodies 10"],
        covariance: Float[Tensor, "params params"],
    ) -> float:
        """Root mean square difference of base parameters in standard deviations of ``covariance`` (Mahalanobis)."""
        factor = cholesky(self.matrix @ covariance @ self.matrix.mT)
        difference = (self.project(phi) - self.project(other))[:, None]
        return float(torch.linalg.solve_triangular(factor, difference, upper=False).square().mean().sqrt())


def structure(equations: NormalEquations, tolerance: float) -> Structure:
    """Rank and condition of the data; singular values below ``tolerance`` times the largest count as zero.

    The Gram matrix holds squares of singular values, so nothing below 1e-7 can be told from rounding.
    """
    norm, values, vectors = equations.unit_spectrum
    singular = values.clamp_min(0).sqrt()
    kept = (singular > tolerance * singular[-1]) & (singular > 0)
    condition = float(singular[-1] / singular[kept].min()) if bool(kept.any()) else float("inf")
    return Structure(norm, singular[kept, None] * vectors[:, kept].mT, condition)


def _deviations(
    matrix: Float[Tensor, "rank params"], covariance: Float[Tensor, "params params"]
) -> Float[Tensor, " rank"]:
    """Standard deviations of combinations of the parameters."""
    return ((matrix @ covariance) * matrix).sum(-1).clamp_min(0).sqrt()


def base_parameters(
    data: Structure, names: tuple[str, ...], phi: Float[Tensor, "bodies 10"], covariance: Float[Tensor, "params params"]
) -> BaseParameters:
    """Identifiable combinations of the data with the fit's values and standard deviations.

    Args:
        data: from ``structure``, rank at least 1.
        names: of the bodies.
        phi, covariance: of the fit.
    """
    factors = scipy.linalg.qr(data.root.cpu().numpy(), mode="r", pivoting=True)
    R, order = np.asarray(factors[0]), np.asarray(factors[-1])
    rank = data.rank
    unit = np.zeros((rank, len(order)))
    unit[:, order[:rank]] = np.eye(rank)
    unit[:, order[rank:]] = scipy.linalg.solve_triangular(R[:, :rank], R[:, rank:])
    rising = np.argsort(order[:rank])
    independent, unit = order[:rank][rising], unit[rising]
    norm = data.norm.cpu().numpy()
    matrix = phi.new_tensor(unit * norm / norm[independent, None])
    chosen = torch.as_tensor(independent.astype(np.int64), device=phi.device)
    value = matrix @ phi.flatten()
    return BaseParameters(matrix, chosen, value, _deviations(matrix, covariance), phi.new_tensor(unit), names)


def _name(unit: np.ndarray, row: np.ndarray, lead: int, parameters: list[str]) -> str:
    """Name of one combination."""
    others = np.flatnonzero(np.abs(unit) > _NEGLIGIBLE)
    others = others[others != lead]
    others = others[np.argsort(-np.abs(unit[others]), kind="stable")]
    terms = [f" {'-' if row[i] < 0 else '+'} {abs(row[i]):.3g}*{parameters[i]}" for i in others[:_SHOWN]]
    return parameters[lead] + "".join(terms) + (f" + {len(others) - _SHOWN} more" if len(others) > _SHOWN else "")
