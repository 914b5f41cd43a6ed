"""Other bodies that the same session would allow: geometry by its posterior, skin, and inertia as it follows from both.

The inertia's own posterior holds geometry and skin still. Its rows are made anew with every draw, and the Gaussian fit
repeated on them; so a drawn body is one that markers and plates agree with as well as with the one published.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.whitening import accumulate, spectra
from torchid.geometry.result import GeometryFit
from torchid.inertia.fit import InertiaFit
from torchid.inertia.identify import Identified
from torchid.inertia.spectrum import diagonalise
from torchid.model.model import Geometry
from torchid.torque.seen import SeenTrial, by_body, shifted
from torchid.torque.skin import SkinDraws, draw_skin


@dataclass(frozen=True)
class BodyDraws:
    """Bodies drawn about the one that was identified."""

    xi: Float[Tensor, "draws xi"]
    """Geometry and marker places [m, rad]."""
    skin: SkinDraws
    phi: Float[Tensor, "draws bodies 10"]
    """Inertial parameters [kg, kg m, kg m^2]; Gaussian, without the bounds of what is physical."""


def draw_bodies(
    fit: GeometryFit,
    identified: Identified | None,
    phi: Float[Tensor, "bodies 10"],
    trials: Sequence[SeenTrial],
    count: int,
    generator: torch.Generator,
    mass: tuple[float, float] | None = None,
) -> BodyDraws:
    """Draw bodies from what is known of geometry and inertia together.

    Args:
        fit: geometry with its uncertainty; without one all draws have the fit's.
        identified: inertia with its covariance; None: it is taken as known.
        phi: inertia that is published.
        trials: all that anything is asked of; those that the inertia was identified on have rows.
        mass: total mass and its standard deviation [kg] that the inertial fit held to.
    """
    xi = fit.xi.expand(count, -1) + _normal(
        None if fit.uncertainty is None else fit.uncertainty.covariance, fit.xi, count, generator
    )
    skin = draw_skin(trials, count, generator)
    if identified is None:
        return BodyDraws(xi, skin, phi.expand(count, *phi.shape))
    own = _normal(identified.fit.covariance, phi, count, generator).view(count, *phi.shape)
    fitted = [trial for trial in trials if trial.rows is not None]
    moved = _inertia_of(fit, identified, fitted, xi, skin, mass) if fitted else torch.zeros_like(own)
    return BodyDraws(xi, skin, phi + own + moved)


def _normal(covariance: Tensor | None, like: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Draws (count, n) of zero mean and this covariance, which may be singular."""
    if covariance is None:
        return like.new_zeros(count, like.numel())
    value, vector = torch.linalg.eigh(covariance)
    white = torch.randn(count, len(value), generator=generator, dtype=torch.float64).to(covariance)
    return white @ (vector * value.clamp(min=0.0).sqrt()).mT


def _inertia_of(
    fit: GeometryFit,
    identified: Identified,
    trials: Sequence[SeenTrial],
    xi: Float[Tensor, "draws xi"],
    skin: SkinDraws,
    mass: tuple[float, float] | None,
) -> Float[Tensor, "draws bodies 10"]:
    """How far the inertia moves with each geometry and skin."""
    each = [list(_equations(trial, fit, identified, xi, skin)) for trial in trials]
    first, *others = (_solved(reduce(add, own), identified.fit, mass) for own in zip(*each, strict=True))
    return torch.stack([one - first for one in others])


def _equations(
    trial: SeenTrial, fit: GeometryFit, identified: Identified, xi: Float[Tensor, "draws xi"], skin: SkinDraws
) -> Iterator[NormalEquations]:
    """Whitened sums of a trial with the fit's geometry, then with each draw of geometry and skin."""
    assert trial.rows is not None, "only trials with rows tell of the inertia"
    yield accumulate(spectra(trial.rows), identified.whitening)
    for one, by in zip(xi, by_body(trial, fit, list(xi), skin.shift(trial)), strict=True):
        geometry = geometry_of(fit, one)
        rows = replace(trial.rows, geometry=geometry, motion=shifted(trial.rows.motion, by))
        yield accumulate(spectra(rows), identified.whitening)


def geometry_of(fit: GeometryFit, xi: Float[Tensor, " xi"]) -> Geometry:
    """Return the geometry that an entry of ``BodyDraws.xi`` stands for."""
    return replace(fit, xi=xi).geometry


def _solved(equations: NormalEquations, fit: InertiaFit, mass: tuple[float, float] | None) -> Tensor:
    """Mean of the Gaussian problem under the weights of the fit, without the LMI."""
    prior = fit.prior
    spectrum = diagonalise(equations, prior.mean.reshape(-1), prior.covariance, mass)
    return spectrum.params(spectrum.solve(fit.omega_1, fit.omega_2)).view_as(prior.mean)
