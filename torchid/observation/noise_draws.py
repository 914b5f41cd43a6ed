"""Motions that would have been found under other draws of the markers' noise."""

import zlib
from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.filters import Smoother, differentiate
from torchid.geometry.problem import retract
from torchid.motion import Motion
from torchid.observation.marker_noise import NEAR_HZ
from torchid.observation.marker_response import MarkerResponse

DRAWS = 8
"""Resolution. Number of draws of the noise of each trial at least, and of those that are made at once."""
LOUD_DRAWS, MOST_DRAWS = 64.0, 32
"""Resolution. Number of draws for noise as large as what the true motion needs, and number at most: the scatter of
their mean then moves no evidence by more than 0.3 nats."""


def draw_noise(motion: Motion, response: MarkerResponse) -> Iterator[Motion]:
    """Yield a motion as it would have been found under ``MOST_DRAWS`` other draws of the markers' noise.

    Noise is white up to the scatter that differs below and above ``NEAR_HZ``; postures follow it (``MarkerResponse``),
    and the result passes the motion's filter. The seed is the trial's name.
    """
    # Each trial has draws of its own: the same ones in all trials would err alike, and their mean no less.
    generator = torch.Generator().manual_seed(zlib.crc32(response.sight.scene.trial.encode()))
    shape = len(motion.q), 3 * len(response.sight.labels), DRAWS
    low, high = response.scatter.repeat_interleave(3, 1)[:, :, None]
    uneven = (low != high)[:, 0]
    for _ in range(MOST_DRAWS // DRAWS):
        # Single precision will do: noise has no eighth digit, and double takes three times as long.
        white = torch.randn(*shape, generator=generator, dtype=torch.float32).to(motion.q)
        slow = Smoother(NEAR_HZ[1], motion.smoother.rate_hz)(white[:, uneven])
        white.mul_(high)[:, uneven] += slow.mul_((low - high)[uneven])
        for step in response.followed(white).unbind(2):
            yield displaced(motion, motion.smoother(step))


def displaced(motion: Motion, x: Float[Tensor, "frames dofs"]) -> Motion:
    """Return the motion after a small displacement of its coordinates.

    Args:
        motion: motion before.
        x: displacement [m, rad], whose columns 3 to 5 are a rotation of the base in W.
    """
    v, a = differentiate(x, motion.smoother.rate_hz)
    base = slice(3, 6)
    turned = torch.linalg.cross(x[:, base], motion.v[:, base])
    swung = torch.linalg.cross(v[:, base], motion.v[:, base]) + torch.linalg.cross(x[:, base], motion.a[:, base])
    v[:, base], a[:, base] = v[:, base] + turned, a[:, base] + swung
    return replace(motion, q=retract(motion.q.T, x.T).T, v=motion.v + v, a=motion.a + a)
