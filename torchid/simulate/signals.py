"""Smooth signals: random ones inside bounds, and passages between key values."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def smooth_step(x: Tensor) -> Tensor:
    """From 0 at x <= 0 to 1 at x >= 1 with three continuous derivatives (polynomial of degree seven)."""
    x = x.clamp(0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


def passages(time: Float[Tensor, " frames"], keys: Sequence[tuple[float, float]]) -> Float[Tensor, " frames"]:
    """Through (time, value) keys, at rest at each of them; constant before the first and behind the last."""
    out = torch.full_like(time, keys[0][1])
    for (t0, y0), (t1, y1) in zip(keys, keys[1:], strict=False):
        if y1 != y0:
            out = out + (y1 - y0) * smooth_step((time - t0) / max(t1 - t0, 1e-9))
    return out


def wander(
    rng: np.random.Generator,
    time: Float[Tensor, " frames"],
    low: float,
    high: float,
    band: tuple[float, float] = (0.15, 0.9),
) -> Float[Tensor, " frames"]:
    """Random sum of four sines between ``low`` and ``high`` with frequencies in ``band`` [Hz]; slow ones are larger."""
    frequency = np.exp(rng.uniform(np.log(band[0]), np.log(band[1]), 4))
    weight = rng.uniform(0.3, 1.0, 4) / frequency**0.5
    phase = rng.uniform(0.0, 2.0 * np.pi, 4)
    angle = 2.0 * torch.pi * time[:, None] * time.new_tensor(frequency) + time.new_tensor(phase)
    unit = (torch.sin(angle) * time.new_tensor(weight / weight.sum())).sum(1)
    return 0.5 * (low + high) + 0.5 * (high - low) * unit
