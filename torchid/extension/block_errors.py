"""Errors of a model block by block, on the same frames as those of another model of the same recordings.

Forces are judged by what plates read: an extended model predicts what motion needs and what the named effects add to
it, so that its residual is that of the readings as they were measured. A correction changes the prediction, never what
is predicted, and none can win by shrinking it; effects that shift readings or exchange plates keep their size. Markers
are judged by their distance from the model, as a part of the size of the body that they show: a correction that scales
all of them scales both.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.config import Config
from torchid.conventions import ZERO_SD_N, ZERO_SD_NM
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import SHORTEST, WrenchTrial
from torchid.dynamics.whitening import Whitening, accumulate, block_spectrum
from torchid.effects.place import inside_any
from torchid.extension.diagnosing import forceful
from torchid.inertia.left_out import leave_out_each
from torchid.motion import Motion
from torchid.runs import runs
from torchid.session import Outcome
from torchid.session.fitting import given_mass

BLOCK_S = 1.0
"""Choice. Shortest block [s]: what a filter of 4 Hz or more leaves is forgotten in a quarter of it, so that blocks are
nearly independent."""
PERIODIC = 0.5
"""Choice. Correlation of a motion with itself, one period later, from which on it is periodic: half of its energy
repeats."""
LEFT_OUT, FITTED, HELD_OUT = "fit trials, each block left out in turn", "fit trials", "held-out trials"
"""Groups of blocks."""
Group = tuple[str, str]
"""Which of these, and errors of what: force, moment or markers."""
FLOOR_N, FLOOR_NM = 3.0**0.5 * ZERO_SD_N, 3.0**0.5 * ZERO_SD_NM
"""Derived. Errors that say nothing: plates' zeros scatter by as much in all three directions. In quiet standing, no
more may be left [N, N m]."""


@dataclass(frozen=True)
class BlockErrors:
    """Errors of a model in several blocks."""

    rms: Float[Tensor, " blocks"]
    """Force [N] and moment about the base model's pelvis [N m], each with the floor beside it, or distance of markers
    as a part of the body's size."""
    frames: Float[Tensor, " blocks"]
    """Number of frames of each block."""


@dataclass(frozen=True)
class SessionBlocks:
    """Blocks of the fit and held-out trials of a session, by trial."""

    wrench: dict[str, tuple[slice, ...]]
    """Runs of frames that count, of trials with forces."""
    judged: dict[str, Bool[Tensor, " frames"]]
    """Frames whose forces are judged: that count and that no cause sets aside."""
    markers: dict[str, tuple[slice, ...]]
    """All frames."""


def cut_blocks(base: Outcome) -> SessionBlocks:
    """Cut the trials into blocks of a cycle or a second, whichever is longer; a shorter run is one block.

    Frames that named causes set aside are judged for no model. All others that count for the base model are, whether
    or not an extended one uses them: none wins by what it leaves out.

    Args:
        base: before it was extended, with the verdict on it.
    """
    aside = () if base.diagnosis is None else base.diagnosis.aside
    wrench, judged, markers = {}, {}, {}
    for name, item in base.followed.items():
        if base.session.trials[name].role != "static":
            everything = torch.ones(len(item.motion.time), dtype=torch.bool)
            markers[name] = _cut(everything, block_frames(item.motion))
    for name, rows in (forceful(base, "fit") | forceful(base, "heldout")).items():
        wrench[name] = _cut(rows.used, block_frames(rows.motion))
        judged[name] = rows.used & ~inside_any(aside, name, rows.motion.time)
    return SessionBlocks(wrench, judged, markers)


def block_frames(motion: Motion) -> int:
    """Frames of a block of a motion: those of ``BLOCK_S``, or of the shortest period that is longer.

    Args:
        motion: of a trial; its period is the first peak of the correlation of all joint rates with themselves.
    """
    shortest = max(SHORTEST, round(BLOCK_S * motion.smoother.rate_hz))
    v = motion.v[:, 6:] - motion.v[:, 6:].mean(0)
    n = len(v)
    if n < 2 * shortest or not v.numel():
        return shortest
    spectrum = torch.fft.rfft(v, 2 * n, dim=0)
    shared = torch.fft.irfft(spectrum.abs().square().sum(1), 2 * n)[:n]
    energy = torch.nn.functional.pad(v.square().sum(1).cumsum(0), (1, 0))
    lag = torch.arange(shortest, n // 2)
    correlation = shared[lag] / (energy[n - lag] * (energy[n] - energy[lag])).sqrt().clamp(min=1e-300)
    inner = correlation[1:-1]
    peaks = ((inner >= correlation[:-2]) & (inner >= correlation[2:]) & (inner > PERIODIC)).nonzero()
    return shortest + 1 + int(peaks[0]) if len(peaks) else shortest


def _cut(flag: Bool[Tensor, " frames"], length: int) -> tuple[slice, ...]:
    """Runs of True that are long enough, cut evenly into pieces of at least a length."""
    found: list[slice] = []
    for start, stop in runs(flag):
        if stop - start >= SHORTEST:
            pieces = max(1, (stop - start) // length)
            edges = [start + round(k * (stop - start) / pieces) for k in range(pieces + 1)]
            found += [slice(a, b) for a, b in zip(edges, edges[1:], strict=False)]
    return tuple(found)


def block_errors(outcome: Outcome, base: Outcome, config: Config, blocks: SessionBlocks) -> dict[Group, BlockErrors]:
    """Errors of a model in all blocks, by group.

    For a block of a fit trial the inertia is also that which all others determine (``leave_out_each``), under the noise
    of the model's own fit. Geometry and the parameters of causes have seen the block.

    Args:
        outcome: the model.
        base: the one about whose pelvis moments are.
        config: that the model was fitted with.
        blocks: of the base model.
    """
    found: dict[Group, BlockErrors] = {}
    fits = {name: parts for name, parts in blocks.wrench.items() if base.session.trials[name].role == "fit"}
    every = [(name, part) for name, parts in fits.items() for part in parts]
    phi = outcome.phi.reshape(-1)
    for where, some in ((LEFT_OUT, _left_out(outcome, config, every)), (FITTED, [phi] * len(every))):
        found |= _wrench_errors(outcome, base, where, every, some, blocks)
    unseen = [(name, part) for name, parts in blocks.wrench.items() if name not in fits for part in parts]
    found |= _wrench_errors(outcome, base, HELD_OUT, unseen, [phi] * len(unseen), blocks)
    return found | dict(_marker_errors(outcome, blocks))


def _left_out(outcome: Outcome, config: Config, every: list[tuple[str, slice]]) -> list[Float[Tensor, " params"]]:
    identified = outcome.identified
    assert identified is not None
    sums = [_sums(_rows(outcome, name), part, identified.whitening) for name, part in every]
    fit, known = identified.fit, given_mass(config.inertia, config.subject, outcome)
    return leave_out_each(sums, outcome.prior, fit.names, config.inertia, fit.omega_2, known) if sums else []


def _sums(rows: WrenchTrial, part: slice, whitening: Whitening) -> NormalEquations:
    """Whitened sums of the frames of a block that the model uses."""
    own = [slice(part.start + a, part.start + b) for a, b in runs(rows.used[part]) if b - a >= SHORTEST]
    params = 10 * len(rows.tree.bodies)
    nothing = NormalEquations(rows.wrench.new_zeros(params, params), rows.wrench.new_zeros(params), 0.0, 0)
    return accumulate((block_spectrum(rows, one) for one in own), whitening) if own else nothing


def _rows(outcome: Outcome, name: str) -> WrenchTrial:
    rows = outcome.followed[name].wrench
    assert rows is not None
    return rows


def _wrench_errors(
    outcome: Outcome,
    base: Outcome,
    where: str,
    every: list[tuple[str, slice]],
    phi: list[Tensor],
    blocks: SessionBlocks,
) -> dict[Group, BlockErrors]:
    squares, frames = [], []
    for (name, part), params in zip(every, phi, strict=True):
        judged = blocks.judged[name][part]
        if int(judged.sum()) >= SHORTEST:
            left = _residual(_rows(outcome, name), _rows(base, name), part, params)[judged]
            squares.append(left.square().reshape(-1, 2, 3).sum(2).mean(0))
            frames.append(float(len(left)))
    if not squares:
        return {}
    floor = torch.tensor([FLOOR_N, FLOOR_NM], dtype=torch.float64)
    both, count = (torch.stack(squares) + floor.square()).sqrt(), torch.tensor(frames, dtype=torch.float64)
    return {(where, kind): BlockErrors(both[:, k], count) for k, kind in enumerate(("force", "moment"))}


def _residual(rows: WrenchTrial, base: WrenchTrial, part: slice, phi: Tensor) -> Float[Tensor, "frames 6"]:
    """What parameters leave of the plates' reading, about the base model's pelvis."""
    Y, F = rows.rows(part)
    left = (F - torch.einsum("ipt,p->it", Y, phi)).T
    return wrench_about(left, base.motion.q[part, :3] - rows.motion.q[part, :3])


def _marker_errors(outcome: Outcome, blocks: SessionBlocks) -> Iterator[tuple[Group, BlockErrors]]:
    roles = {name: outcome.session.trials[name].role for name in blocks.markers}
    for where, wanted in ((FITTED, "fit"), (HELD_OUT, "heldout")):
        names = [name for name, role in roles.items() if role == wanted]
        each = [_markers_off(outcome, name, part) for name in names for part in blocks.markers[name]]
        known = [one for one in each if one is not None]
        if known:
            rms, frames = torch.tensor(known, dtype=torch.float64).T
            yield (where, "markers"), BlockErrors(rms, frames)


def _markers_off(outcome: Outcome, name: str, part: slice) -> tuple[float, float] | None:
    """RMS distance of markers as a part of the RMS distance from their middle, and frames; None where none is seen."""
    error = outcome.followed[name].tracked.error[part]
    markers = outcome.session.trials[name].markers.frames(part).select(outcome.fit.attachment.labels)
    size = (markers.position - markers.position.nanmean(1, keepdim=True)).square().sum(2)
    known = torch.isfinite(error) & torch.isfinite(size)
    if not bool(known.any()):
        return None
    return float((error[known].square().sum() / size[known].sum()).sqrt()), float(len(error))
