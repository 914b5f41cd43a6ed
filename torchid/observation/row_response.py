"""Change of a trial's rows by displacements of markers and bodies, per unit parameter."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.observation.marker_bands import MarkerBands


@dataclass(frozen=True)
class RowResponse:
    """Change of a trial's rows by displacements of one unit parameter each, worked out as far as it is asked for."""

    momenta: Callable[[], Float[Tensor, "columns 9 frames"]]
    """Makes ``nine``."""
    shown: Callable[[], Float[Tensor, "columns bins rows"]]
    """Makes ``shift``."""
    spectral: Callable[[], Float[Tensor, "columns kept rows"]] | None = None
    """Makes the coefficients of what postures leave, where there is a shorter way to them than ``shift``."""

    @property
    def nine(self) -> Float[Tensor, "columns 9 frames"]:
        """Vectors A, B and C of ``effects.displacement`` in every frame, from which ``wrench_of`` makes the wrench."""
        return self.momenta()

    @property
    def shift(self) -> Float[Tensor, "columns bins rows"]:
        """Displacement of the markers [m], averaged as ``MarkerBands`` averages, one row for each coordinate of a
        marker in W."""
        return self.shown()

    def spectrum(self, bands: MarkerBands) -> Float[Tensor, "columns kept rows"]:
        """Return the coefficients of what postures leave of the shift, as ``MarkerBands.spectrum`` does."""
        return bands.spectrum(bands.left(self.shift)) if self.spectral is None else self.spectral()

    def per(self, step: Float[Tensor, " columns"]) -> "RowResponse":
        """Return the response to unit parameters of which this one's parameters were parts."""
        return RowResponse(lambda: self.nine / step[:, None, None], lambda: self.shift / step[:, None, None])

    def __add__(self, other: "RowResponse") -> "RowResponse":
        """Return the response to both displacements at once, parameter by parameter."""
        return RowResponse(lambda: self.nine + other.nine, lambda: self.shift + other.shift)


def concatenate(answers: Sequence[RowResponse]) -> RowResponse:
    """Return the response to the parameters of all the given ones, one after the other."""
    return RowResponse(lambda: torch.cat([a.nine for a in answers]), lambda: torch.cat([a.shift for a in answers]))
