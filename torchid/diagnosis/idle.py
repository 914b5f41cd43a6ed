"""What plates read while they bear nothing: their zero errors, and nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.effects.effect import STEP, Effect, Place
from torchid.effects.plates import to_plate
from torchid.effects.scene import Reading
from torchid.regressor.rows import runs

LOADED = 20.0
"""Vertical force beyond a plate's lowest below which it bears nothing [N]."""
ZERO = 100.0
"""No plate's zero is that far off [N]: one that never reads less was stood on all the time."""
LEAST_S = 0.5
"""Length of a run that counts."""
SCATTER = (0.2, 0.2, 0.2, 0.05, 0.05, 0.05)
"""Of a run's mean [N, N m]: zeros wander within a trial, whatever the noise."""


@dataclass(frozen=True)
class Idle:
    """Mean readings of the longest unloaded run of each plate of a trial, in the plate's axes."""

    reading: Reading
    """Its clock and frames; bears nothing."""
    runs: tuple[tuple[int, slice, Float[Tensor, " 6"]], ...]


@dataclass(frozen=True)
class IdleSums:
    """Gram matrix and moment of those rows."""

    columns: Int[Tensor, " some"]
    gram: Float[Tensor, "some some"]
    moment: Float[Tensor, " some"]


def find_idle(raw: Reading, rate: float) -> Idle:
    """Plates that read exactly zero were zeroed by a program: they say nothing."""
    found = []
    for k, frame in enumerate(raw.frames):
        load = raw.wrench[:, k, 2]
        low = float(load.quantile(0.02))
        quiet = ((load - low).abs() < LOADED) & (raw.wrench[:, k] != 0.0).any(1) & (abs(low) < ZERO)
        start, stop = max(runs(quiet), key=lambda run: run[1] - run[0], default=(0, 0))
        if stop - start >= LEAST_S * rate:
            part = slice(start, stop)
            found.append((k, part, to_plate(frame, raw.wrench[part, k]).mean(0)))
    return Idle(replace(raw, wrench=torch.zeros_like(raw.wrench)), tuple(found))


def idle_sums(idle: Idle, sources: Sequence[tuple[Effect, Place, slice]]) -> IdleSums | None:
    """Against the columns of zero errors; None where nothing is idle."""
    own = [(effect, place, at) for effect, place, at in sources if effect.name in ("plate_offset", "plate_drift")]
    columns = torch.tensor([k for _, _, at in own for k in range(at.start, at.stop)], dtype=torch.long)
    if not idle.runs or not len(columns):
        return None
    responses = [r for effect, place, _ in own for r in _responses(idle.reading, effect, place)]
    weight = idle.reading.wrench.new_tensor(SCATTER).reciprocal()
    X, y = [], []
    for k, part, mean in idle.runs:
        X.append(
            weight[:, None] * torch.stack([to_plate(r.frames[k], r.wrench[part, k]).mean(0) for r in responses], 1)
        )
        y.append(weight * mean)
    rows = torch.cat(X)
    return IdleSums(columns, rows.T @ rows, rows.T @ torch.cat(y))


def _responses(nothing: Reading, effect: Effect, place: Place) -> list[Reading]:
    found = []
    for k, scale in enumerate(effect.scale(place)):
        theta = nothing.wrench.new_zeros(effect.size(place))
        theta[k] = STEP * scale
        read = effect.read(nothing, place, theta)
        found.append(replace(read, wrench=read.wrench / theta[k]))
    return found
