"""What is known of a device and of the body that wears it after recordings, and draws of both for bands."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.devices.device import Device, SheetValue
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


def device_draws(found: IdentifiedDevice, count: int, seed: int) -> tuple[Device, ...]:
    """Draw devices from the posterior of their elements' numbers; numbers of one element keep their correlation.

    Returns:
        Devices that differ in their determined numbers alone; stiffness, damping and free play are never negative.
    """
    generator = torch.Generator().manual_seed(seed)
    moves = {}
    for name, covariance in found.correlation.items():
        values, vectors = torch.linalg.eigh(covariance.cpu())
        unit = torch.randn(count, len(values), generator=generator, dtype=values.dtype)
        moves[name] = (unit * values.clamp_min(0.0).sqrt()) @ vectors.T

    def drawn(k: int) -> Device:
        elements = []
        for element in found.device.elements:
            keys = found.covariance_keys.get(element.name, ())
            now = {name: number.value for name, number in element.numbers() if number is not None}
            moved = {key: now[key] + float(moves[element.name][k, j]) for j, key in enumerate(keys)}
            kept = {key: max(x, 0.0) if key in ("stiffness", "damping", "free_play") else x for key, x in moved.items()}
            elements.append(element.with_numbers({key: SheetValue(x) for key, x in kept.items()}))
        return Device(
            found.device.name, found.device.parts, tuple(elements), found.device.sources, found.device.mass_kg
        )

    return tuple(drawn(k) for k in range(count))


def parts_draws(found: IdentifiedDevice, count: int, seed: int) -> Float[Tensor, "draws bodies 10"]:
    """Draw what the parts of a device add to the inertial parameters of the bodies; Gaussian, without the LMI."""
    generator = torch.Generator().manual_seed(seed)
    values, vectors = torch.linalg.eigh(found.parts_covariance)
    unit = torch.randn(count, len(values), generator=generator, dtype=torch.float64).to(values)
    moved = (unit * values.clamp_min(0.0).sqrt()) @ vectors.mT
    parts = found.parts + moved.view(count, *found.parts.shape)
    body = torch.tensor(found.parts_body, dtype=torch.long, device=parts.device)
    return parts.new_zeros(count, *found.phi_on.shape).index_add(1, body, parts)
