"""A stream whose times are wrong is told so, and one whose network drops, doubles and delays some frames is not."""

import pytest
import torch

from torchid.live.sources.intake import Intake, Stamps
from torchid.live.sources.stream import Packet
from torchid.recording import Forces, Markers, Plate

RATE, FORCE_RATE, SECONDS = 100.0, 1000.0, 8.0
PLATE = Plate("plate 1", torch.tensor([[0.6, 0.0, 0], [0.0, 0.0, 0], [0.0, 0.4, 0], [0.6, 0.4, 0]]).double())


def told(stamps: torch.Tensor, plates_s: float = 0.0) -> tuple[set[str], dict]:
    """What is said of frames that come one by one with these times, plates apart from them by some time [s]."""
    intake, watch, found = Intake(RATE, FORCE_RATE, 0.5), Stamps(RATE, FORCE_RATE), set()
    for k, t in enumerate(stamps.tolist()):
        markers = Markers(("A",), torch.tensor([t], dtype=torch.float64), torch.zeros(1, 1, 3).double())
        time = plates_s + t + torch.arange(10).double() / FORCE_RATE
        forces = Forces(time, torch.zeros(10, 1, 6).double(), (PLATE,))
        intake.place(Packet(markers, forces, 0.0))
        found |= {one.where for one in watch.after(intake.counts, k / RATE)}
    return found, watch.noted


def even(begin_s: float = 5.0) -> torch.Tensor:
    return begin_s + torch.arange(round(SECONDS * RATE)).double() / RATE


@pytest.mark.parametrize("begin_s", [0.0, 5.0, 1.7e9])
def test_even_times_are_left_alone(begin_s):
    """Whatever their epoch."""
    assert told(even(begin_s)) == (set(), {})


def test_a_network_that_doubles_and_delays_some_frames_is_left_alone(seed):
    rng = torch.Generator().manual_seed(seed)
    stamps = even()
    twice = torch.rand(len(stamps), generator=rng) < 0.03
    lost = torch.rand(len(stamps), generator=rng) < 0.05
    assert told(stamps[~lost].repeat_interleave(1 + twice[~lost].long()))[0] == set()


@pytest.mark.parametrize("back_s", [0.5, 1.0, 1.9])
def test_times_that_jump_back_are_said(back_s, caplog):
    """While frames are dropped, and at the end, from when to when; once in the log."""
    stamps = even()
    stamps[len(stamps) // 2 :] -= back_s
    found, noted = told(stamps)
    assert found == {"frames"} and len(caplog.records) == 1
    (since, until), middle = noted["stamps", "frames"], SECONDS / 2
    assert middle < since < middle + 1.0 and since < until < SECONDS


def test_frames_in_pairs_are_said():
    """Two frames with one time, as a sender stamps that wakes up every other frame."""
    stamps = even()
    stamps[1::2] = stamps[::2]
    assert told(stamps)[0] == {"frames"}


def test_a_clock_that_was_not_set_at_first_is_said():
    """A second from 1970, then today."""
    stamps = torch.cat([even(0.0)[:100], even(1.7e9)])
    assert told(stamps)[0] == {"clock"}


@pytest.mark.parametrize("away_s", [-1.7e9, 3.0])
def test_plates_of_another_clock_are_said(away_s):
    assert told(even(1.7e9), away_s)[0] == {"plates"}
