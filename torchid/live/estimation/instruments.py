"""Clock and gains of the plates, found beside the body from the newest rows.

Forces that come ``late`` and plates that read by a part ``gain_k`` of themselves too much leave

    F(t + late) = Y phi + zero + sum_k gain_k F_k,

where ``zero`` is as large as those of laboratories are: whose feet push against each other while they stand would else
have a gain of 30 % to balance two newtons that plates read without a load.

Asked of what the identified body leaves, most of either would be missed: the body has been identified from the same
rows, and has become one to which they fit. A shift leaves the forces' own noise as large as it is; the first terms of
Taylor's series take a tenth of it away at 4 to 5 Hz and 45 ms, which of a body that stands still is the best clock.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial import chebyshev
from torch import Tensor

from torchid.checks.clocks import Lateness
from torchid.conventions import LOADED_N, ZERO_SD_N, ZERO_SD_NM
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import SHORTEST, WrenchTrial
from torchid.dynamics.whitening import BEYOND, accumulate, initial_whitening, spectrum
from torchid.effects.timing import delayed
from torchid.model.model import InertialPrior

REMEMBERED = 10
"""Choice. Blocks over which clocks and gains are judged: a step or two of every kind of motion."""
PRIOR_SD = 1.0
"""Choice. Standard deviation of a gain before any data: it says nothing, and keeps a plate that nobody is on
solvable."""
PASSES = 4
"""Choice. Times that the noise is estimated anew; it settles to a per cent in three."""
LATEST_S, STEP_S = 0.1, 0.001
"""Choice. Longest lateness that is tried, and the step."""
MORE_TERMS = 6
"""Derived. Terms of the series in Chebyshev's polynomials beyond the phase x [rad] by which the longest lateness turns
what the filter lets through: what is left is twice the Bessel function J_n(x), 2e-4 at 6 Hz and 1e-2 at 26 Hz."""
LEAST = 1e-6
"""Resolution. Least sum of squares that is left, in the units of ``initial_whitening``: less is rounding."""
MARGIN = 8
"""Derived. Frames beyond the longest lateness that a cubic spline is given: 0.27^8 of its ends are left."""


@dataclass(frozen=True)
class Instruments:
    """What rows say of clock and gains."""

    late: Lateness
    """By how much forces come late, with its deviation over all that is tried."""
    gain: Float[Tensor, " plates"]
    """By which part of itself each plate reads too much, beside all of them: what they have in common is the mass."""
    gain_covariance: Float[Tensor, "2 plates plates"]
    """By the noise, and by how far the blocks agree."""

    def most_apart(self) -> tuple[int, int, float, float]:
        """Return the plates that disagree most: the one that reads more, the other, by how much, and its deviation."""
        C, apart = self.gain_covariance, self.gain[:, None] - self.gain
        own = C.diagonal(dim1=1, dim2=2)
        variance = (own[:, :, None] + own[:, None] - 2.0 * C).amax(0).clamp(min=1e-12)
        score = torch.where(apart > 0.0, apart / variance.sqrt(), 0.0)
        high, low = divmod(int(score.argmax()), len(self.gain))
        return high, low, float(apart[high, low]), float(variance[high, low].sqrt())


class InstrumentRows:
    """The newest rows, with columns for clock and gains behind those of the body."""

    def __init__(self, prior: InertialPrior) -> None:
        """Begin with nothing.

        Args:
            prior: of the body.
        """
        precision, mean = torch.linalg.inv(prior.covariance), prior.mean.reshape(-1)
        along = precision @ mean
        # What all plates read too much is told as mass: of the body, the size is left free.
        self._precision = precision - along[:, None] * along / (mean @ along)
        zero = self._precision.new_tensor([ZERO_SD_N] * 3 + [ZERO_SD_NM] * 3)
        self._zero, self._body = zero.square().reciprocal().diag(), len(precision) + len(zero)
        self._blocks: deque[NormalEquations] = deque(maxlen=REMEMBERED)
        self._terms = 0
        self._zero_at: Float[Tensor, "3"] | None = None

    def add(self, rows: WrenchTrial, plates: Float[Tensor, "frames plates 6"], part: slice) -> None:
        """Take in a block.

        Args:
            rows: of its frames and those around it.
            plates: what each plate reads in them, through the same filter, about the world's origin [N, N m].
            part: the block.
        """
        used, read, p = rows.used[part], plates[part], rows.motion.q[part, :3]
        if int(used.sum()) <= SHORTEST:
            return
        self._zero_at = p.mean(0) if self._zero_at is None else self._zero_at
        series = _series_of(rows, part)
        self._terms = len(series)
        # Where a plate bears nothing, its noise would explain the noise that it brings into the total.
        borne = (read * (read[..., 2:3] > LOADED_N)).transpose(0, 1)
        zero = torch.eye(6).to(read)[:, None].expand(-1, len(read), -1)
        acting = torch.cat([borne, series])
        columns = [
            wrench_about(one, (p - at).expand(len(one), -1, -1)) for one, at in ((zero, self._zero_at), (acting, 0.0))
        ]
        Y, F = rows.rows(part)
        X = torch.cat([Y, torch.cat(columns).permute(2, 0, 1)], 1)
        block = spectrum(X[:, :, used], F[:, used], rows.rate, rows.motion.smoother.cutoff_hz)
        self._blocks.append(accumulate([block], initial_whitening(F)))

    def found(self) -> Instruments | None:
        """Return what the rows say; None before the first.

        The noise is as large as what all of it together leaves, in the proportions of ``initial_whitening``.
        """
        if not self._blocks:
            return None
        rows, prior, apart = self._joined()
        size = len(prior)
        A, B, D = apart.T @ rows.gram[:size, :size] @ apart, apart.T @ rows.gram[:size, size:], rows.gram[size:, size:]
        late = torch.arange(-LATEST_S, LATEST_S + STEP_S / 2.0, STEP_S).to(A)
        series, noise, C, cost, best, k = _weights(late, self._terms), 1.0, A, late, B[:, 0], 0
        for _ in range(PASSES):
            C = torch.cholesky_inverse(torch.linalg.cholesky(A / noise + prior))
            right = series @ B.mT / noise
            cost = ((series @ D) * series).sum(1) / noise - ((right @ C) * right).sum(1)
            k = int(cost.argmin())
            best, now = right[k] @ C, series[k]
            left = float(now @ D @ now - 2.0 * best @ B @ now + best @ A @ best)
            noise = max(left, LEAST) / max(rows.rows - float((C * A).sum()) / noise, 1.0)
        slope, bend = (_weights(late[k : k + 1], self._terms, order)[0] for order in (1, 2))
        answer = C @ (B @ slope) / noise
        told = float(slope @ D @ slope - (B @ slope) @ answer) / noise
        curved = told + float(bend @ D @ series[k] - (B @ bend) @ best) / noise
        each = self._left(torch.cat([-apart @ best, series[k]])) / noise
        scatter = float((each @ torch.cat([-apart @ answer, slope])).square().sum())
        sd = _deviation(late, cost, k, min(max(curved, 0.0) / max(told, scatter, 1e-12), 1.0))
        pulls = each[:, :size] @ apart @ C
        own = apart[self._body :]
        C = own @ torch.stack([C, pulls.T @ pulls]) @ own.T
        return Instruments(Lateness(float(late[k]), sd), own @ best, C)

    def _joined(self) -> tuple[NormalEquations, Float[Tensor, "some some"], Float[Tensor, "some some"]]:
        """Return all blocks together, the precision before them of body, zeros and gains, and the matrix that takes
        from each gain the mean of all, each counted by what its plate bears."""
        rows, body = sum(list(self._blocks)[1:], self._blocks[0]), self._body
        size = len(rows.moment) - self._terms
        share = rows.gram.diagonal()[body:size] / rows.gram.diagonal()[body:size].sum().clamp(min=1e-12)
        apart = torch.eye(size).to(share)
        apart[body:, body:] -= share
        prior = torch.eye(size).to(share) / PRIOR_SD**2
        prior[:body, :body] = torch.block_diag(self._precision, self._zero / (size - body))
        return rows, prior, apart

    def _left(self, weights: Float[Tensor, " columns"]) -> Float[Tensor, "blocks columns"]:
        """Return the products of all columns with what each block leaves, times the root of n / (n - 1)."""
        n = len(self._blocks)
        return torch.stack([block.gram @ weights for block in self._blocks]) * math.sqrt(n / max(n - 1, 1))


def _deviation(late: Float[Tensor, " some"], cost: Float[Tensor, " some"], best: int, information: float) -> float:
    """Return the standard deviation of lateness about the best, of all that is tried.

    The square of the forces' slope counts their noise as if it told of a clock. The curvature of the cost does not: it
    is what the slopes of forces and of the body have in common. The log likelihood counts by the part that this is of
    how far its own slope scatters (Ribatet, Cooley & Davison, Statistica Sinica 22:813 (2012)), by the noise or between
    blocks, whichever is more. Of a sharp minimum that is the sandwich estimator.

    Args:
        late: what is tried [s].
        cost: twice the negative log likelihood of each.
        best: number of the least.
        information: that part, from 0 to 1.
    """
    weight = (-0.5 * information * (cost - cost[best])).exp()
    return float((weight @ (late - late[best]).square()) / weight.sum()) ** 0.5


def _series_of(rows: WrenchTrial, part: slice) -> Float[Tensor, "terms frames 6"]:
    """Return the coefficients by Chebyshev's polynomials of the total wrench in some frames, as it comes ever later."""
    cutoff_hz = BEYOND * rows.motion.smoother.cutoff_hz
    n = math.ceil(2.0 * math.pi * cutoff_hz * LATEST_S) + MORE_TERMS
    nodes = np.cos(math.pi * (np.arange(n) + 0.5) / n)
    more = math.ceil(LATEST_S * rows.rate) + MARGIN
    around = slice(max(part.start - more, 0), part.stop + more)
    inner = slice(part.start - around.start, part.stop - around.start)
    late = delayed(rows.motion.time[around], rows.wrench[around], (-LATEST_S * nodes).tolist())[:, inner]
    basis = chebyshev.chebvander(nodes, n - 1).T * (2.0 / n)
    basis[0] /= 2.0
    return torch.einsum("kn,nfc->kfc", torch.from_numpy(basis).to(late), late)


def _weights(late_s: Float[Tensor, " some"], terms: int, order: int = 0) -> Float[Tensor, "some terms"]:
    """Return the weights of the coefficients at some lateness, or of a derivative by it."""
    some = np.eye(terms)
    for _ in range(order):
        some = chebyshev.chebder(some) / LATEST_S
    return torch.from_numpy(chebyshev.chebval(late_s.cpu().numpy() / LATEST_S, some).T.copy()).to(late_s)
