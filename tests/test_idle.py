"""What a plate reads while it bears nothing, and what only looks like it."""

from dataclasses import replace

import pytest
import torch

from torchid.effects.catalogue import effect
from torchid.effects.place import Place
from torchid.effects.scene import PlateFrame, Reading, reading
from torchid.observation.unloaded_plates import find_unloaded
from torchid.recording import Forces, Plate

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


def test_missing_forces_state_no_zero(seed):
    """A gap that is longer than the time in which the plate was read without load is none of it."""
    time = torch.arange(1000, dtype=torch.float64) / RATE
    given = read(torch.where(time < 6.0, 400.0, 6.0), seed)
    wrench = given.wrench.clone()
    wrench[100:500] = torch.nan
    raw = reading("one", Forces(time, wrench, (Plate("plate_1"),)), (FRAME,))
    found = find_unloaded(raw, RATE).runs
    assert [part.start >= 600 for _, part, *_ in found] == [True, True]
    assert all(abs(float(mean[2]) - 6.0) < 4.0 * float(error[2]) for *_, mean, error in found)


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_what_was_written_goes_with_the_cables_and_the_clock(seed, lag_s):
    """Exchanged or late, an offset is still in what plates read and in nothing else."""
    time = torch.arange(600, dtype=torch.float64) / RATE
    other = replace(FRAME, name="plate_2", p_WF=FRAME.p_WF + 0.5)
    load = torch.stack([torch.where(time < 3.0, 500.0, 0.0), torch.where(time < 3.0, 0.0, 500.0)], 1)
    wrench = torch.zeros(600, 2, 6, dtype=torch.float64)
    wrench[..., 2] = load
    given = reading("one", Forces(time, wrench, (Plate("plate_1"), Plate("plate_2"))), (FRAME, other))
    swapped = effect("plate_assignment").read(given, Place(("plate_1", "plate_2")), torch.ones(1).double())
    assert given.zeroed is not None and swapped.zeroed is not None
    torch.testing.assert_close(swapped.zeroed, given.zeroed.flip(1))
    assert bool(((swapped.wrench[..., 2] > 0.0) == (swapped.zeroed == 0.0)).all())
    late = effect("time_offset").read(given, Place(("session",)), torch.tensor([lag_s]).double())
    assert late.zeroed is not None
    inner = slice(50, -50)
    torch.testing.assert_close(late.wrench[inner, :, 2], 500.0 * (1.0 - late.zeroed[inner]), atol=1e-6, rtol=0.0)
