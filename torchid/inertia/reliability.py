"""Noise of the motion taken out of the normal equations: regression calibration.

The regressor is made of a motion that markers tell with noise, Y = Y* + D, and the wrench needs Y* x. Least squares on
Y then errs for everybody the same way, the more of Y is noise. What Y says of Y* is Y R to first order, with the
reliability R = 1 - (Y'WY)^-1 E[D'WD]; on Y R, least squares is right in the mean.

Reference: Carroll, Ruppert, Stefanski & Crainiceanu, Measurement Error in Nonlinear Models, 2nd ed. (2006), ch. 4.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.whitening import Whitening
from torchid.inertia.spectrum import cholesky

NoiseGram = Callable[[Whitening], Float[Tensor, "params params"]]
"""Makes E[D'WD] of all rows under a whitening."""
UNTOLD = 1e-3
"""Resolution. Information over the prior's of directions of which rows say nothing: they stay as they are."""


def reliability(
    sums: Sequence[NormalEquations], noise: Float[Tensor, "params params"], covariance: Float[Tensor, "params params"]
) -> Float[Tensor, "params params"]:
    """Return R, what regressors say of those without noise.

    Args:
        sums: of each trial, whitened.
        noise: expected gram of the noise in the regressors of all of them, whitened alike.
        covariance: of the prior.
    """
    factor = cholesky(covariance)
    gram = factor.mT @ torch.stack([one.gram for one in sums]).sum(0) @ factor
    told = torch.linalg.cholesky(gram + UNTOLD * torch.eye(len(gram)).to(gram))
    part = torch.linalg.solve_triangular(told, factor.mT @ noise @ factor, upper=False)
    part = torch.linalg.solve_triangular(told, part.mT, upper=False)
    share, axes = torch.linalg.eigh(0.5 * (part + part.mT))
    # No regressor is more than all noise, of which some draws tell.
    kept = (axes * (1.0 - share.clamp(0.0, 1.0))) @ axes.mT
    into = torch.linalg.solve_triangular(factor, torch.eye(len(gram)).to(gram), upper=False)
    return factor @ torch.linalg.solve_triangular(told.mT, kept @ told.mT @ into, upper=True)


def calibrated(sums: NormalEquations, R: Float[Tensor, "params params"]) -> NormalEquations:
    """Return equations on what their regressors say of those without noise.

    Args:
        sums: of rows as they are seen.
        R: from ``reliability``.
    """
    gram = R.mT @ sums.gram @ R
    return replace(sums, gram=0.5 * (gram + gram.mT), moment=R.mT @ sums.moment)
