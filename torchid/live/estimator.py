"""Inertial parameters from rows as they come, in information form."""

import logging
from collections.abc import Sequence
from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError
from torchid.inertia.fit import InertiaFit, fit_inertia
from torchid.inertia.identify import Identified, determined, identify_spectra
from torchid.inertia.options import InertiaOptions
from torchid.model.model import InertialPrior
from torchid.regressor.equations import NormalEquations
from torchid.regressor.whitening import BlockSpectrum, accumulate, estimate_whitening, initial_whitening

log = logging.getLogger(__name__)
EAGER = 8
"""Choice. Blocks up to which the noise is estimated anew with every one; ..."""
GROWTH = 1.25
"""Choice. ... later whenever there are so many times as many: all sums are then made anew, so that they take, over a
session, five times the work of a single pass."""


class Estimator:
    """The inertial fit of a stream: physical parameters after every block of rows, with the noise that they show.

    The state is the sum of all whitened rows, to which new ones are added: the estimate is the batch solution at any
    moment (Simon, Optimal State Estimation (2006), section 11.2), and with the prior its covariance is positive
    definite whatever comes. Memory grows by the blocks' spectra alone, 60 kB for a second of rows.
    """

    def __init__(
        self, names: tuple[str, ...], prior: InertialPrior, options: InertiaOptions, mass: tuple[float, float] | None,
        com_box: Float[Tensor, "bodies 2 3"] | None = None,
    ) -> None:  # fmt: skip
        """Begin with the prior alone.

        Args:
            names: of the bodies.
            prior: of their parameters.
            options: of the fit.
            mass: total mass and its standard deviation [kg]; None where nothing but the prior tells it.
            com_box: as for ``fit_inertia``.
        """
        self._names, self._prior, self._mass, self._box = names, prior, mass, com_box
        self._options = replace(options, noise="known")
        self._lenient = replace(self._options, refuse=False, base_parameters=False)
        self.blocks: list[BlockSpectrum] = []
        self.whitening, self._refreshed = initial_whitening(prior.mean), 0
        self._growing: BlockSpectrum | None = None
        self._done: NormalEquations | None = None
        self.sums: NormalEquations | None = None
        """Of all rows, those of the growing run included."""
        self.fit: InertiaFit | None = None

    def add(self, blocks: Sequence[BlockSpectrum], growing: BlockSpectrum | None = None) -> None:
        """Take in rows, and find the physical parameters that they ask for.

        Args:
            blocks: runs of frames in the frequency domain, complete.
            growing: a run that is not complete, in the place of the one that was given before.
        """
        if not blocks and growing is None and self._growing is None:
            return
        self.blocks += blocks
        self._growing = growing
        if blocks:
            self._done = _sum(self._done, accumulate(blocks, self.whitening))
        self._total()
        if self.sums is None:
            return
        count = len(self.blocks)
        if self.fit is not None and (count <= EAGER or count >= GROWTH * self._refreshed):
            self._refresh(self.fit)
        try:
            self.fit = fit_inertia(
                self.sums, self._prior, self._names, self._lenient, mass=self._mass, com_box=self._box
            )
        except DataError as error:  # the fit stays that of the blocks before
            log.warning("after %d blocks: %s", count, error)

    def finished(self) -> Identified:
        """Return what a run on all rows finds.

        Raises:
            DataError: there are no rows, or the fit is not accepted.
        """
        if not self.blocks:
            raise DataError(
                "live.no_rows", "no frame had all contact on the plates and a known posture",
                found="no rows", remedy="Stand and move with both feet on the plates",
            )  # fmt: skip
        return identify_spectra([self.blocks], self._names, self._prior, self._options, self._mass, self._box)

    def _refresh(self, fit: InertiaFit) -> None:
        """Noise from the residuals of all blocks, and all sums under it."""
        phi, growing = fit.phi.reshape(-1), self._growing
        every = self.blocks if growing is None else [*self.blocks, growing]
        self.whitening = estimate_whitening(((block, phi) for block in every), determined(fit))
        self._done = accumulate(self.blocks, self.whitening) if self.blocks else None
        self._refreshed = len(self.blocks)
        self._total()

    def _total(self) -> None:
        """Sums of what is complete and of what grows."""
        growing = None if self._growing is None else accumulate([self._growing], self.whitening)
        self.sums = self._done if growing is None else _sum(self._done, growing)


def _sum(first: NormalEquations | None, second: NormalEquations) -> NormalEquations:
    return second if first is None else first + second
