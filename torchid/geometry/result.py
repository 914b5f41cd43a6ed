"""This module is what the geometric fit hands on: free parameters, places of the markers, and how far they scatter."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.errors import Note
from torchid.geometry.arrow.solver import Solution
from torchid.geometry.attachment import Attachment
from torchid.geometry.options import GeometryOptions
from torchid.geometry.uncertainty import GeometryUncertainty
from torchid.model.geometry_prior import group, tie_sides
from torchid.model.model import Geometry, GeometryPrior, Model


@dataclass(frozen=True)
class GeometryFit:
    """The geometry of a subject, with everything that is needed to track the markers."""

    model: Model
    attachment: Attachment
    prior: GeometryPrior
    """Prior of the parameters that were free, ties and groups applied."""
    xi: Float[Tensor, " xi"]
    """Named parameters, then the places of all markers."""
    sigma: Float[Tensor, " markers"]
    """Residual scatter per coordinate [m]."""
    options: GeometryOptions
    uncertainty: GeometryUncertainty | None = None
    """Posterior of xi; None before the joint fit."""
    solution: Solution | None = None
    """End of the joint fit; None before it."""
    notes: tuple[Note, ...] = ()

    @property
    def geometry(self) -> Geometry:
        """Return the offsets and hinge angles at xi."""
        return self.prior.geometry(self.xi[: len(self.prior.mean)])

    @property
    def place(self) -> Float[Tensor, "markers 3"]:
        """Return the places p_BM_B of all markers [m]."""
        return self.xi[len(self.prior.mean) :].reshape(-1, 3)

    @property
    def places(self) -> dict[str, tuple[str, tuple[float, float, float]]]:
        """Return the body of every marker by name, and the marker's place p_BM_B on it [m]."""
        found = zip(self.attachment.labels, self.attachment.body.tolist(), self.place.tolist(), strict=True)
        return {label: (self.model.tree.names[body], (x, y, z)) for label, body, (x, y, z) in found}

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all entries of xi, those of places as ``<label>_<axis>``."""
        return self.prior.names + tuple(f"{label}_{axis}" for label in self.attachment.labels for axis in "xyz")


def parameters(model: Model, options: GeometryOptions) -> GeometryPrior:
    """Return the prior of the free geometric parameters under the ties and groups of the options.

    Raises:
        ConfigError: ``geometry.group``, when the options name a group of parameters that cannot be one.
    """
    prior = tie_sides(model.geometry) if options.symmetry == "tied" else model.geometry
    for name, members in options.groups.items():
        prior = group(prior, tuple(members), name)
    return prior


def fixed(prior: GeometryPrior) -> GeometryPrior:
    """Return the prior of the same geometry with nothing free, at its mean."""
    constant = prior.constant + prior.map @ prior.mean
    none = prior.mean[:0]
    return GeometryPrior((), (), none, none, prior.map[:, :0], constant, prior.n_hinges)
