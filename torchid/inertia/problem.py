"""What is asked of the inertial fit: equations, prior and constraints, checked and in one form."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError
from torchid.inertia import entropic
from torchid.inertia.linear import box_rows, ellipsoid_rows, total_mass_row
from torchid.inertia.options import IdentifyOptions
from torchid.model.model import InertialPrior
from torchid.model.pseudo import params_to_pseudo, relative_map


@dataclass(frozen=True)
class Problem:
    """The fit in its own units, before weights are chosen."""

    equations: NormalEquations
    mean: Float[Tensor, " params"]
    covariance: Float[Tensor, "params params"]
    T: Float[Tensor, "bodies 10 10"]
    mass: tuple[float, float] | None
    """Total mass and its standard deviation, weighed like a measurement."""
    exact_mass: float | None
    """Total mass that holds with equality."""
    inequality: Float[Tensor, "inequalities params"]
    """Rows C with C phi >= 0: centre-of-mass boxes, then ellipsoids."""
    divergence: Float[Tensor, " bodies"] | None
    """Weights of the entropic prior, or None for the quadratic one."""

    def data_terms(self, omega_1: float) -> tuple[Float[Tensor, "params params"], Float[Tensor, " params"]]:
        """Half the Hessian and half the slope of everything but the prior."""
        gram, moment = omega_1 * self.equations.gram, omega_1 * self.equations.moment
        if self.mass is not None:
            row = self.mass_row / self.mass[1]
            gram, moment = gram + torch.outer(row, row), moment + self.mass[0] / self.mass[1] * row
        return gram, moment

    def params(self, x: Float[np.ndarray, " params"]) -> Float[Tensor, "bodies 10"]:
        """Inertial parameters of relative ones."""
        return (self.T @ self.mean.new_tensor(x).reshape(-1, 10, 1)).squeeze(-1)

    @property
    def mass_row(self) -> Float[Tensor, " params"]:
        """Row whose product with the parameters is the total mass."""
        return total_mass_row(len(self.T), self.mean)

    @property
    def equality(self) -> tuple[Float[Tensor, "equalities params"], Float[Tensor, " equalities"]]:
        """Rows E and values e with E phi = e."""
        rows, value = self.mass_row[None], self.mean.new_tensor([self.exact_mass or 0.0])
        return (rows[:0], value[:0]) if self.exact_mass is None else (rows, value)


def pose(
    equations: NormalEquations,
    prior: InertialPrior,
    names: tuple[str, ...],
    options: IdentifyOptions,
    mass: tuple[float, float] | None,
    com_box: Tensor | None,
    *,
    exact_mass: float | None = None,
    ellipsoids: Tensor | None = None,
) -> Problem:
    """Check the inputs and put them in the form the passes below share.

    Args:
        equations, prior, names, options, mass, com_box: as for ``fit_inertia``.
        exact_mass: total mass that holds with equality [kg].
        ellipsoids: matrix Q of each body's bounding ellipsoid, checked (see ``linear``).
    """
    params = 10 * len(names)
    shapes = {"prior mean": prior.mean.numel(), "Gram matrix": len(equations.gram), "prior": len(prior.covariance)}
    for what, found in shapes.items():
        if found != params:
            raise ConfigError(
                "inertia.shape", f"{what} does not fit {len(names)} bodies", found=f"{found} of {params}",
                remedy="Give ten parameters a body, in the order of names",
            )  # fmt: skip
    equations.check()
    if not bool((torch.linalg.eigvalsh(params_to_pseudo(prior.mean.nan_to_num())) > 0).all()):
        raise ConfigError(
            "prior.not_physical", "the prior mean of a body is no physical inertia",
            remedy="Give each body a positive mass and an inertia that some distribution of mass has",
        )  # fmt: skip
    if mass is not None and not (mass[0] > 0 and 0 < mass[1] < float("inf")):
        raise ConfigError(
            "inertia.mass", "total mass needs a value and a standard deviation above 0", found=f"{mass}",
            remedy="Give (value, standard deviation) in kg, or None",
        )  # fmt: skip
    T, covariance, weights = relative_map(prior.mean), prior.covariance, None
    if options.prior == "entropic":
        weights = entropic.body_weights(covariance, T)
        covariance = entropic.curvature_covariance(weights, T)
    rows = [box_rows(com_box, len(names), prior.mean), ellipsoid_rows(ellipsoids, len(names), prior.mean)]
    return Problem(equations, prior.mean.flatten(), covariance, T, mass, exact_mass, torch.cat(rows), weights)
