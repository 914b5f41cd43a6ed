"""Accumulated least-squares sums: all that an inertial fit needs of a trial, whatever its length."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError

_ROUNDING = 1e-9
"""Relative error that sums of float64 rows may show; sums of float32 rows show 1e-6 and more."""


_BLOCK = 192
"""Columns whose products are taken together."""


def half_product(Y: Float[Tensor, "rows params"]) -> Float[Tensor, "params params"]:
    """Y' Y, of which only one half is computed."""
    n = Y.shape[1]
    if n <= _BLOCK:
        return Y.mT @ Y
    found, size = Y.new_empty(n, n), min(_BLOCK, -(-n // 2))
    for start in range(0, n, size):
        stop = min(start + size, n)
        part = Y[:, start:stop].mT @ Y[:, start:]
        found[start:stop, start:] = part
        found[stop:, start:stop] = part[:, stop - start :].mT
    return found


@dataclass(frozen=True)
class NormalEquations:
    """Sums of whitened rows Y phi = F (each row divided by the standard deviation of its noise)."""

    gram: Float[Tensor, "params params"]
    """Y' Y."""
    moment: Float[Tensor, " params"]
    """Y' F."""
    square: float
    """F' F."""
    rows: int | float
    """Number of rows; fewer than were summed when serial correlation makes them count less."""

    @staticmethod
    def from_rows(Y: Float[Tensor, "rows params"], F: Float[Tensor, " rows"]) -> "NormalEquations":
        """Sums of the whitened rows ``Y`` and right-hand sides ``F``, in their dtype (float64 wanted)."""
        return NormalEquations(half_product(Y), Y.mT @ F, float(F @ F), len(F))

    def __add__(self, other: "NormalEquations") -> "NormalEquations":
        """Sums of both sets of rows."""
        return NormalEquations(
            self.gram + other.gram, self.moment + other.moment, self.square + other.square, self.rows + other.rows
        )

    def scale(self, omega: float) -> "NormalEquations":
        """Sums after every row was multiplied by sqrt(omega); the number of rows stays."""
        return NormalEquations(omega * self.gram, omega * self.moment, omega * self.square, self.rows)

    def faded(self, weight: float) -> "NormalEquations":
        """Sums in which every row counts as this part of one, its number included."""
        return replace(self.scale(weight), rows=weight * self.rows)

    def residual_square(self, phi: Float[Tensor, " params"]) -> float:
        """||Y phi - F||^2, up to rounding of ``square``."""
        return float(self.square - 2 * self.moment @ phi + phi @ self.gram @ phi)

    @cached_property
    def unit_spectrum(
        self,
    ) -> tuple[Float[Tensor, " params"], Float[Tensor, " params"], Float[Tensor, "params params"]]:
        """Column lengths of Y, and eigenvalues (rising) and eigenvectors of the Gram matrix of unit columns.

        A column of length zero stays zero.
        """
        norm = self.gram.diagonal().clamp_min(0).sqrt()
        unit = torch.where(norm > 0, 1 / norm, 0.0)
        values, vectors = torch.linalg.eigh(unit[:, None] * self.gram * unit)
        return norm, values, vectors

    def check(self) -> None:
        """Raise DataError unless the sums are finite and can come from one set of rows.

        Two things always hold for sums of real rows: the Gram matrix has no negative eigenvalue, and the residual
        of the best phi is not negative. Both are tested with unit columns, so units do not matter.
        """
        finite = bool(torch.isfinite(self.gram).all() and torch.isfinite(self.moment).all())
        if not (finite and torch.isfinite(torch.tensor(float(self.square)))):
            raise DataError(
                "equations.not_finite", "the accumulated equations hold NaN or infinity",
                found=f"{int((~torch.isfinite(self.gram)).sum())} entries of the Gram matrix",
                remedy="Leave out frames without motion or force before summing",
            )  # fmt: skip
        norm, values, vectors = self.unit_spectrum
        unit = torch.where(norm > 0, 1 / norm, 0.0)
        asymmetry = float((self.gram - self.gram.mT).abs().mul(unit[:, None] * unit).max())
        top = float(values[-1])
        solid = values > _ROUNDING * max(top, 0.0)
        best = float(((vectors.mT @ (unit * self.moment))[solid].square() / values[solid]).sum())
        if float(values[0]) < -_ROUNDING * top or asymmetry > _ROUNDING or best > self.square * (1 + 1e3 * _ROUNDING):
            raise DataError(
                "equations.inconsistent", "the accumulated equations cannot come from one set of rows",
                found=f"the Gram matrix has eigenvalues {float(values[0]):.1e} to {top:.1e} and asymmetry "
                f"{asymmetry:.1e}; its solution explains {best:.6e} of a sum of squares of {self.square:.6e}",
                remedy="Sum gram, moment and square over the same rows, in float64",
            )  # fmt: skip
