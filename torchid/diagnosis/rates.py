"""Rates of change of what plates read, as columns: what is expected of the true rate, given a noisy one."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.regressor.rows import WrenchTrial
from torchid.regressor.whitening import EDGES, bands, coefficients, cosine_matrix


def calibrated(
    rate: Float[Tensor, "6 columns frames"], rows: WrenchTrial, scatter: Float[Tensor, " 6"]
) -> Float[Tensor, "6 columns frames"]:
    """Each band of each channel shrunk by the part of its energy that is not the plates' noise; zero where not used.

    A column with noise of its own finds too little (regression calibration; Carroll et al. 2006, Measurement Error in
    Nonlinear Models, chapter 4): of 12 ms, 10 ms were found. Noise taken off the Gram matrix instead can leave less
    than nothing in a trial that hardly moves.

    Args:
        rate: of the filtered wrench about the root's origin [N/s, N m/s].
        rows: whose blocks and filter they are.
        scatter: of the wrench per frame, before the filter [N, N m].
    """
    parts, found = [], torch.zeros_like(rate)
    energy, noise = rate.new_zeros(len(EDGES) + 1, *rate.shape[:2]), rate.new_zeros(len(EDGES) + 1, 6, 1)
    for part in rows.blocks():
        frames = part.stop - part.start
        kept = coefficients(rows, frames)
        C, band = cosine_matrix(frames, kept).to(rate), bands(frames, kept, rows.rate).to(rate.device)
        own = (rate[:, :, part] @ C.T).permute(2, 0, 1)
        frequency = 0.5 * rows.rate * torch.arange(kept).to(rate) / frames
        passed = 2.0 * math.pi * frequency * rows.motion.smoother.response(frequency)
        energy.index_add_(0, band, own.square())
        noise.index_add_(0, band, (passed[:, None] * scatter).square()[:, :, None])
        parts.append((part, C, band, own))
    true = (1.0 - noise / energy.clamp(min=1e-300)).clamp(min=0.0)
    for part, C, band, own in parts:
        found[:, :, part] = (true[band] * own).permute(1, 2, 0) @ C
    return found
