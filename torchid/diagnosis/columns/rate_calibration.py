"""Rates of change of what plates read, as columns: the expectation of the true rate, given a noisy one."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import coefficients, cosine_matrix, frequencies
from torchid.observation.reliability import estimate_reliability


def calibrated(
    rate: Float[Tensor, "6 columns frames"], rows: WrenchTrial, scatter: Float[Tensor, " 6"]
) -> Float[Tensor, "6 columns frames"]:
    """Return rates with each channel shrunk to the part of its energy that is not the plates' noise; zero where not
    used.

    A lag whose columns are not shrunk comes out too small. Noise taken off the Gram matrix instead can leave less than
    nothing in a trial that hardly moves. See ``observation.reliability``.

    Args:
        rate: rate of the filtered wrench about the root's origin [N/s, N m/s].
        rows: trial whose blocks and filter are meant.
        scatter: standard deviation of the wrench per frame, before the filter [N, N m].
    """
    parts, found = [], torch.zeros_like(rate)
    for part in rows.blocks():
        frames = part.stop - part.start
        kept = coefficients(rows, frames)
        C, frequency = cosine_matrix(frames, kept).to(rate), frequencies(frames, kept, rows.rate).to(rate)
        parts.append((part, C, frequency, (rate[:, :, part] @ C.T).permute(2, 0, 1)))
    every, own = torch.cat([p[2] for p in parts]), torch.cat([p[3] for p in parts])
    passed = 2.0 * math.pi * every * rows.motion.smoother.response(every)
    noise = (passed[:, None] * scatter).square()[:, :, None].expand(own.shape)
    true = estimate_reliability(every, own.square(), noise)
    for part, C, frequency, own in parts:
        found[:, :, part] = (true(frequency) * own).permute(1, 2, 0) @ C
    return found
