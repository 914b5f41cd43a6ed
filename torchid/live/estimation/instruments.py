"""Clock and gains of the plates, found beside the body from the newest rows.

Forces that come ``late`` and plates that read by a part ``gain_k`` of themselves too much leave

    sum_n late^n / n! d^n F / dt^n = Y phi + sum_k gain_k F_k.

Asked of what the identified body leaves, most of either would be missed: the body has been identified from the same
rows, and has become one to which they fit. The first derivative alone would not do, for it comes late itself.
"""

import math
from collections import deque
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import SHORTEST, WrenchTrial
from torchid.dynamics.whitening import accumulate, initial_whitening, spectrum
from torchid.model.model import InertialPrior

REMEMBERED = 10
"""Choice. Blocks over which clocks and gains are judged: a step or two of every kind of motion."""
PRIOR_SD = 1.0
"""Choice. Standard deviation of a gain before any data: it says nothing, and keeps a plate that nobody is on
solvable."""
PASSES = 4
"""Choice. Times that the noise is estimated anew; it settles to a per cent in three."""
TERMS = 4
"""Choice. Terms of the series: at 4 Hz and 60 ms, what follows is a tenth of the force."""
LATEST_S, STEP_S = 0.1, 0.001
"""Choice. Longest lateness that is tried, at which the series is still of use; and the step."""


@dataclass(frozen=True)
class Instruments:
    """What rows say of clock and gains."""

    late_s: float
    """By how much forces come late."""
    late_sd_s: float
    gain: Float[Tensor, " plates"]
    """By which part of itself each plate reads too much, beside all of them: what they have in common is the mass."""
    gain_covariance: Float[Tensor, "plates plates"]

    def most_apart(self) -> tuple[int, int, float, float]:
        """Return the plates that disagree most: the one that reads more, the other, by how much, and its deviation."""
        C, apart = self.gain_covariance, self.gain[:, None] - self.gain
        variance = C.diagonal()[:, None] + C.diagonal() - 2.0 * C
        score = torch.where(apart > 0.0, apart / variance.clamp(min=1e-12).sqrt(), 0.0)
        high, low = divmod(int(score.argmax()), len(self.gain))
        return high, low, float(apart[high, low]), float(variance[high, low].clamp(min=1e-12).sqrt())


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
        self._blocks: deque[NormalEquations] = deque(maxlen=REMEMBERED)

    def add(self, rows: WrenchTrial, plates: Float[Tensor, "frames plates 6"], part: slice) -> None:
        """Take in a block.

        Args:
            rows: of its frames and those around it.
            plates: what each plate reads in them, through the same filter, about the world's origin [N, N m].
            part: the block.
        """
        used = rows.used[part]
        if int(used.sum()) <= SHORTEST:
            return
        p, series = rows.motion.q[part, :3], [rows.wrench]
        for _ in range(TERMS - 1):
            series.append(torch.gradient(series[-1], dim=0)[0] * rows.rate)
        # Where a plate bears nothing, its noise would explain the noise that it brings into the total.
        borne = plates * (plates[..., 2:3] > LOADED_N)
        columns = [wrench_about(one[part], p).T for one in (*borne.unbind(1), *series)]
        Y, F = rows.rows(part)
        X = torch.cat([Y, torch.stack(columns, 1)], 1)
        block = spectrum(X[:, :, used], F[:, used], rows.rate, rows.motion.smoother.cutoff_hz)
        self._blocks.append(accumulate([block], initial_whitening(F)))

    def found(self) -> Instruments | None:
        """Return what the rows say; None before the first.

        The noise is as large as what all of it together leaves, in the proportions of ``initial_whitening``.
        """
        if not self._blocks:
            return None
        rows, body = sum(list(self._blocks)[1:], self._blocks[0]), len(self._precision)
        size = len(rows.moment) - TERMS
        share = rows.gram.diagonal()[body:size] / rows.gram.diagonal()[body:size].sum().clamp(min=1e-12)
        apart = torch.eye(size).to(share)
        apart[body:, body:] -= share
        A, B, D = apart.T @ rows.gram[:size, :size] @ apart, apart.T @ rows.gram[:size, size:], rows.gram[size:, size:]
        prior = torch.eye(size).to(A) / PRIOR_SD**2
        prior[:body, :body] = self._precision
        late = torch.arange(-LATEST_S, LATEST_S + STEP_S / 2.0, STEP_S).to(A)
        series, noise, C, best, k = _series(late, 0), 1.0, A, B[:, 0], 0
        for _ in range(PASSES):
            C = torch.linalg.inv(A / noise + prior)
            right = series @ B.mT / noise
            cost = ((series @ D) * series).sum(1) / noise - ((right @ C) * right).sum(1)
            k = int(cost.argmin())
            best, now = right[k] @ C, series[k]
            left = float(now @ D @ now - 2.0 * best @ B @ now + best @ A @ best)
            noise = left / max(rows.rows - float((C * A).sum()) / noise, 1.0)
        slope = _series(late[k : k + 1], 1)[0]
        told = float(slope @ D @ slope) / noise - float((B @ slope) @ C @ (B @ slope)) / noise**2
        best, C = apart @ best, apart @ C @ apart.T
        return Instruments(float(late[k]), max(told, 1e-12) ** -0.5, best[body:], C[body:, body:])


def _series(late_s: Float[Tensor, " some"], order: int) -> Float[Tensor, "some terms"]:
    """Return the weights of a force and its derivatives in Taylor's series, or in a derivative of it by lateness."""
    n = torch.arange(TERMS) - order
    weights = torch.stack([late_s ** max(k, 0) / math.factorial(max(k, 0)) for k in n.tolist()], 1)
    return weights * (n >= 0)
