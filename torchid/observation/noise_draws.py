"""The same motion under other draws of the markers' noise."""

import zlib
from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.filters import Smoother, differentiate
from torchid.geometry.problem import retract
from torchid.motion import Motion
from torchid.observation.marker_response import NEAR_HZ, MarkerResponse

DRAWS = 8
"""Of the noise of each trial, at least: with four, noise of 4 mm was flesh that lags in one session of four ..."""
LOUD_DRAWS, MOST_DRAWS = 64.0, 32
"""... as many for noise as large as what the true motion needs, and at most. With eight it was so in one of ten: their
scatter was 2.3 nats of evidence. Of five trials of 25 s it is 0.3 of the 10 to 200 that springs and skin have, and 0.3
with twice as many."""


def draw_noise(motion: Motion, response: MarkerResponse) -> Iterator[Motion]:
    """A motion as it would have been found under ``MOST_DRAWS`` other draws of the markers' noise."""
    # Each trial its own: the same draws in all of them would err alike, and the mean of trials no less.
    generator = torch.Generator().manual_seed(zlib.crc32(response.sight.scene.trial.encode()))
    shape = len(motion.q), 3 * len(response.sight.labels), DRAWS
    low, high = response.scatter.repeat_interleave(3, 1)[:, :, None]
    uneven = (low != high)[:, 0]
    for _ in range(MOST_DRAWS // DRAWS):
        # Made in single precision: noise has no eighth digit, and the same in double took three times as long.
        white = torch.randn(*shape, generator=generator, dtype=torch.float32).to(motion.q)
        slow = Smoother(NEAR_HZ[1], motion.smoother.rate_hz)(white[:, uneven])
        white.mul_(high)[:, uneven] += slow.mul_((low - high)[uneven])
        for step in response.followed(white).unbind(2):
            yield _moved(motion, motion.smoother(step))


def _moved(motion: Motion, x: Float[Tensor, "frames dofs"]) -> Motion:
    """By a small displacement, whose columns 3-5 are a rotation of the base in W."""
    v, a = differentiate(x, motion.smoother.rate_hz)
    base = slice(3, 6)
    turned = torch.linalg.cross(x[:, base], motion.v[:, base])
    swung = torch.linalg.cross(v[:, base], motion.v[:, base]) + torch.linalg.cross(x[:, base], motion.a[:, base])
    v[:, base], a[:, base] = v[:, base] + turned, a[:, base] + swung
    return replace(motion, q=retract(motion.q.T, x.T).T, v=motion.v + v, a=motion.a + a)
