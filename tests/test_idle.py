"""What a plate reads while it bears nothing, and what only looks like it."""

from dataclasses import replace

import pytest
import torch

from torchid.effects.catalogue import effect
from torchid.effects.place import Place
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


def test_zeros_that_a_program_wrote_state_nothing_and_are_not_moved_by_a_wrong_zero(seed):
    """Where a filter has smeared them, too: a wrong zero is in what a plate read itself."""
    time = torch.arange(1000, dtype=torch.float64) / RATE
    given = read(torch.where((time < 2.0) | (time > 6.0), 400.0, 4.0), seed)
    zeroed = ((time > 2.1) & (time < 5.9)).to(time)[:, None]
    smeared = given.wrench * (1.0 - zeroed[..., None]) + 1e-9
    program = replace(given, wrench=smeared, zeroed=zeroed)
    assert find_unloaded(given, RATE).runs and not find_unloaded(program, RATE).runs
    theta = torch.randn(6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    offset, place = effect("plate_offset"), Place(("plate_1",))
    moved = offset.read(program, place, theta)
    torch.testing.assert_close(moved.wrench - smeared, (theta * (1.0 - zeroed))[:, None])
    torch.testing.assert_close(offset.undone(moved, place, theta).wrench, smeared)
