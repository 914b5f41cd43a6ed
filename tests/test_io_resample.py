"""Tests of torchid.io.resample: forces on the clock of the markers."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from torchid.errors import InputError
from torchid.io.resample import synchronise, to_clock
from torchid.recording import Forces, Markers, Plate, Trial


def sampled(function, rate: float, begin: float = 0.0, end: float = 3.0) -> Forces:
    """One plate whose six components are multiples of a function of time."""
    time = torch.arange(int(round((end - begin) * rate)) + 1, dtype=torch.float64) / rate + begin
    factors = torch.arange(1.0, 7.0, dtype=torch.float64)
    return Forces(time, (function(time)[:, None] * factors)[:, None, :], (Plate("p"),))


def clock(rate: float, begin: float = 0.0, end: float = 3.0) -> torch.Tensor:
    return torch.arange(int(round((end - begin) * rate)) + 1, dtype=torch.float64) / rate + begin


@pytest.mark.parametrize(
    ("own", "new"), [(2000.0, 100.0), (600.0, 60.0), (1000.0, 59.94), (100.0, 100.0), (100.0, 250.0)]
)
def test_constants_and_lines_pass_to_the_ends(own: float, new: float) -> None:
    """A constant and a straight line come through unchanged, first and last sample included."""
    for function in (lambda t: torch.full_like(t, 700.0), lambda t: 100.0 + 50.0 * t):
        forces = to_clock(sampled(function, own), clock(new, 0.0, 2.9))
        assert_allclose(forces.wrench[:, 0, 0], function(forces.time), atol=1e-6)


@pytest.mark.parametrize("own", [1000.0, 2000.0, 600.0])
def test_slow_motion_passes_and_what_the_clock_cannot_carry_does_not(own: float) -> None:
    """At 100 Hz a 5 Hz force keeps 0.1 %, a 130 Hz vibration is stopped instead of appearing as 30 Hz."""
    slow = to_clock(sampled(lambda t: torch.sin(2 * np.pi * 5.0 * t), own), clock(100.0))
    assert_allclose(slow.wrench[:, 0, 0], torch.sin(2 * np.pi * 5.0 * slow.time), atol=2e-3)
    fast = to_clock(sampled(lambda t: torch.sin(2 * np.pi * 130.0 * t), own), clock(100.0))
    assert float(fast.wrench[20:-20, 0, 0].abs().max()) < 1e-3


def test_same_clock_is_untouched() -> None:
    """Forces that are on the clock already stay to rounding."""
    forces = sampled(lambda t: torch.cos(40 * t), 100.0)
    assert_allclose(to_clock(forces, forces.time).wrench, forces.wrench, atol=1e-12)


def test_outside_the_overlap_is_nan_and_gaps_stay_gaps() -> None:
    """Frames without forces are NaN, and so are those beside missing samples; all others are numbers."""
    forces = sampled(torch.ones_like, 1000.0, 0.5, 2.0)
    wrench = forces.wrench.clone()
    wrench[700:720] = torch.nan
    moved = to_clock(Forces(forces.time, wrench, forces.plates), clock(100.0))
    missing = moved.wrench[:, 0, 0].isnan().numpy()
    time = moved.time.numpy()
    assert missing[time < 0.499].all() and missing[time > 2.001].all()
    assert missing[(time > 1.2) & (time < 1.219)].all()
    clear = (time > 0.501) & (time < 1.18) | (time > 1.24) & (time < 1.999)
    assert not missing[clear].any()
    assert_allclose(moved.wrench[torch.from_numpy(clear), 0, 0], 1.0, atol=1e-9)


def test_inputs_are_left_alone() -> None:
    """Resampling does not write into the caller's tensor."""
    forces = sampled(torch.sin, 1000.0)
    before = forces.wrench.clone()
    to_clock(forces, clock(100.0))
    assert_array_equal(forces.wrench, before)


def trial(forces: Forces | None) -> Trial:
    time = clock(100.0)
    return Trial("t", Markers(("A",), time, torch.zeros(len(time), 1, 3, dtype=torch.float64)), forces)


def test_synchronise_says_how_many_frames_have_forces() -> None:
    """A partial overlap is said, a full one is not, a trial without forces passes, none at all is refused."""
    partial = synchronise(trial(sampled(torch.ones_like, 1000.0, 1.0, 2.0)))
    assert partial.forces is not None and len(partial.forces.time) == 301
    (said,) = partial.notes
    assert (said.code, said.message) == ("trial.frames", "101 of 301 frames have forces; only they are used")
    assert synchronise(trial(sampled(torch.ones_like, 1000.0))).notes == ()
    assert synchronise(trial(None)).forces is None
    with pytest.raises(InputError, match=r"trial\.no_overlap"):
        synchronise(trial(sampled(torch.ones_like, 1000.0, 5.0, 6.0)))


def test_what_a_program_wrote_as_zero_stays_known(seed: int) -> None:
    """Whatever is added to the other samples, passes the filter as that much of it as the new clock says was read."""
    rng = torch.Generator().manual_seed(seed)
    given = sampled(lambda t: 300.0 * torch.sin(3.0 * t).clamp_min(0.0), 1000.0)
    off = torch.randn(6, generator=rng, dtype=torch.float64)
    read = (given.wrench != 0.0).any(2, keepdim=True)
    new = clock(100.0)
    right, wrong = (to_clock(one, new) for one in (given, replace(given, wrench=given.wrench + off * read)))
    assert_allclose(wrong.zeroed_share, right.zeroed_share)
    assert_allclose(wrong.wrench - right.wrench, off * (1.0 - right.zeroed_share)[..., None], atol=1e-9)
    assert float(right.zeroed_share.max()) > 0.999 and to_clock(wrong, new).zeroed_share.equal(wrong.zeroed_share)
