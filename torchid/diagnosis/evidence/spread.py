"""Log evidence of parameters of several spreads, from the information and moment that data hold of them."""

import torch
from jaxtyping import Float
from torch import Tensor


def evidence_of_sizes(
    told: Float[Tensor, "places n n"], left: Float[Tensor, "places n"], sizes: Float[Tensor, " tried"]
) -> Float[Tensor, "places tried"]:
    """Return the log evidence of parameters with standard deviations of so many priors, over none [nat].

    Args:
        told: information that the data hold of the parameters at each place, in units of their priors.
        left: moment of the same: the parameters would be estimated as told^-1 left.
        sizes: the standard deviations.
    """
    value, power = eigen_powers(told, left)
    return evidence_of_variances(value, power, sizes.square())


def eigen_powers(
    told: Float[Tensor, "places n n"], left: Float[Tensor, "places n"]
) -> tuple[Float[Tensor, "places n"], Float[Tensor, "places n"]]:
    """Return eigenvalues of the information, and the squares of the moment along their vectors.

    Args:
        told: information, see ``evidence_of_sizes``.
        left: moment.
    """
    value, vector = torch.linalg.eigh(told)
    return value.clamp(min=0.0), torch.einsum("pij,pi->pj", vector, left).square()


def evidence_of_variances(
    value: Float[Tensor, "places n"], power: Float[Tensor, "places n"], variance: Float[Tensor, " tried"]
) -> Float[Tensor, "places tried"]:
    """Return the log evidence of parameters with such variances, against their priors, over none [nat].

    Args:
        value: eigenvalues of the information.
        power: squares of the moment along their vectors.
        variance: the variances.
    """
    variance = variance[:, None]
    grown = variance * value[:, None] + 1.0
    return 0.5 * (power[:, None] * variance / grown - grown.log()).sum(2)
