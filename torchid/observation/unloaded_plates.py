"""What plates read while they bear nothing: their zero errors, and nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.effects.columns import STEP
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.plates import to_plate
from torchid.effects.scene import Reading
from torchid.regressor.rows import runs
from torchid.regressor.whitening import white_scatter

LOADED = 20.0
"""Vertical force beyond a plate's lowest below which it bears nothing [N]."""
ZERO = 100.0
"""No plate's zero is that far off [N]: one that never reads less was stood on all the time."""
LEAST_S, EDGE_S = 0.2, 0.04
"""Length of a run that counts, and what is cut off at its ends: filters carry a stance into the swing. With half a
second as the least, a runner's plates were never idle, and one was 39 N off that read 0.1 N in every swing."""
STILL_N, DRIFT_N_S, SHORT_S = 2.0, 2.0, 0.5
"""By how much a plate's load may bend within a run, and lean, the more the longer it lasts, beside its noise; shorter
ones do not tell, but end in a moment. The least that a foot bears while the weight is on the other was taken for a zero
error of 44 N, and for drifts of 3 N/s."""
SCATTER = (0.2, 0.2, 0.2, 0.05, 0.05, 0.05)
"""Of a run's mean [N, N m]: zeros wander within a trial, whatever the noise."""


@dataclass(frozen=True)
class UnloadedPlates:
    """Mean readings of the longest unloaded run of each plate of a trial, in the plate's axes."""

    reading: Reading
    """Its clock and frames; bears nothing."""
    runs: tuple[tuple[int, slice, Float[Tensor, " 6"], Float[Tensor, " 6"]], ...]
    """Plate, frames, mean and its error."""


@dataclass(frozen=True)
class ZeroStatistics:
    """Gram matrix and moment of those rows."""

    columns: Int[Tensor, " some"]
    gram: Float[Tensor, "some some"]
    moment: Float[Tensor, " some"]


def find_unloaded(raw: Reading, rate: float) -> UnloadedPlates:
    """Plates that read exactly zero were zeroed by a program: they say nothing."""
    found = []
    for k, frame in enumerate(raw.frames):
        load = raw.wrench[:, k, 2]
        low = float(load.quantile(0.02))
        quiet = ((load - low).abs() < LOADED) & (raw.wrench[:, k] != 0.0).any(1) & (abs(low) < ZERO)
        edge, noise = round(EDGE_S * rate), float(white_scatter(load[:, None]))
        some = [(a, b) for a, b in runs(quiet) if b - a >= LEAST_S * rate]
        some = [(a, b) for a, b in some if b - a >= SHORT_S * rate or _sudden(load - low, a - edge, b - 1 + edge)]
        parts = [slice(a + edge, b - edge) for a, b in some]
        still = [part for part in parts if _still(load[part], rate, noise)]
        if still:
            part = max(still, key=lambda part: part.stop - part.start)
            read = to_plate(frame, raw.wrench[part, k])
            error = (read.new_tensor(SCATTER).square() + read.var(0) / len(read)).sqrt()
            found.append((k, part, read.mean(0), error))
    return UnloadedPlates(replace(raw, wrench=torch.zeros_like(raw.wrench)), tuple(found))


def _still(load: Float[Tensor, " frames"], rate: float, noise: float) -> bool:
    """Whether the parabola through a run is flat."""
    s = torch.linspace(-1.0, 1.0, len(load)).to(load)
    A = torch.stack([torch.ones_like(s), s, s.square()], 1)
    _, lean, bend = torch.linalg.lstsq(A, load[:, None]).solution[:, 0].abs().tolist()
    _, leans, bends = (noise * torch.linalg.inv(A.T @ A).diagonal().sqrt()).tolist()
    drift = 0.5 * DRIFT_N_S * len(load) / rate
    return lean < STILL_N + drift + 1.5 * leans and bend < STILL_N + 1.5 * bends


def _sudden(load: Float[Tensor, " frames"], *ends: int) -> bool:
    """Whether a foot stands on the plate just outside a run."""
    return all(0 <= k < len(load) and float(load[k]) > 3.0 * LOADED for k in ends)


def zero_statistics(unloaded: UnloadedPlates, sources: Sequence[tuple[Effect, Place, slice]]) -> ZeroStatistics | None:
    """Against the columns of zero errors; None where nothing is idle."""
    own = [(effect, place, at) for effect, place, at in sources if effect.name in ("plate_offset", "plate_drift")]
    columns = torch.tensor([k for _, _, at in own for k in range(at.start, at.stop)], dtype=torch.long)
    if not unloaded.runs or not len(columns):
        return None
    responses = [r for effect, place, _ in own for r in _responses(unloaded.reading, effect, place)]
    X, y = [], []
    for k, part, mean, error in unloaded.runs:
        own = torch.stack([to_plate(r.frames[k], r.wrench[part, k]).mean(0) for r in responses], 1)
        X.append(own / error[:, None])
        y.append(mean / error)
    rows = torch.cat(X)
    return ZeroStatistics(columns, rows.T @ rows, rows.T @ torch.cat(y))


def _responses(nothing: Reading, effect: Effect, place: Place) -> list[Reading]:
    found = []
    for k, scale in enumerate(effect.scale(place)):
        theta = nothing.wrench.new_zeros(effect.size(place))
        theta[k] = STEP * scale
        read = effect.read(nothing, place, theta)
        found.append(replace(read, wrench=read.wrench / theta[k]))
    return found
