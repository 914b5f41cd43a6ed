"""Inertia without one of several blocks of rows, for all of them in turn.

Sums of rows are additive, so that a block is left out by taking its own away. Noise and the prior's weight stay those
of all rows, and no pseudo-inertia is held positive definite: one Cholesky factorisation for each block.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.inertia.options import IdentifyOptions
from torchid.inertia.problem import pose
from torchid.inertia.spectrum import cholesky
from torchid.model.model import InertialPrior


def leave_out_each(
    blocks: Sequence[NormalEquations],
    prior: InertialPrior,
    names: tuple[str, ...],
    options: IdentifyOptions,
    omega_2: float,
    mass: tuple[float, float] | None = None,
) -> list[Float[Tensor, " params"]]:
    """Return the inertial parameters that all other blocks and the prior determine, for each block left out.

    Args:
        blocks: whitened sums of each block; together all that is fitted.
        prior: mean and covariance of the parameters.
        options: those of the fit; they say which prior it is.
        omega_2: factor on the prior's precision.
        mass: total mass and its standard deviation [kg], as the fit had it.

    Returns:
        The mean of the Gaussian posterior, block by block; that of the prior where there is one block alone.

    Raises:
        ConfigError: the prior cannot be.
        DataError: the sums are not finite.
    """
    problem = pose(sum(blocks[1:], blocks[0]), prior, names, options, mass, None)
    gram, moment = problem.data_terms(1.0)
    factor, mean = cholesky(problem.covariance), problem.mean
    inner, pull = factor.mT @ gram @ factor, factor.mT @ (moment - gram @ mean)
    unit, found = omega_2 * torch.eye(len(mean), dtype=mean.dtype, device=mean.device), []
    for own in blocks:
        precision = unit + inner - factor.mT @ own.gram @ factor
        others = pull - factor.mT @ (own.moment - own.gram @ mean)
        lower = torch.linalg.cholesky(0.5 * (precision + precision.mT))
        found.append(mean + factor @ torch.cholesky_solve(others[:, None], lower)[:, 0])
    return found
