"""What is known of a device and of the body that wears it after recordings."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.devices.device import Device
from torchid.dynamics.whitening import Whitening


@dataclass(frozen=True)
class BodyBelief:
    """Inertia of the bare body as trials without the device told it."""

    phi: Float[Tensor, "bodies 10"]
    covariance: Float[Tensor, "params params"]
    """Of the flattened ``phi``."""


@dataclass(frozen=True)
class Determined:
    """A number that the recordings tell."""

    value: float
    sd: float

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval."""
        return self.value - 1.96 * self.sd, self.value + 1.96 * self.sd


@dataclass(frozen=True)
class NotDeterminable:
    """A number that these recordings cannot tell."""

    why: str


@dataclass(frozen=True)
class IdentifiedDevice:
    """A device with what recordings with and without it tell."""

    device: Device
    """The sheet with every number that was determined filled in; others stay unknown."""
    parameters: dict[str, Determined | NotDeterminable]
    """By key with unit, as in ``thigh_l.mass_kg``, ``thigh_l.com_x_m``, ``hip_l.stiffness_Nm_rad``; ``mass_kg`` is the
    mass of all parts."""
    body: BodyBelief
    """The bare body after both kinds of trials."""
    parts: Float[Tensor, "parts 10"]
    """Inertial parameters of the parts about their segments' origins."""
    parts_covariance: Float[Tensor, "scattered scattered"]
    """Of the flattened ``parts``, with what plates may err by."""
    parts_body: tuple[int, ...]
    """Index of the segment of each part."""
    phi_on: Float[Tensor, "bodies 10"]
    """The body with the device's parts on it."""
    covariance: Float[Tensor, "params params"]
    """Of the flattened ``phi_on``."""
    correlation: dict[str, Float[Tensor, "own own"]]
    """Covariance of the determined parameters of each element, in the order of ``covariance_keys``."""
    covariance_keys: dict[str, tuple[str, ...]]
    """Parameters of each element that ``correlation`` holds, by name without unit."""
    whitening: Whitening | None
    """Noise of the rows of the trials with the device; None without trials."""
