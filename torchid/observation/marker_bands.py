"""Averages of markers over a few frames, and what they say band by band."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.regressor.equations import half_product
from torchid.regressor.whitening import cosine_matrix

MARKER_EDGES_HZ = (0.15, 0.5, 1.5)
"""Upper edges of the bands [Hz] behind the mean of a block, which is a band of its own."""
KEPT_HZ = 4.0
"""Of the cosine coefficients; faster, markers of a person have noise alone."""
BLOCK = 256
"""Averages per block at most."""


@dataclass(frozen=True)
class MarkerBands:
    """Averaged rows of the markers of one trial."""

    middle: Int[Tensor, " bins"]
    """Frame in the middle of each average."""
    rate: float
    rows: Float[Tensor, "bins rows"]
    """Square roots of the weights."""
    J: Float[Tensor, "bins rows dofs"]
    K: Float[Tensor, "bins dofs rows"]
    error: Float[Tensor, "bins rows"]

    def left(self, D: Float[Tensor, "columns bins rows"]) -> Float[Tensor, "columns bins rows"]:
        """(1 - J K) D, weighed. Of the error: at the least-squares posture, for robust fits stop elsewhere."""
        own = D.transpose(0, 1)
        return torch.baddbmm(own, own @ self.K.mT, self.J.mT, alpha=-1.0).mul_(self.rows[:, None]).transpose(0, 1)

    @property
    def free(self) -> float:
        """Share of the rows that nobody misses and postures leave."""
        return max(0.05 * self.seen, self.seen - self.J.shape[0] * self.J.shape[2]) / self.rows.numel()

    @property
    def kept(self) -> Float[Tensor, " rows"]:
        """Share of each row's noise that postures leave: a foot's three markers keep less than an arm's seven."""
        leverage = torch.einsum("brd,bdr->br", self.J, self.K)
        seen = self.rows > 0.0
        return 1.0 - (seen * leverage).sum(0) / seen.sum(0).clamp(min=1)

    @property
    def seen(self) -> float:
        """Number of rows that nobody misses."""
        return float((self.rows > 0.0).sum())

    def spectrum(
        self, left: Float[Tensor, "columns bins rows"], course: Float[Tensor, " bins"] | None = None
    ) -> Float[Tensor, "columns kept rows"]:
        """Cosine coefficients, block by block, of columns times a course."""
        parts = []
        for part, C in self._cosines:
            parts.append((C if course is None else C * course[part]) @ left[:, part])
        return parts[0] if len(parts) == 1 else torch.cat(parts, 1)

    def asked(self, left: Float[Tensor, "columns bins rows"]) -> Float[Tensor, "bands columns bins rows"]:
        """What products with displacements must be taken with for those of their coefficients, band by band.

        Adjoint of ``left`` and ``spectrum``: a few columns against a catalogue cost as much as these few.
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
        """Of each coefficient."""
        edges, found = torch.tensor(MARKER_EDGES_HZ, dtype=torch.float64), []
        for part, C in self._cosines:
            frequency = 0.5 * self.rate * torch.arange(len(C), dtype=torch.float64) / (part.stop - part.start)
            found.append(1 + torch.bucketize(frequency, edges))
            found[-1][0] = 0
        return torch.cat(found)

    @cached_property
    def _cosines(self) -> list[tuple[slice, Float[Tensor, "kept own"]]]:
        """Bins and cosines of each block."""
        pieces, start, found = max(1, -(-len(self.middle) // BLOCK)), 0, []
        for size in (len(part) for part in self.middle.tensor_split(pieces)):
            kept = min(size, math.ceil(2.0 * KEPT_HZ * size / self.rate))
            found.append((slice(start, start + size), cosine_matrix(size, kept).to(self.error)))
            start += size
        return found


BANDS = len(MARKER_EDGES_HZ) + 2

STRETCHES = 12
"""Of columns that lie together, up to which they are copied stretch by stretch."""


@dataclass(frozen=True)
class MarkerStatistics:
    """Gram matrix, moment and energy of one trial's rows in each band, before any scale of the noise."""

    gram: Float[Tensor, "bands columns columns"]
    moment: Float[Tensor, "bands columns"]
    energy: Float[Tensor, " bands"]
    count: Float[Tensor, " bands"]
    """Degrees of freedom."""
    least: float = 1e-6
    """Energy of each that white noise leaves, whatever a model explains."""

    def only(self, some: Int[Tensor, " fewer"]) -> "MarkerStatistics":
        """Of some columns."""
        return replace(self, gram=_some(self.gram, some), moment=self.moment[:, some])

    def left(self, theta: Float[Tensor, " columns"]) -> Float[Tensor, " bands"]:
        """Energy of the residual at theta."""
        return self.energy - 2.0 * self.moment @ theta + torch.einsum("bij,i,j->b", self.gram, theta, theta)


def _some(gram: Float[Tensor, "bands all all"], some: Int[Tensor, " fewer"]) -> Float[Tensor, "bands fewer fewer"]:
    """Rows and columns of matrices, in stretches: nuisances lie together, and gathered one by one they took 20 ms."""
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
    bands: MarkerBands, spectra: Float[Tensor, "columns kept rows"], least: float
) -> MarkerStatistics:
    """Of the last column against the others.

    Args:
        coarse: the rows.
        spectra: of what postures leave of the columns, see ``Coarse.spectrum``.
        least: as in ``MarkerSums``.
    """
    n, flat, start = len(spectra) - 1, spectra.flatten(1).T, 0
    gram, count = flat.new_zeros(BANDS, n + 1, n + 1), flat.new_zeros(BANDS)
    # Coefficients rise in frequency: those of a band lie together.
    for b, rise in zip(*bands.band.unique_consecutive(return_counts=True), strict=True):
        own = int(rise) * spectra.shape[2]
        gram[b] += half_product(flat[start : start + own])
        count[b] += own * bands.free
        start += own
    return MarkerStatistics(gram[:, :n, :n].contiguous(), gram[:, :n, n].clone(), gram[:, n, n].clone(), count, least)


def retaken_statistics(
    bands: MarkerBands,
    own: MarkerStatistics,
    shifts: Iterable[Float[Tensor, "some bins rows"]],
    some: Int[Tensor, " few"],
    left: Float[Tensor, "few bins rows"],
) -> MarkerStatistics:
    """Sums with a few columns taken elsewhere.

    Args:
        coarse: the rows.
        own: sums of all columns.
        shifts: displacements of all of them, as they now are, some at a time.
        some: which were taken anew.
        left: what they leave, see ``Coarse.left``.
    """
    asked = bands.asked(left).flatten(2)
    crossed = torch.cat([shift.flatten(1) @ asked.flatten(0, 1).T for shift in shifts])
    crossed = crossed.unflatten(1, asked.shape[:2]).transpose(0, 1)
    gram, moment = own.gram.clone(), own.moment.clone()
    gram[:, :, some], gram[:, some] = crossed, crossed.mT
    moment[:, some] = asked @ bands.error.flatten()
    return replace(own, gram=gram, moment=moment)
