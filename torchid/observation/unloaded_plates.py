"""Readings of plates while they bear nothing, which are their zero errors and nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.dynamics.whitening import white_scatter
from torchid.effects.columns import STEP
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.plate_map import ZeroError, to_plate
from torchid.effects.scene import Reading
from torchid.observation.options import ObservationOptions
from torchid.observation.statements import Statements
from torchid.runs import runs

LOWEST = 0.02
"""Estimator. Part of the frames that lie below the lowest value that counts."""
READ = 0.99
"""Estimator. Share of a sample that a plate read itself from which it counts as read: filters smear where zeros end."""
SCATTER = (0.2, 0.2, 0.2, 0.05, 0.05, 0.05)
"""Estimator. Standard deviation of a run's mean [N, N m], a choice: zeros wander within a trial, whatever the noise;
strain-gauge and charge amplifiers are specified to some tenths of a newton a minute."""


@dataclass(frozen=True)
class UnloadedPlates:
    """Mean readings of the longest unloaded run of each plate of a trial, or of its halves, in the plate's axes."""

    reading: Reading
    """Reading of the trial's plates on its clock, with all wrenches zero."""
    runs: tuple[tuple[int, slice, Float[Tensor, " 6"], Float[Tensor, " 6"]], ...]
    """Number of the plate, frames, mean reading and its standard deviation [N, N m]."""


def find_unloaded(raw: Reading, rate: float, options: ObservationOptions = ObservationOptions()) -> UnloadedPlates:
    """Return the longest run of each plate in which it bears nothing, or its halves, and what it reads there.

    Samples that a program wrote as zero say nothing.

    Args:
        raw: readings of the plates before any filter.
        rate: samples per second [Hz].
    """
    found = []
    for k, frame in enumerate(raw.frames):
        load, own = raw.wrench[:, k, 2], raw.read_by(k)
        low = float(load.quantile(LOWEST))
        quiet = ((load - low).abs() < LOADED_N) & (own > READ) & (abs(low) < options.zero_most_N)
        edge, noise = round(options.unloaded_edge_s * rate), float(white_scatter(load[:, None]))
        some = [(a, b) for a, b in runs(quiet) if b - a >= options.unloaded_least_s * rate]
        foot, short = load - low > options.sudden_N, options.unloaded_short_s * rate
        some = [(a, b) for a, b in some if b - a >= short or _sudden(foot, a - edge, b - 1 + edge)]
        parts = [slice(a + edge, b - edge) for a, b in some]
        still = [part for part in parts if _still(load[part], rate, noise, options)]
        if still:
            part = max(still, key=lambda part: part.stop - part.start)
            for half in _halves(part, short):
                read = to_plate(frame, raw.wrench[half, k])
                error = (read.new_tensor(SCATTER).square() + read.var(0) / len(read)).sqrt()
                found.append((k, half, read.mean(0), error))
    return UnloadedPlates(replace(raw, wrench=torch.zeros_like(raw.wrench)), tuple(found))


def _halves(part: slice, shortest: float) -> tuple[slice, ...]:
    """Return both halves of a run, which tell a drift from a zero; of a short one the whole."""
    middle = (part.start + part.stop) // 2
    return (slice(part.start, middle), slice(middle, part.stop)) if middle - part.start >= shortest else (part,)


def _still(load: Float[Tensor, " frames"], rate: float, noise: float, options: ObservationOptions) -> bool:
    """Return whether the parabola through a run is flat within the plate's noise."""
    s = torch.linspace(-1.0, 1.0, len(load)).to(load)
    A = torch.stack([torch.ones_like(s), s, s.square()], 1)
    _, lean, bend = torch.linalg.lstsq(A, load[:, None]).solution[:, 0].abs().tolist()
    _, leans, bends = (noise * torch.linalg.inv(A.T @ A).diagonal().sqrt()).tolist()
    drift = 0.5 * options.still_N_s * len(load) / rate
    sd = options.still_sd
    return lean < options.still_N + drift + sd * leans and bend < options.still_N + sd * bends


def _sudden(foot: Bool[Tensor, " frames"], *ends: int) -> bool:
    """Return whether a foot stands on the plate at frames just outside a run."""
    return all(0 <= k < len(foot) and bool(foot[k]) for k in ends)


def zero_statistics(unloaded: UnloadedPlates, sources: Sequence[tuple[Effect, Place, slice]]) -> Statements | None:
    """Return what unloaded plates state of zero errors; None where no plate is unloaded.

    Args:
        unloaded: readings of a trial's plates while they bear nothing.
        sources: effect, place and columns of all sources of the trial's design.
    """
    own = [(effect, place, at) for effect, place, at in sources if isinstance(effect, ZeroError)]
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
    return Statements(columns, rows.T @ rows, rows.T @ torch.cat(y))


def _responses(nothing: Reading, effect: Effect, place: Place) -> list[Reading]:
    """Return what plates that bear nothing read by each parameter of a zero error, per unit."""
    found = []
    for k, scale in enumerate(effect.scale(place)):
        theta = nothing.wrench.new_zeros(effect.size(place))
        theta[k] = STEP * scale
        read = effect.read(nothing, place, theta)
        found.append(replace(read, wrench=read.wrench / theta[k]))
    return found
