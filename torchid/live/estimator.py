"""Inertial parameters from rows as they come, in information form."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError
from torchid.inertia.fit import InertiaFit, fit_inertia
from torchid.inertia.identify import Identified, determined, identify_spectra
from torchid.inertia.options import InertiaOptions
from torchid.model.model import InertialPrior
from torchid.regressor.equations import NormalEquations
from torchid.regressor.whitening import BlockSpectrum, accumulate, estimate_whitening, initial_whitening

EAGER = 8
"""Choice. Blocks up to which the noise is estimated anew with every one; ..."""
GROWTH = 1.25
"""Choice. ... later whenever there are so many times as many: all sums are then made anew, so that they take, over a
session, five times the work of a single pass."""


class Information:
    """Gaussian information about parameters: a prior, and sums of whitened rows that may fade.

    Adding rows is adding their sums, which is the batch solution on all of them at any moment (Simon, Optimal State
    Estimation (2006), section 11.2). Nothing is inverted until somebody asks, and the prior does not fade, so that the
    covariance is positive definite whatever comes.
    """

    def __init__(self, mean: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]) -> None:
        """Begin with the prior alone.

        Args:
            mean: of the parameters.
            covariance: positive definite.
        """
        self._mean, self._precision = mean, torch.linalg.inv(covariance)
        self._precision = 0.5 * (self._precision + self._precision.mT)
        self.sums = NormalEquations(torch.zeros_like(covariance), torch.zeros_like(mean), 0.0, 0)

    def add(self, rows: NormalEquations, fading: float = 1.0) -> None:
        """Add rows to those before.

        Args:
            rows: sums of whitened rows.
            fading: by which all that came before counts less, 0 to 1.
        """
        before = self.sums if fading == 1.0 else self.sums.scale(fading)
        self.sums = before + rows

    def estimate(self) -> tuple[Float[Tensor, " params"], Float[Tensor, "params params"]]:
        """Return mean and covariance of the parameters."""
        A = self._precision + self.sums.gram
        scale = A.diagonal().rsqrt()
        L = torch.linalg.cholesky(scale[:, None] * A * scale)
        pull = scale * (self.sums.moment - self.sums.gram @ self._mean)
        step = torch.cholesky_solve(pull[:, None], L)[:, 0]
        covariance = scale[:, None] * torch.cholesky_inverse(L) * scale
        return self._mean + scale * step, 0.5 * (covariance + covariance.mT)


class Estimator:
    """The inertial fit of a stream: physical parameters after every block of rows, with the noise that they show.

    Memory grows by the blocks' spectra alone, 60 kB for a second of rows.
    """

    def __init__(
        self, names: tuple[str, ...], prior: InertialPrior, options: InertiaOptions, mass: tuple[float, float] | None,
        halflife_s: float | None = None,
    ) -> None:  # fmt: skip
        """Begin with the prior alone.

        Args:
            names: of the bodies.
            prior: of their parameters.
            options: of the fit.
            mass: total mass and its standard deviation [kg]; None where nothing but the prior tells it.
            halflife_s: after so long rows count half; None: always alike.
        """
        self._names, self._prior, self._mass, self._halflife_s = names, prior, mass, halflife_s
        self._options = replace(options, noise="known")
        self._lenient = replace(self._options, refuse=False, base_parameters=False)
        self._blocks: list[tuple[float, BlockSpectrum]] = []
        self._whitening, self._refreshed = initial_whitening(prior.mean), 0
        self._information = self._nothing()
        self.fit: InertiaFit | None = None

    def add(self, blocks: Sequence[BlockSpectrum], time_s: float) -> None:
        """Take in rows, and find the physical parameters that they ask for.

        Args:
            blocks: runs of frames in the frequency domain.
            time_s: when they were measured.
        """
        if not blocks:
            return
        faded = 1.0 if not self._blocks else self._fading(time_s - self._blocks[-1][0])
        self._blocks += [(time_s, block) for block in blocks]
        self._information.add(accumulate(blocks, self._whitening), faded)
        count = len(self._blocks)
        if self.fit is not None and (count <= EAGER or count >= GROWTH * self._refreshed):
            self._refresh(self.fit, time_s)
        self.fit = self._fitted() or self.fit

    def finished(self) -> Identified:
        """Return what a run on all rows finds.

        Raises:
            DataError: there are no rows, or the fit is not accepted.
        """
        if not self._blocks:
            raise DataError(
                "live.no_rows", "no frame had all contact on the plates and a known posture",
                found="no rows", remedy="Stand and move with both feet on the plates",
            )  # fmt: skip
        return identify_spectra([[one for _, one in self._blocks]], self._names, self._prior, self._options, self._mass)

    def _fading(self, seconds: float) -> float:
        return 1.0 if self._halflife_s is None else 0.5 ** (seconds / self._halflife_s)

    def _nothing(self) -> Information:
        return Information(self._prior.mean.reshape(-1), self._prior.covariance)

    def _refresh(self, fit: InertiaFit, now_s: float) -> None:
        """Noise from the residuals of all blocks, and all sums under it."""
        phi = fit.phi.reshape(-1)
        self._whitening = estimate_whitening(((block, phi) for _, block in self._blocks), determined(fit))
        self._information, self._refreshed = self._nothing(), len(self._blocks)
        if self._halflife_s is None:
            self._information.add(accumulate((block for _, block in self._blocks), self._whitening))
            return
        for time_s, block in self._blocks:
            self._information.add(accumulate([block], self._whitening).scale(self._fading(now_s - time_s)))

    def _fitted(self) -> InertiaFit | None:
        try:
            sums = self._information.sums
            return fit_inertia(sums, self._prior, self._names, self._lenient, mass=self._mass)
        except DataError:  # too little yet to hold on to; the next block will tell
            return None
