"""A subject's model: tree, geometry, inertia, and the priors that say how well each is known before any motion."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.model.opensim.binding import OsimBinding
from torchid.model.tree import Tree


@dataclass(frozen=True)
class Geometry:
    """The numbers of a tree: where joints sit and how hinge axes lean."""

    offset: Float[Tensor, "bodies 3"]
    """p_PJ_P: proximal joint centre of each body from its parent's origin, in the parent's axes [m]; root: zeros."""
    hinge: Float[Tensor, " hinges"]
    """Hinge angles [rad]."""


@dataclass(frozen=True)
class GeometryPrior:
    """Named geometric parameters xi and the linear map that makes a ``Geometry`` of them.

    With raw = (offset row by row, hinge): raw = constant + map @ xi. Left/right ties and grouped bones are columns of
    ``map`` that move several raw entries.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    mean: Float[Tensor, " params"]
    sd: Float[Tensor, " params"]
    map: Float[Tensor, "raw params"]
    constant: Float[Tensor, " raw"]
    n_hinges: int = 0

    def geometry(self, xi: Float[Tensor, " params"]) -> Geometry:
        """Geometry at ``xi``."""
        raw = self.constant + self.map @ xi
        return Geometry(offset=raw[: self.n_offset].reshape(-1, 3), hinge=raw[self.n_offset :])

    @property
    def n_offset(self) -> int:
        """Raw entries that are offsets (three per body)."""
        return len(self.constant) - self.n_hinges


@dataclass(frozen=True)
class InertialPrior:
    """Ten inertial parameters per body before any force is seen (order of ``conventions.Inertial``)."""

    mean: Float[Tensor, "bodies 10"]
    covariance: Float[Tensor, "params params"]
    """Of the flattened mean (10 * bodies); holds the correlation that a common scale (mass, height) makes."""


@dataclass(frozen=True)
class Landmark:
    """A bony point and where it lies on its segment."""

    segment: str
    p_BM_B: tuple[float, float, float]
    """Mean place in the scaled template [m]."""
    sd: tuple[float, float, float]
    """Scatter between subjects and between palpations [m]."""


@dataclass(frozen=True)
class Model:
    """What is known of a body before it moves."""

    tree: Tree
    geometry: GeometryPrior
    inertia: InertialPrior
    landmarks: dict[str, Landmark]
    height: float
    """Stature the template was scaled to [m]."""
    sources: tuple[str, ...] = ()
    """Where the numbers come from."""
    build: tuple[str, ...] = ()
    """What tables of adults were changed for; empty for an adult of medium build, and for a model from a file."""
    osim: OsimBinding | None = None
    """The OpenSim model that it was made of, in whose coordinates results are written; None for any other."""
    of_stature: bool = True
    """Whether the stature is the person's; else it is the mean of adults."""
