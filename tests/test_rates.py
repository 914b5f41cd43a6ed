"""Noisy rates of change as columns: noise alone leaves hardly anything, a clear signal stays what it is."""

import small_session as small
import torch

from torchid.diagnosis.columns.rate_calibration import calibrated
from torchid.filters import differentiate


def test_noise_is_taken_for_noise_and_signal_for_signal():
    """White readings shrink to nothing; the same with a far larger signal lose next to none of it."""
    (rows,) = list(small.true_rows("heldout", 6.0))
    generator = torch.Generator().manual_seed(small.SEED)
    scatter = torch.tensor([2.0, 2.0, 2.0, 0.5, 0.5, 0.5]).double()
    white = scatter * torch.randn(len(rows.used), 6, generator=generator, dtype=torch.float64)
    noise = differentiate(rows.motion.smoother(white), rows.rate)[0].T[:, None]
    swing = torch.sin(2.0 * torch.pi * 1.0 * rows.motion.time)[None, None] * (1e4 * scatter)[:, None, None]
    left = calibrated(noise, rows, scatter)
    assert float(left.square().sum()) < 0.25 * float(noise.square().sum())
    kept = calibrated(noise + swing, rows, scatter)
    used = rows.used
    assert float((kept - swing)[:, :, used].norm()) < 0.05 * float(swing[:, :, used].norm())
