"""Parameters of effects: their priors, and the way between internal values and those that are reported."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import ConfigError


@dataclass(frozen=True)
class Parameter:
    """One internal parameter of an effect, scalar or vector, zero where the effect is absent."""

    key: str
    """Name with the unit, as in ``mass_kg``."""
    scale: float
    """Standard deviation of the prior of each component."""
    size: int = 1
    positive: bool = False
    source: str = ""
    """Origin of ``scale``: a publication with what it measured, or ``a choice: `` and the reason."""


def value_of(values: Mapping[str, Tensor], effect: str, key: str, size: int) -> Float[Tensor, " size"]:
    """A reported parameter as a vector.

    Args:
        values: reported parameters by key.
        effect: name of the effect, for the message.
        key: of the parameter that is asked for.
        size: number of its components.

    Raises:
        ConfigError: it is missing or has another size.
    """
    found = torch.as_tensor(values[key], dtype=torch.float64).reshape(-1) if key in values else None
    if found is None or len(found) != size:
        raise ConfigError(
            "effect.parameters", f"needs {key} with {size} value{'s' if size > 1 else ''}", place=effect,
            found=", ".join(values) or "no parameters", remedy="Give every parameter of the effect",
        )  # fmt: skip
    return found


def stacked(parameters: Sequence[Parameter], values: Mapping[str, Tensor], effect: str) -> Float[Tensor, " params"]:
    """Values by key as one vector, in the order of the parameters.

    Raises:
        ConfigError: a parameter is missing or has another size.
    """
    return torch.cat([value_of(values, effect, p.key, p.size) for p in parameters])


def by_key(parameters: Sequence[Parameter], theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
    """The inverse of ``stacked``; scalars have no axis."""
    parts = torch.split(theta, [p.size for p in parameters])
    return {p.key: part[0] if p.size == 1 else part for p, part in zip(parameters, parts, strict=True)}


def propagated(
    named: Callable[[Tensor], dict[str, Tensor]],
    theta: Float[Tensor, " params"],
    covariance: Float[Tensor, "params params"],
) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
    """Reported parameters with their standard deviations, to first order.

    Args:
        named: reported parameters by key, from internal ones.
        theta: posterior mean of the internal parameters.
        covariance: of the internal parameters.
    """
    out = {}
    for key, value in named(theta).items():
        slope = torch.autograd.functional.jacobian(lambda x, key=key: named(x)[key], theta)
        flat = slope.reshape(-1, len(theta))
        out[key] = value, (flat @ covariance * flat).sum(1).sqrt().reshape(value.shape)
    return out
