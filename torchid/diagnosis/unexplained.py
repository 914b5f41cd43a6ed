"""Whether the residual holds more than noise, by a model of the noise that no residual has entered.

Plates' noise is what their unloaded channels show; markers' noise is what a label does from one frame to the next
beyond what a person can. Draws of both pass the same chain as the recording (postures, filter, inverse dynamics), so
that every band of the residual has an expectation. What exceeds it is structure, whatever its name.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.cameras import Cameras
from torchid.diagnosis.watched import Watched
from torchid.dynamics import wrench_about
from torchid.effects.momentum import wrench_of
from torchid.regressor.whitening import EDGES, bands, coefficients, cosine_matrix

SHARE = 0.35
"""Part of a band's residual that noise does not explain, from which on it matters: half as much again as the noise.
Below, fits to other people's models and slightly coloured noise go as far."""
P_VALUE = 0.01
DRAWS = 4
"""Of the noise of each trial."""
ENOUGH = 30
"""Coefficients below which a band tells nothing."""
KINDS = (("force", slice(0, 3)), ("moment", slice(3, 6)))


@dataclass(frozen=True)
class Structure:
    """What remains when all that is named is taken out."""

    significant: bool
    p_value: float
    share_of_residual: float
    description: str


@dataclass(frozen=True)
class Energy:
    """Of the cosine coefficients of one trial: measured and expected, by kind and band."""

    trial: str
    left: Float[Tensor, "kinds bands"]
    noise: Float[Tensor, "kinds bands"]
    count: Float[Tensor, " bands"]


def structure(watched: Sequence[Watched], left: Sequence[Float[Tensor, "frames 6"]]) -> Structure:
    """Judge the residuals of the extended model.

    Args:
        watched: trials.
        left: residual of each about the root's origin.
    """
    found = [_energy(w, w.cameras, r) for w, r in zip(watched, left, strict=True) if w.cameras is not None]
    if not found:
        return Structure(False, float("nan"), float("nan"), "cannot be told: no camera shows the noise")
    count = torch.stack([e.count for e in found]).sum(0)
    total = torch.stack([e.left for e in found]).sum(0)
    noise = torch.stack([e.noise for e in found]).sum(0)
    worst, tried = None, 0
    for k, (kind, _) in enumerate(KINDS):
        for b in range(len(count)):
            n = 3.0 * float(count[b])
            if float(count[b]) < ENOUGH:
                continue
            tried += 1
            ratio = float(total[k, b] / noise[k, b])
            p, share = float(scipy.stats.chi2.sf(n * ratio, n)), max(0.0, 1.0 - 1.0 / ratio)
            if worst is None or share > worst[1]:
                worst = p, share, kind, b
    if worst is None:
        return Structure(False, float("nan"), float("nan"), "cannot be told: too few seconds on plates")
    p, share, kind, b = min(1.0, worst[0] * tried), *worst[1:]
    significant = p < P_VALUE and share > SHARE
    return Structure(significant, p, share, _described(found, kind, b, share) if significant else "")


def _described(found: Sequence[Energy], kind: str, b: int, share: float) -> str:
    k = [name for name, _ in KINDS].index(kind)
    excess = {e.trial: float(e.left[k, b] / e.noise[k, b]) for e in found if float(e.count[b]) > 0.0}
    trial = max(excess, key=lambda name: excess[name])
    low, high = (0.0, *EDGES)[b], (*EDGES, float("inf"))[b]
    return (
        f"{100.0 * share:.0f} % of the residual {kind} between {low:g} and {high:g} Hz is more than the noise of "
        f"plates and markers; most in {trial}, {excess[trial]:.1f} times what noise makes"
    )


def _energy(watched: Watched, cameras: Cameras, left: Float[Tensor, "frames 6"]) -> Energy:
    draws = [_noise(watched, cameras, draw) for draw in range(DRAWS)]
    own, count = _by_band(watched, left)
    noise = torch.stack([_by_band(watched, draw)[0] for draw in draws]).mean(0)
    return Energy(watched.rows.name, own, noise, count)


def _by_band(watched: Watched, x: Float[Tensor, "frames 6"]) -> tuple[Float[Tensor, "kinds bands"], Tensor]:
    """Energy of the used frames' cosine coefficients, means of blocks left out."""
    rows = watched.rows
    energy, count = x.new_zeros(2, len(EDGES) + 1), x.new_zeros(len(EDGES) + 1)
    for part in rows.blocks():
        frames = part.stop - part.start
        kept = coefficients(rows, frames)
        square = (cosine_matrix(frames, kept).to(x) @ x[part]).square()[1:]
        band = bands(frames, kept, rows.rate)[1:].to(x.device)
        for k, (_, axes) in enumerate(KINDS):
            energy[k].index_add_(0, band, square[:, axes].sum(1))
        count.index_add_(0, band, torch.ones_like(square[:, 0]))
    return energy, count


def _noise(watched: Watched, cameras: Cameras, draw: int) -> Float[Tensor, "frames 6"]:
    """A draw of what plates and markers would leave of a perfect model, about the root's origin."""
    rows, generator = watched.rows, torch.Generator().manual_seed(draw)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(rows.wrench)

    shaken = cameras.scatter.repeat_interleave(3) * normal(len(rows.used), 3 * len(cameras.scatter))
    nine = (cameras.answer @ shaken[:, :, None])[:, :, 0]
    motion = wrench_of(rows.motion.smoother(nine)[:, :, None], rows.rate)[:, :, 0]
    plates = rows.motion.smoother(normal(len(rows.used), 6) * watched.scatter)
    return wrench_about(motion, rows.motion.q[:, :3]) + plates
