"""What a plate reads while it bears nothing, and what only looks like it."""

import pytest
import torch

from torchid.effects.scene import PlateFrame, Reading
from torchid.observation.unloaded_plates import find_unloaded

RATE = 100.0
FRAME = PlateFrame("plate_1", torch.zeros(3, dtype=torch.float64), torch.eye(3, dtype=torch.float64))


def read(load: torch.Tensor, seed: int) -> Reading:
    """Of one plate that bears this, with noise of 2 N."""
    rng = torch.Generator().manual_seed(seed)
    wrench = 2.0 * torch.randn(len(load), 1, 6, generator=rng, dtype=torch.float64)
    wrench[:, 0, 2] += load
    return Reading("one", torch.arange(len(load), dtype=torch.float64) / RATE, wrench, (FRAME,))


@pytest.mark.parametrize(("least", "hz"), [(40.0, 1.1), (60.0, 0.5), (5.0, 0.3)])
def test_a_foot_that_bears_least_is_no_zero_error(seed, least, hz):
    """While the weight is on the other leg, a plate reads little, and not long the same."""
    time = torch.arange(1000, dtype=torch.float64) / RATE
    load = least + 300.0 * (1.0 - torch.cos(2.0 * torch.pi * hz * time))
    assert not find_unloaded(read(load, seed), RATE).runs


@pytest.mark.parametrize("drift", [0.0, 1.0, -1.0])
def test_an_unloaded_plate_tells_its_zero(seed, drift):
    """Between two stances, also where it drifts: both halves of the time tell how fast."""
    time = torch.arange(1000, dtype=torch.float64) / RATE
    load = 4.0 + drift * time + torch.where((time < 2.0) | (time > 6.0), 400.0, 0.0)
    found = find_unloaded(read(load, seed), RATE).runs
    assert [plate for plate, *_ in found] == [0, 0]
    (_, first, *_), (_, last, *_) = found
    assert abs(first.start - 204) < 4 and first.stop == last.start and abs(last.stop - 597) < 4
    for _, part, mean, error in found:
        assert abs(float(mean[2]) - 4.0 - drift * float(time[part].mean())) < 4.0 * float(error[2])


def test_a_short_time_without_load_is_told_as_one(seed):
    """Its halves would tell no drift."""
    time = torch.arange(400, dtype=torch.float64) / RATE
    load = torch.where((time < 1.5) | (time > 2.3), 400.0, 4.0)
    assert len(find_unloaded(read(load, seed), RATE).runs) == 1
