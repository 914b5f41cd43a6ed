"""What the noise of markers and plates makes of the wrench, band by band, and what is left to believe of a noisy one.

Plates' noise is what their unloaded channels show; markers' noise is what a label does from one frame to the next
beyond what a person can. Draws of both pass the same chain as the recording (postures, filter, inverse dynamics).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.cameras import Cameras
from torchid.dynamics import wrench_about
from torchid.effects.momentum import wrench_of
from torchid.regressor.rows import WrenchTrial
from torchid.regressor.whitening import EDGES, bands, coefficients, cosine_matrix

DRAWS = 4
"""Of the noise of each trial."""


@dataclass(frozen=True)
class Expected:
    """Energy of cosine coefficients in one trial, about the root's origin; means of blocks left out."""

    motion: Float[Tensor, "bands 6"]
    """Of the wrench that the markers' noise seems to need."""
    plates: Float[Tensor, "bands 6"]
    """Of the plates' noise."""
    count: Float[Tensor, " bands"]
    believed: Float[Tensor, "bands 6"]
    """Part of the wrench needed by the found motion that the true motion needs."""


def expected(rows: WrenchTrial, cameras: Cameras, scatter: Float[Tensor, " 6"]) -> Expected:
    """Of one trial that cameras have seen; ``scatter`` is the plates' noise per frame [N, N m]."""
    draws = [_draw(rows, cameras, scatter, k) for k in range(DRAWS)]
    motion, plates = (torch.stack([energy(rows, d[k])[0] for d in draws]).mean(0) for k in (0, 1))
    own, count = energy(rows, wrench_about(cameras.sight.scene.needed().T, rows.motion.q[:, :3]))
    return Expected(motion, plates, count, (1.0 - motion / own.clamp(min=1e-300)).clamp(min=0.0))


def energy(rows: WrenchTrial, x: Float[Tensor, "frames 6"]) -> tuple[Float[Tensor, "bands 6"], Float[Tensor, " bands"]]:
    """Energy of the used frames' cosine coefficients, means of blocks left out, and their number."""
    found, count = x.new_zeros(len(EDGES) + 1, 6), x.new_zeros(len(EDGES) + 1)
    for part in rows.blocks():
        frames = part.stop - part.start
        kept = coefficients(rows, frames)
        square = (cosine_matrix(frames, kept).to(x) @ x[part]).square()[1:]
        band = bands(frames, kept, rows.rate)[1:].to(x.device)
        found.index_add_(0, band, square)
        count.index_add_(0, band, torch.ones_like(square[:, 0]))
    return found, count


def _draw(
    rows: WrenchTrial, cameras: Cameras, scatter: Float[Tensor, " 6"], draw: int
) -> tuple[Float[Tensor, "frames 6"], Float[Tensor, "frames 6"]]:
    """What markers' noise, and plates' noise, would leave of a perfect model, about the root's origin."""
    generator = torch.Generator().manual_seed(draw)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(rows.wrench)

    shaken = cameras.scatter.repeat_interleave(3) * normal(len(rows.used), 3 * len(cameras.scatter))
    nine = (cameras.answer @ shaken[:, :, None])[:, :, 0]
    motion = wrench_of(rows.motion.smoother(nine)[:, :, None], rows.rate)[:, :, 0]
    return wrench_about(motion, rows.motion.q[:, :3]), rows.motion.smoother(normal(len(rows.used), 6) * scatter)
