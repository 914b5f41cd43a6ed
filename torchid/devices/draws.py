"""Devices as they may be: draws of what was found of their elements, for bands of whatever follows from them."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.devices.device import Device
from torchid.devices.result import IdentifiedDevice
from torchid.devices.values import SheetValue


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
