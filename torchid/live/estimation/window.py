"""Some frames of a stream in a row, and the small trial that they are."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.rows import SHORTEST
from torchid.geometry.tracking import Tracked
from torchid.io.resample import to_clock
from torchid.recording import Forces, Markers, Trial

BRIDGED_S = 0.04
"""Choice. Postures that are missing for no longer are taken on a straight line between their neighbours: a quarter of
the period of 6 Hz, in which the straight line is wrong by less than the filter takes away."""


@dataclass(frozen=True)
class Window:
    """What came in some frames in a row."""

    time: Float[Tensor, " frames"]
    """On the stream's uniform clock [s]."""
    q: Float[Tensor, "frames dofs"]
    """Coordinates, NaN where no posture is known [m or rad]."""
    error: Float[Tensor, "frames markers"]
    """Distance between measured and modelled marker, NaN where missing [m]."""
    position: Float[Tensor, "frames seen 3"]
    """Of the stream's markers [m]."""
    forces: Forces | None
    """On their own clock; None without plates."""

    def trial(self, name: str, labels: tuple[str, ...], rate_hz: float) -> tuple[Trial, Tracked] | None:
        """Return the window as a trial that was followed; None where no posture or no force in it is known.

        Args:
            name: of the trial.
            labels: of the stream's markers.
            rate_hz: of the frames.
        """
        if len(self.time) <= SHORTEST or self.forces is None or not bool(self.forces.wrench.isfinite().any()):
            return None
        q, error = _bridged(self.q, self.error, round(BRIDGED_S * rate_hz))
        seen = torch.isfinite(error).any(1)
        if not bool(seen.any()):
            return None
        # What no posture explains is no distance of a marker from the model: as where labels are exchanged.
        known = torch.isfinite(self.error).any(1)
        markers = Markers(labels, self.time, torch.where(known[:, None, None], self.position, torch.nan))
        tracked = Tracked(self.time, _held(q, seen), error, seen)
        return Trial(name, markers, to_clock(self.forces, self.time)), tracked


def _bridged(q: Tensor, error: Tensor, longest: int) -> tuple[Tensor, Tensor]:
    """Coordinates and distances with short gaps on straight lines; where an angle changes its turn, it stays a gap."""
    seen = torch.isfinite(error).any(1)
    index = torch.arange(len(q))
    before = torch.where(seen, index, -1).cummax(0).values
    after = torch.where(seen, index, len(q)).flip(0).cummin(0).values.flip(0)
    short = ~seen & (before >= 0) & (after < len(q)) & (after - before <= longest + 1)
    at = short.nonzero()[:, 0]
    a, b = before[at], after[at]
    near = ((q[b] - q[a]).abs() < math.pi).all(1)
    at, a, b = at[near], a[near], b[near]
    q, error = q.clone(), error.clone()
    q[at] = torch.lerp(q[a], q[b], ((at - a).to(q) / (b - a).to(q))[:, None])
    error[at] = error[a]
    return q, error


def _held(q: Float[Tensor, "frames dofs"], seen: Tensor) -> Float[Tensor, "frames dofs"]:
    """Coordinates, those of frames that are not seen as in the seen frame before, or the first one."""
    index = torch.arange(len(q))
    last = torch.where(seen, index, -1).cummax(0).values
    return q[torch.where(last < 0, int(seen.nonzero()[0]), last)]
