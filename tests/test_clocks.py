"""How late forces come is said by one rule, and forces are read late by one function."""

import math

import pytest
import torch
from torch.testing import assert_close

from torchid.checks.clocks import BY_BODY, BY_FEET, Lateness
from torchid.effects.timing import delayed


@pytest.mark.parametrize(
    ("late", "right", "wrong"),
    [
        (Lateness(0.030, 0.002), BY_BODY, True),
        (Lateness(-0.030, 0.002), BY_BODY, True),
        (Lateness(0.024, 0.002), BY_BODY, False),  # within three standard deviations of what bodies do
        (Lateness(0.100, 0.009), BY_BODY, False),  # known to 27 ms: less than what clocks may be off
        (Lateness(0.100, math.inf), BY_BODY, False),
        (Lateness(0.046, 0.020), BY_FEET, True),
        (Lateness(0.044, 0.020), BY_FEET, False),
        (Lateness(-0.031, 0.020), BY_FEET, True),
    ],
)
def test_a_clock_is_wrong_beyond_what_right_ones_look_like(late: Lateness, right, wrong: bool):
    """By three standard deviations where a body tells it, and only where these are small themselves."""
    assert late.wrong(right) == wrong


def test_what_is_delayed_is_what_was_there(seed: int):
    """To a part in a thousand of what a filter lets through, between samples too; beyond an end its last sample."""
    gen = torch.Generator().manual_seed(seed)
    time = torch.arange(200, dtype=torch.float64) / 100.0
    phase, hertz = (torch.rand(2, 3, generator=gen, dtype=torch.float64) * torch.tensor([[6.0], [5.0]])).unbind()
    signal = lambda t: torch.sin(2.0 * math.pi * hertz * t[:, None] + phase)  # noqa: E731
    lags = (torch.rand(4, generator=gen, dtype=torch.float64) * 0.2 - 0.1).tolist()
    for lag_s, late in zip(lags, delayed(time, signal(time), lags), strict=True):
        assert_close(late[20:-20], signal(time - lag_s)[20:-20], rtol=0.0, atol=1e-3)
        end = -1 if lag_s < 0.0 else 0
        assert_close(late[end], signal(time)[end])
