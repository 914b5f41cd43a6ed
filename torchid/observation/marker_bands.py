"""Markers' rows are averaged over a few frames, and taken to the frequency domain in a few bands.

A displacement D of the markers leaves (1 - J K) D behind once postures have followed it, with J the markers' Jacobian
and K its weighted pseudo-inverse. This module makes cosine coefficients of what is left, and from them a Gram matrix in
each band.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.dynamics.row_equations import half_product
from torchid.dynamics.whitening import cosine_matrix
from torchid.storage.snapshot import in_memory, unload

MARKER_EDGES_HZ = (0.15, 0.5, 1.5)
"""Resolution. Upper edges of the bands [Hz] behind the mean of a block, which is a band of its own."""
KEPT_HZ = 4.0
"""Resolution. Frequency of the last cosine coefficient that is kept [Hz]; faster ones of a person's markers are
noise."""
BLOCK = 256
"""Resolution. Number of averages in a block at most."""


@dataclass(frozen=True)
class MarkerBands:
    """Averaged rows of the markers of one trial; a row is one coordinate of one marker in W."""

    middle: Int[Tensor, " bins"]
    """Frame in the middle of each average."""
    rate: float
    """Averages per second [Hz]."""
    rows: Float[Tensor, "bins rows"]
    """Square roots of the weights [1/m], zero where a marker was not seen."""
    J: Float[Tensor, "bins rows dofs"]
    """Jacobian of the markers at the middle frames [m/rad, m/m]."""
    K: Float[Tensor, "bins dofs rows"]
    """Weighted pseudo-inverse of J, the posture prior included [rad/m, m/m]."""
    error: Float[Tensor, "bins rows"]
    """Mean of measured minus modelled places over the frames of each average [m]."""

    def left(self, D: Float[Tensor, "columns bins rows"]) -> Float[Tensor, "columns bins rows"]:
        """Return what postures leave of displacements, in units of the markers' scatter: (1 - J K) D times ``rows``.

        The posture is the one of least squares. Applied to ``error``, this undoes where a robust fit has stopped
        elsewhere.

        Args:
            D: displacements of the rows [m].
        """
        own = D.transpose(0, 1)
        return torch.baddbmm(own, own @ self.K.mT, self.J.mT, alpha=-1.0).mul_(self.rows[:, None]).transpose(0, 1)

    @property
    def free(self) -> float:
        """Share of all rows that are seen and remain free once postures are fitted; at least a twentieth of those that
        are seen."""
        return max(0.05 * self.seen, self.seen - self.J.shape[0] * self.J.shape[2]) / self.rows.numel()

    @property
    def kept(self) -> Float[Tensor, " rows"]:
        """Share of each row's noise variance that postures leave: three markers of a foot keep less than seven of an
        arm."""
        leverage = torch.einsum("brd,bdr->br", self.J, self.K)
        seen = self.rows > 0.0
        return 1.0 - (seen * leverage).sum(0) / seen.sum(0).clamp(min=1)

    @property
    def seen(self) -> float:
        """Number of rows in which a marker was seen."""
        return float((self.rows > 0.0).sum())

    def spectrum(
        self, left: Float[Tensor, "columns bins rows"], course: Float[Tensor, " bins"] | None = None
    ) -> Float[Tensor, "columns kept rows"]:
        """Return cosine coefficients, block after block, of columns times a course in time.

        Args:
            left: what postures leave of the columns, from ``MarkerBands.left``.
            course: factor at each average; None stands for one.
        """
        parts = []
        for part, C in self._cosines:
            parts.append((C if course is None else C * course[part]) @ left[:, part])
        return parts[0] if len(parts) == 1 else torch.cat(parts, 1)

    def asked(self, left: Float[Tensor, "columns bins rows"]) -> Float[Tensor, "bands columns bins rows"]:
        """Return vectors whose products with displacements are products of the coefficients of ``left`` with theirs.

        This is the adjoint of ``MarkerBands.left`` and ``MarkerBands.spectrum``, band by band. Products of a few
        columns with a whole catalogue then cost as much as these few.

        Args:
            left: what postures leave of the few columns.
        """
        found, start = left.new_zeros(BANDS, *left.shape), 0
        for part, C in self._cosines:
            rows, band = C @ left[:, part], self.band[start : start + len(C)]
            for b in band.unique().tolist():
                own = band == b
                found[b, :, part] = C[own].T @ rows[:, own]
            start += len(C)
        own = found.mul_(self.rows).flatten(0, 1).transpose(0, 1)
        return torch.baddbmm(own, own @ self.J, self.K, alpha=-1.0).transpose(0, 1).view_as(found)

    @cached_property
    def band(self) -> Int[Tensor, " kept"]:
        """Band of each coefficient, from 0 (means of blocks) to ``BANDS`` - 1."""
        edges, found = torch.tensor(MARKER_EDGES_HZ, dtype=torch.float64), []
        for part, C in self._cosines:
            frequency = 0.5 * self.rate * torch.arange(len(C), dtype=torch.float64) / (part.stop - part.start)
            found.append(1 + torch.bucketize(frequency, edges))
            found[-1][0] = 0
        return torch.cat(found)

    @cached_property
    def _cosines(self) -> list[tuple[slice, Float[Tensor, "kept own"]]]:
        """Return the averages of each block and the cosines that take them to the frequency domain."""
        pieces, start, found = max(1, -(-len(self.middle) // BLOCK)), 0, []
        for size in (len(part) for part in self.middle.tensor_split(pieces)):
            kept = min(size, math.ceil(2.0 * KEPT_HZ * size / self.rate))
            found.append((slice(start, start + size), cosine_matrix(size, kept).to(self.error)))
            start += size
        return found


BANDS = len(MARKER_EDGES_HZ) + 2
"""Resolution. Number of bands: means of blocks, those between ``MARKER_EDGES_HZ``, and the rest."""

TOGETHER = 8192
"""Resolution. Number of rows whose products are taken at once: those of all coefficients are most of a gigabyte."""

STRETCHES = 12
"""Resolution. Number of stretches of neighbouring columns up to which matrices are copied stretch by stretch."""


@dataclass(frozen=True)
class MarkerStatistics:
    """Gram matrix, moment and energy of one trial's rows in each band, before any scale of the noise; all
    dimensionless."""

    gram: Float[Tensor, "bands columns columns"]
    """Products of the columns with each other, per unit parameters; they may lie in a file."""
    moment: Float[Tensor, "bands columns"]
    """Products of the columns with the markers' error."""
    energy: Float[Tensor, " bands"]
    """Square of the markers' error."""
    count: Float[Tensor, " bands"]
    """Degrees of freedom of each band."""
    least: float = 1e-6
    """Energy per degree of freedom that white noise leaves, whatever a model explains."""

    def only(self, some: Int[Tensor, " fewer"]) -> "MarkerStatistics":
        """Return the statistics of some of the columns.

        Args:
            some: indices of the columns to keep, ascending.
        """
        return replace(self, gram=_some(self.gram, some), moment=self.moment[:, some])

    def left(self, theta: Float[Tensor, " columns"]) -> Float[Tensor, " bands"]:
        """Return the energy of the residual in each band at some parameters."""
        return self.energy - 2.0 * self.moment @ theta + torch.einsum("bij,i,j->b", self.gram, theta, theta)


def _some(gram: Float[Tensor, "bands all all"], some: Int[Tensor, " fewer"]) -> Float[Tensor, "bands fewer fewer"]:
    """Return some rows and columns of matrices, copied in stretches: nuisances lie together, and gathering is slow."""
    if not len(some):
        return gram[:, :0, :0]
    ends = ((some.diff() != 1).nonzero()[:, 0] + 1).tolist()
    if len(ends) > STRETCHES:
        return gram[:, some[:, None], some]
    spans = list(pairwise([0, *ends, len(some)]))
    found = gram.new_empty(len(gram), len(some), len(some))
    for (a, b), (c, d) in product(spans, spans):
        found[:, a:b, c:d] = gram[:, some[a] : some[a] + b - a, some[c] : some[c] + d - c]
    return found


def marker_statistics(
    bands: MarkerBands,
    spectra: Float[Tensor, "kept all rows"],
    least: float,
    room: Callable[[Sequence[int]], Tensor] = in_memory,
) -> MarkerStatistics:
    """Return Gram matrix and moment of the columns against the last one, which is the markers' error.

    Args:
        spectra: coefficients of what postures leave of the columns, the error last, from ``MarkerBands.spectrum``;
            they may lie in a file, in which those of one frequency stand together.
        least: as in ``MarkerStatistics``.
        room: makes zeros of a shape, in which the Gram matrices will lie.
    """
    n, rows, start = spectra.shape[1] - 1, spectra.shape[2], 0
    gram, moment = room((BANDS, n, n)), spectra.new_zeros(BANDS, n)
    energy, count = spectra.new_zeros(2, BANDS)
    # Coefficients rise in frequency: those of a band lie together.
    for b, rise in zip(*bands.band.unique_consecutive(return_counts=True), strict=True):
        stop = start + int(rise)
        for part in torch.arange(start, stop).split(max(1, TOGETHER // rows)):
            product = half_product(spectra[part[0] : part[-1] + 1].transpose(0, 1).flatten(1).T)
            gram[b] += product[:n, :n]
            moment[b] += product[:n, n]
            energy[b] += product[n, n]
            unload()
        count[b] += int(rise) * rows * bands.free
        start = stop
    return MarkerStatistics(gram, moment, energy, count, least)


def retaken_statistics(
    bands: MarkerBands,
    own: MarkerStatistics,
    shifts: Iterable[Float[Tensor, "some bins rows"]],
    some: Int[Tensor, " few"],
    left: Float[Tensor, "few bins rows"],
    room: Callable[[Sequence[int]], Tensor] = in_memory,
) -> MarkerStatistics:
    """Return the statistics after a few columns were taken at other parameters.

    Args:
        shifts: displacements [m] of all columns as they are now, some at a time.
        some: indices of the columns that have changed.
        left: what postures leave of these, from ``MarkerBands.left``.
        room: as in ``marker_statistics``.
    """
    asked = bands.asked(left).flatten(2)
    crossed = torch.cat([shift.flatten(1) @ asked.flatten(0, 1).T for shift in shifts])
    crossed = crossed.unflatten(1, asked.shape[:2]).transpose(0, 1)
    gram, moment = room(own.gram.shape).copy_(own.gram), own.moment.clone()
    gram[:, :, some], gram[:, some] = crossed, crossed.mT
    moment[:, some] = asked @ bands.error.flatten()
    unload()
    return replace(own, gram=gram, moment=moment)
