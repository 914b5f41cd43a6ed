"""What the geometric fit knows of a subject: free parameters, where the markers sit, and how far they scatter."""

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
    """A subject's geometry and everything needed to track their markers."""

    model: Model
    attachment: Attachment
    prior: GeometryPrior
    """Of the parameters that were free (ties and groups applied)."""
    xi: Float[Tensor, " xi"]
    """Named parameters, then marker places."""
    sigma: Float[Tensor, " markers"]
    """Residual scatter per coordinate [m]."""
    options: GeometryOptions
    uncertainty: GeometryUncertainty | None = None
    solution: Solution | None = None
    notes: tuple[Note, ...] = ()

    @property
    def geometry(self) -> Geometry:
        """Offsets and hinge angles."""
        return self.prior.geometry(self.xi[: len(self.prior.mean)])

    @property
    def place(self) -> Float[Tensor, "markers 3"]:
        """p_BM_B of all markers [m]."""
        return self.xi[len(self.prior.mean) :].reshape(-1, 3)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all entries of xi."""
        return self.prior.names + tuple(f"{label}_{axis}" for label in self.attachment.labels for axis in "xyz")


def parameters(model: Model, options: GeometryOptions) -> GeometryPrior:
    """Free geometric parameters under the ties and groups of the options."""
    prior = tie_sides(model.geometry) if options.symmetry == "tied" else model.geometry
    for name, members in options.groups.items():
        prior = group(prior, tuple(members), name)
    return prior


def fixed(prior: GeometryPrior) -> GeometryPrior:
    """The same geometry with nothing free, at its mean."""
    constant = prior.constant + prior.map @ prior.mean
    none = prior.mean[:0]
    return GeometryPrior((), (), none, none, prior.map[:, :0], constant, prior.n_hinges)
