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
LEAST_S, EDGE_S = 0.2, 0.04
"""Length of a run that counts, and what is cut off at its ends: filters carry a stance into the swing. With half a
second as the least, a runner's plates were never idle, and one was 39 N off that read 0.1 N in every swing."""
SCATTER = (0.2, 0.2, 0.2, 0.05, 0.05, 0.05)
"""Of a run's mean [N, N m]: zeros wander within a trial, whatever the noise."""


@dataclass(frozen=True)
class Idle:
    """Mean readings of the longest unloaded run of each plate of a trial, in the plate's axes."""

    reading: Reading
    """Its clock and frames; bears nothing."""
    runs: tuple[tuple[int, slice, Float[Tensor, " 6"], Float[Tensor, " 6"]], ...]
    """Plate, frames, mean and its error."""


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
            edge = round(EDGE_S * rate)
            part = slice(start + edge, stop - edge)
            read = to_plate(frame, raw.wrench[part, k])
            error = (read.new_tensor(SCATTER).square() + read.var(0) / len(read)).sqrt()
            found.append((k, part, read.mean(0), error))
    return Idle(replace(raw, wrench=torch.zeros_like(raw.wrench)), tuple(found))


def idle_sums(idle: Idle, sources: Sequence[tuple[Effect, Place, slice]]) -> IdleSums | None:
    """Against the columns of zero errors; None where nothing is idle."""
    own = [(effect, place, at) for effect, place, at in sources if effect.name in ("plate_offset", "plate_drift")]
    columns = torch.tensor([k for _, _, at in own for k in range(at.start, at.stop)], dtype=torch.long)
    if not idle.runs or not len(columns):
        return None
    responses = [r for effect, place, _ in own for r in _responses(idle.reading, effect, place)]
    X, y = [], []
    for k, part, mean, error in idle.runs:
        own = torch.stack([to_plate(r.frames[k], r.wrench[part, k]).mean(0) for r in responses], 1)
        X.append(own / error[:, None])
        y.append(mean / error)
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
