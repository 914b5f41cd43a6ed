"""Averages of markers over a few frames, and what they say band by band."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.regressor.equations import half_product
from torchid.regressor.whitening import cosine_matrix

EDGES = (0.15, 0.5, 1.5)
"""Upper edges of the bands [Hz] behind the mean of a block, which is a band of its own."""
KEPT_HZ = 4.0
"""Of the cosine coefficients; faster, markers of a person have noise alone."""
BLOCK = 256
"""Averages per block at most."""


@dataclass(frozen=True)
class Coarse:
    """Averaged rows of the markers of one trial."""

    middle: Int[Tensor, " bins"]
    """Frame in the middle of each average."""
    rate: float
    rows: Float[Tensor, "bins rows"]
    """Square roots of the weights."""
    J: Float[Tensor, "bins rows dofs"]
    K: Float[Tensor, "bins dofs rows"]
    error: Float[Tensor, "bins rows"]

    def left(self, D: Float[Tensor, "bins rows columns"]) -> Float[Tensor, "bins rows columns"]:
        """(1 - J K) D, weighed. Of the error: at the least-squares posture, for robust fits stop elsewhere."""
        return torch.baddbmm(D, self.J, self.K @ D, alpha=-1.0).mul_(self.rows[:, :, None])

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
        self, left: Float[Tensor, "bins rows columns"]
    ) -> Iterator[tuple[Float[Tensor, "kept rows columns"], Int[Tensor, " kept"]]]:
        """Cosine coefficients block by block, with their bands."""
        for part, C, band in self._cosines():
            yield (C @ left[part].flatten(1)).view(len(C), *left.shape[1:]), band

    def asked(self, left: Float[Tensor, "bins rows columns"]) -> Float[Tensor, "bands bins rows columns"]:
        """What products with displacements must be taken with for those of their coefficients, band by band.

        Adjoint of ``left`` and ``spectrum``: a few columns against a catalogue cost as much as these few.
        """
        found = left.new_zeros(BANDS, *left.shape)
        for part, C, band in self._cosines():
            rows = C @ left[part].flatten(1)
            for b in band.unique().tolist():
                own = band == b
                found[b, part] = (C[own].T @ rows[own]).view_as(left[part])
        found.mul_(self.rows[:, :, None])
        return found - self.K.mT @ (self.J.mT @ found)

    def _cosines(self) -> Iterator[tuple[slice, Float[Tensor, "kept own"], Int[Tensor, " kept"]]]:
        """Bins, cosines and bands of each block."""
        pieces, start = max(1, -(-len(self.middle) // BLOCK)), 0
        for size in (len(part) for part in self.middle.tensor_split(pieces)):
            kept = min(size, math.ceil(2.0 * KEPT_HZ * size / self.rate))
            frequency = 0.5 * self.rate * torch.arange(kept, dtype=torch.float64) / size
            band = 1 + torch.bucketize(frequency, torch.tensor(EDGES, dtype=torch.float64))
            band[0] = 0
            yield slice(start, start + size), cosine_matrix(size, kept).to(self.error), band
            start += size


BANDS = len(EDGES) + 2

STRETCHES = 12
"""Of columns that lie together, up to which they are copied stretch by stretch."""


@dataclass(frozen=True)
class MarkerSums:
    """Gram matrix, moment and energy of one trial's rows in each band, before any scale of the noise."""

    gram: Float[Tensor, "bands columns columns"]
    moment: Float[Tensor, "bands columns"]
    energy: Float[Tensor, " bands"]
    count: Float[Tensor, " bands"]
    """Degrees of freedom."""
    least: float = 1e-6
    """Energy of each that white noise leaves, whatever a model explains."""

    def only(self, some: Int[Tensor, " fewer"]) -> "MarkerSums":
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


def marker_sums(
    coarse: Coarse,
    spectra: Sequence[Sequence[tuple[Float[Tensor, "_ rows _"], Int[Tensor, " _"]]]],
    least: float,
) -> MarkerSums:
    """Of the last column against the others.

    Args:
        coarse: the rows.
        spectra: of what postures leave of some columns after others, see ``Coarse.spectrum``.
        least: as in ``MarkerSums``.
    """
    blocks = list(zip(*spectra, strict=True))
    n = sum(rows.shape[2] for rows, _ in blocks[0]) - 1
    gram, count = coarse.error.new_zeros(BANDS, n + 1, n + 1), coarse.error.new_zeros(BANDS)
    for parts in blocks:
        band, start = parts[0][1], 0
        # Coefficients rise in frequency: those of a band lie together.
        for b, rise in zip(*band.unique_consecutive(return_counts=True), strict=True):
            part = slice(start, start := start + int(rise))
            flat = torch.cat([rows[part].flatten(0, 1) for rows, _ in parts], 1)
            gram[b] += half_product(flat)
            count[b] += len(flat) * coarse.free
    return MarkerSums(gram[:, :n, :n].contiguous(), gram[:, :n, n], gram[:, n, n], count, least)


def retaken_sums(
    coarse: Coarse,
    own: MarkerSums,
    shifts: Iterable[Float[Tensor, "bins rows some"]],
    some: Int[Tensor, " few"],
    left: Float[Tensor, "bins rows few"],
) -> MarkerSums:
    """Sums with a few columns taken elsewhere.

    Args:
        coarse: the rows.
        own: sums of all columns.
        shifts: displacements of all of them, as they now are, some at a time.
        some: which were taken anew.
        left: what they leave, see ``Coarse.left``.
    """
    asked = coarse.asked(left).flatten(1, 2)
    crossed = torch.cat([shift.flatten(0, 1).T @ asked for shift in shifts], 1)
    gram, moment = own.gram.clone(), own.moment.clone()
    gram[:, :, some], gram[:, some] = crossed, crossed.mT
    moment[:, some] = coarse.error.flatten() @ asked
    return replace(own, gram=gram, moment=moment)
