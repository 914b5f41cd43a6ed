"""The same trial under other draws of the markers' noise, and what that does to columns.

Columns that come from the found motion hold its noise, and so does the residual: theirs agree where no truth does. Each
column's moment gains what the two are expected to share (corrected scores; Carroll et al. 2006, Measurement Error in
Nonlinear Models, chapter 7). Columns that were only shrunk by what is believed of the total left the thorax, whose
markers make most of the noise while legs make most of the motion, to wobble at 1.0 in two sessions of three that hid
nothing.
"""

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.cameras import NEAR_HZ, Cameras
from torchid.diagnosis.expected import Expected
from torchid.dynamics import wrench_about
from torchid.filters import Smoother, differentiate
from torchid.geometry.problem import retract
from torchid.motion import Motion
from torchid.regressor.rows import WrenchTrial
from torchid.regressor.whitening import EDGES, band_of, coefficients, cosine_matrix, frequencies

DRAWS = 8
"""Of the noise of each trial, at least: with four, noise of 4 mm was flesh that lags in one session of four ..."""
LOUD_DRAWS, MOST_DRAWS = 128.0, 64
"""... as many for noise as large as what the true motion needs, and at most. With eight it was so in one of ten: their
scatter was 2.3 nats of evidence, and is 0.5 now."""


def shaken(motion: Motion, cameras: Cameras) -> Iterator[Motion]:
    """A motion as it would have been found under ``MOST_DRAWS`` other draws of the markers' noise."""
    # Each trial its own: the same draws in all of them would err alike, and the mean of trials no less.
    generator = torch.Generator().manual_seed(zlib.crc32(cameras.sight.scene.trial.encode()))
    shape = len(motion.q), 3 * len(cameras.sight.labels), DRAWS
    low, high = cameras.scatter.repeat_interleave(3, 1)[:, :, None]
    for _ in range(MOST_DRAWS // DRAWS):
        white = torch.randn(*shape, generator=generator, dtype=torch.float64).to(motion.q)
        slow = Smoother(NEAR_HZ[1], motion.smoother.rate_hz)(white)
        for step in cameras.followed(low * slow + high * (white - slow)).unbind(2):
            yield _moved(motion, motion.smoother(step))


def _moved(motion: Motion, x: Float[Tensor, "frames dofs"]) -> Motion:
    """By a small displacement, whose columns 3-5 are a rotation of the base in W."""
    v, a = differentiate(x, motion.smoother.rate_hz)
    base = slice(3, 6)
    turned = torch.linalg.cross(x[:, base], motion.v[:, base])
    swung = torch.linalg.cross(v[:, base], motion.v[:, base]) + torch.linalg.cross(x[:, base], motion.a[:, base])
    v[:, base], a[:, base] = v[:, base] + turned, a[:, base] + swung
    return replace(motion, q=retract(motion.q.T, x.T).T, v=motion.v + v, a=motion.a + a)


def regressor(rows: WrenchTrial, motion: Motion) -> Float[Tensor, "6 params frames"]:
    """That of a shaken motion, about the root's origin where it was found."""
    Y, _ = replace(rows, motion=motion).rows(slice(None))
    away = (rows.motion.q[:, :3] - motion.q[:, :3]).expand(Y.shape[1], -1, -1)
    return wrench_about(Y.permute(1, 2, 0), away).permute(2, 0, 1)


def covariation(
    rows: WrenchTrial,
    expected: Expected,
    draws: Iterable[tuple[Float[Tensor, "6 some frames"], Float[Tensor, "6 frames"]]],
) -> Float[Tensor, "bands 6 6 some"]:
    """Products of the noise of each channel of the total with that of each channel of the columns, band by band.

    Args:
        rows: whose blocks they are.
        expected: of the trial: what columns are shrunk to, and how much of the noise is there.
        draws: noise of the columns before that, and of the wrench that the model needs.
    """
    parts = []
    for columns, total in draws:
        found = columns.new_zeros(len(EDGES) + 1, 6, 6, columns.shape[1])
        for part in rows.blocks():
            # What multiplies the columns is transformed back: it has fewer rows than they have coefficients.
            paired = _paired(rows, expected, total[:, part])
            found += torch.einsum("jcf,bijf->bijc", columns[:, :, part], paired)
        parts.append(found)
    return torch.stack(parts).mean(0) * expected.there[:, :, None, None]


def _paired(
    rows: WrenchTrial, expected: Expected, total: Float[Tensor, "6 frames"]
) -> Float[Tensor, "bands 6 6 frames"]:
    """Each channel of a total as each channel of a column believes it, by band."""
    frames = total.shape[1]
    kept = coefficients(rows, frames)
    C, frequency = cosine_matrix(frames, kept).to(total)[1:], frequencies(frames, kept, rows.rate).to(total)
    believed, band = expected.believed(frequency)[1:].T, band_of(frequency[1:])
    other, found = total @ C.T, total.new_zeros(len(EDGES) + 1, 6, 6, frames)
    for b in band.unique().tolist():
        own = band == b
        found[b] = torch.einsum("ik,jk->ijk", other[:, own], believed[:, own]) @ C[own]
    return found
