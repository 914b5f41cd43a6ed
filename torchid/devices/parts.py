"""What a sheet says of the ten inertial parameters of a part, as a Gaussian about the segment's origin.

Products such as m c are matched in mean and covariance over draws of mass, centre and inertia, so that an unknown
mass carries its centre along.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import INERTIA_PAIRS, Inertial
from torchid.devices.action import segment_index
from torchid.devices.device import Device, Part, SheetValue
from torchid.model.tree import Tree

DRAWS = 4096
"""Draws of a part, chosen: their means miss by a 64th of the scatter."""
SEED = 35
"""Start of the draws, chosen: a prior does not depend on chance."""
UNKNOWN_MASS = SheetValue(3.0, 3.0)
"""Mass of a part of which nothing is known [kg], chosen: published exoskeletons weigh 1 to 10 kg in two to four
parts."""
UNKNOWN_COM_SD = 0.15
"""Scatter of the centre of mass of such a part about its segment's own [m], chosen: half the length of a thigh."""
UNKNOWN_GYRATION = SheetValue(0.08, 0.04)
"""Radius of gyration of such a part [m], chosen: a box of 0.2 to 0.4 m."""
PRODUCT = 0.1
"""Scatter of its products of inertia relative to its moments, chosen: axes that lean by a few degrees."""
LEAST_SD = (1e-3, 2e-3, 0.1)
"""Least standard deviation of a mass [kg], of a centre of mass [m], and of moments of inertia relative to the largest,
chosen: a kitchen scale, a ruler, and a drawing."""
LEAST_GYRATION = 0.01
"""Least radius of gyration [m], chosen: a point has no distribution of mass."""


@dataclass(frozen=True)
class PartsPrior:
    """Parts of a device before any force is seen."""

    names: tuple[str, ...]
    body: tuple[int, ...]
    """Index of the segment of each part."""
    mean: Float[Tensor, "parts 10"]
    covariance: Float[Tensor, "params params"]
    reference: Float[Tensor, "parts 10"]
    """A physical inertia of each part's size, by which its parameters are scaled."""


def parts_prior(device: Device, tree: Tree, com: Float[Tensor, "bodies 3"]) -> PartsPrior:
    """Return what the sheet says of the parts; a total mass that it states is held as a measurement.

    Args:
        device: with parts on segments of the tree.
        com: centres of mass of the human segments, about which parts without a stated one scatter [m].

    Raises:
        ConfigError: ``device.segment``.
    """
    body = tuple(segment_index(tree, part.segment, part.name) for part in device.parts)
    draws = [_draws(part, com[k]) for part, k in zip(device.parts, body, strict=True)]
    blocks = [torch.cov(one.T) for one in draws]
    mean = torch.stack([one.mean(0) for one in draws]) if draws else com.new_zeros(0, 10)
    covariance = torch.block_diag(*blocks) if draws else com.new_zeros(0, 0)
    names = tuple(part.name for part in device.parts)
    prior = PartsPrior(names, body, mean, covariance, mean)
    return prior if device.mass_kg is None or not names else _with_total(prior, device.mass_kg)


def _with_total(prior: PartsPrior, total: SheetValue) -> PartsPrior:
    """Condition on the mass of all parts together (Gaussian conditioning on one linear measurement)."""
    row = torch.zeros_like(prior.mean)
    row[:, Inertial.M] = 1.0
    row = row.reshape(-1)
    lever = prior.covariance @ row
    variance = float(row @ lever) + max(total.sd, LEAST_SD[0]) ** 2
    mean = prior.mean.reshape(-1) + lever * ((total.value - float(row @ prior.mean.reshape(-1))) / variance)
    covariance = prior.covariance - torch.outer(lever, lever) / variance
    return PartsPrior(prior.names, prior.body, mean.reshape(-1, 10), covariance, prior.reference)


def _draws(part: Part, about: Float[Tensor, " 3"]) -> Float[Tensor, "draws 10"]:
    """Ten parameters of draws of a part."""
    generator = torch.Generator().manual_seed(SEED)

    def normal(*size: int) -> Tensor:
        return torch.randn(*size, generator=generator, dtype=torch.float64).to(about)

    known = part.mass_kg or UNKNOWN_MASS
    mass = _positive(known.value, max(known.sd, LEAST_SD[0]), normal)
    centre = [SheetValue(float(x), UNKNOWN_COM_SD) for x in about] if part.com_m is None else list(part.com_m)
    c = torch.stack([x.value + max(x.sd, LEAST_SD[1]) * normal(DRAWS) for x in centre], 1)
    inertia = mass[:, None] * _specific_inertia(part, known.value, normal)
    steiner = torch.stack([(float(i == j) * (c * c).sum(1) - c[:, i] * c[:, j]) * mass for i, j in INERTIA_PAIRS], 1)
    return torch.cat([mass[:, None], mass[:, None] * c, inertia + steiner], 1)


def _positive(mean: float, sd: float, normal) -> Float[Tensor, " draws"]:  # noqa: ANN001
    """Positive draws: normal where the scatter is small, else log-normal with the same mean and scatter."""
    if sd < 0.2 * mean:
        return mean + sd * normal(DRAWS)
    mean = max(mean, LEAST_SD[0])
    spread = math.log1p((sd / mean) ** 2)
    return mean * torch.exp(math.sqrt(spread) * normal(DRAWS) - 0.5 * spread)


def _specific_inertia(part: Part, mass: float, normal) -> Float[Tensor, "draws 6"]:  # noqa: ANN001
    """Moments about the centre of mass per mass [m^2]."""
    if part.inertia_kgm2 is None or not mass > 0.0:
        radius = UNKNOWN_GYRATION.value * torch.exp(0.5 * normal(DRAWS, 3))
        second = radius.square().clamp_min(LEAST_GYRATION**2)
        moments = second.sum(1, keepdim=True) - second
        xy, xz, yz = (PRODUCT * moments.mean(1) * normal(DRAWS) for _ in range(3))
        return torch.stack([moments[:, 0], xy, moments[:, 1], xz, yz, moments[:, 2]], 1)
    stated = torch.stack([torch.as_tensor(x.value, dtype=torch.float64) for x in part.inertia_kgm2]) / mass
    spread = max(max(x.sd for x in part.inertia_kgm2) / mass, LEAST_SD[2] * float(stated.abs().max()))
    least = torch.tensor([float(i == j) for i, j in INERTIA_PAIRS], dtype=torch.float64) * 2.0 * LEAST_GYRATION**2
    return stated + least + spread * normal(DRAWS, 6)
