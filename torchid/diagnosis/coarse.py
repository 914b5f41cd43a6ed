"""Averages of markers over a few frames, and what they say band by band."""

import math
from collections.abc import Iterator
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
        pieces = max(1, -(-len(left) // BLOCK))
        for part in left.tensor_split(pieces):
            kept = min(len(part), math.ceil(2.0 * KEPT_HZ * len(part) / self.rate))
            C = cosine_matrix(len(part), kept).to(part)
            frequency = 0.5 * self.rate * torch.arange(kept, dtype=torch.float64) / len(part)
            band = 1 + torch.bucketize(frequency, torch.tensor(EDGES, dtype=torch.float64))
            band[0] = 0
            yield (C @ part.flatten(1)).view(kept, *part.shape[1:]), band


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


def marker_sums(coarse: Coarse, left: Float[Tensor, "bins rows columns"], least: float) -> MarkerSums:
    """Of the last column against the others, see ``Cameras.left``; ``least`` as in ``MarkerSums``."""
    n = left.shape[2] - 1
    gram, count = left.new_zeros(BANDS, n + 1, n + 1), left.new_zeros(BANDS)
    for rows, band in coarse.spectrum(left):
        for b in band.unique().tolist():
            flat = rows[band == b].flatten(0, 1)
            gram[b] += half_product(flat)
            count[b] += len(flat) * coarse.free
    return MarkerSums(gram[:, :n, :n], gram[:, :n, n], gram[:, n, n], count, least)
