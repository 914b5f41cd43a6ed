"""Tests of torchid.io.spikes: single samples that leap away, and motion that only looks so."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal

from torchid.io.spikes import ACCELERATION, FLICKER, marker_spikes, plate_spikes, spikes
from torchid.recording import Forces, Plate

FRAMES, RATE = 200, 100.0


def swinging(seed: int, markers: int = 4) -> np.ndarray:
    """Markers (frames, markers, 3) [m] that swing by half a metre once a second, with a millimetre of noise."""
    random = np.random.default_rng(seed)
    phase = 2 * np.pi * (np.arange(FRAMES)[:, None, None] / RATE + random.random((1, markers, 3)))
    return 0.5 * np.sin(phase) + 1e-3 * random.normal(size=(FRAMES, markers, 3))


@pytest.mark.parametrize("size", [3.0, 0.12])
@pytest.mark.parametrize("frame", [0, 1, 77, FRAMES - 2, FRAMES - 1])
def test_a_single_leap_is_found_where_it_is(seed: int, frame: int, size: float) -> None:
    """A sample metres or a decimetre off, inside or at the ends, is found alone, and named with marker and line."""
    position = swinging(seed)
    position[frame, 2, 1] += size
    found, notes = marker_spikes(position, RATE, tuple("ABCD"), "x", np.arange(FRAMES) + 7)
    assert_array_equal(np.argwhere(found), [[frame, 2]])
    assert f"C (frame {frame + 1}, line {frame + 7})" in notes[0].message


def test_leaps_beside_gaps_are_found(seed: int) -> None:
    """The last sample before a gap and the first after it are judged by the two beyond."""
    position = swinging(seed)
    position[90:95, 0] = np.nan
    position[89, 0, 0] += 0.5
    position[95, 0, 2] -= 0.5
    found, _ = marker_spikes(position, RATE, tuple("ABCD"), "x")
    assert_array_equal(np.argwhere(found), [[89, 0], [95, 0]])


def test_what_bodies_do_is_left_alone(seed: int) -> None:
    """Motion, flicker below the floor, a swap of labels that lasts, and gaps are no spikes."""
    position = swinging(seed)
    position[50, 0, 0] += 0.8 * FLICKER
    position[120:, [1, 2]] = position[120:, [2, 1]]
    position[30:40, 3] = np.nan
    found, notes = marker_spikes(position, RATE, tuple("ABCD"), "x")
    assert not found.any() and {note.code for note in notes} <= {"markers.steps"}


def test_labels_that_are_exchanged_for_good_are_said(seed: int) -> None:
    """Two markers at least half a metre apart that swap from a frame on are named with it, and left."""
    random = np.random.default_rng(seed)
    position = swinging(seed) + 2.0 * np.arange(4)[:, None]
    frame, one, two = int(random.integers(4, FRAMES - 4)), *random.choice(4, 2, replace=False)
    position[frame:, [one, two]] = position[frame:, [two, one]]
    found, notes = marker_spikes(position, RATE, tuple("ABCD"), "x")
    named = ", ".join("ABCD"[k] for k in sorted((one, two)))
    assert not found.any() and [note.code for note in notes] == ["markers.steps"]
    assert f"{named} (frame {frame + 1})" in notes[0].message


def test_hard_landings_are_no_steps(seed: int) -> None:
    """A marker that stops from 15 m/s within a frame is not said to step."""
    position = swinging(seed)
    position[:100, 1, 2] += 0.15 * np.arange(100, 0, -1)
    assert marker_spikes(position, RATE, tuple("ABCD"), "x")[1] == []


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0, 1000.0])
def test_the_bound_is_an_acceleration(rate: float) -> None:
    """A point thrown up and caught at less than the bound's acceleration is no spike at any rate."""
    time = np.arange(9) / rate - 4 / rate
    position = np.zeros((9, 1, 3))
    position[:, 0, 2] = -0.49 * ACCELERATION * time**2
    assert not spikes(position, max(FLICKER, ACCELERATION / (2 * rate**2)))[0].any()


def test_leaps_throughout_are_left_and_said(seed: int) -> None:
    """Random places are no motion with spikes: nothing is taken out, and the markers are named."""
    position = swinging(seed)
    position[:, 1] = np.random.default_rng(seed).uniform(-1, 1, (FRAMES, 3))
    found, notes = marker_spikes(position, RATE, tuple("ABCD"), "x")
    assert not found.any()
    assert [note.code for note in notes] == ["markers.leaping"] and notes[0].message.startswith("1 markers")


def test_plate_samples_that_leap_are_found(seed: int) -> None:
    """A kilonewton, or a moment beyond any lever, in one sample at 1 kHz is marked; an impact of 100 kN/s is not."""
    random = np.random.default_rng(seed)
    time = np.arange(1000) / 1000.0
    vertical = np.interp(time, [0, 0.3, 0.32, 0.5, 0.9, 1.0], [0, 0, 2000, 700, 700, 0])
    wrench = np.zeros((1000, 2, 6))
    wrench[:, :, 2] = vertical[:, None]
    wrench[:, :, 3], wrench[:, :, 4] = 5.0 * wrench[:, :, 2], -7.0 * wrench[:, :, 2]
    wrench += random.normal(size=wrench.shape)
    wrench[600, 0, 2] += 1500.0
    wrench[700, 1, 4] += 1500.0
    corners = torch.tensor([[7.3, 5.2, 0], [6.7, 5.2, 0], [6.7, 4.8, 0], [7.3, 4.8, 0]], dtype=torch.float64)
    forces = Forces(torch.from_numpy(time), torch.from_numpy(wrench), (Plate("one", corners), Plate("two", corners)))
    found, notes = plate_spikes(forces, "x")
    assert_array_equal(np.argwhere(found), [[600, 0], [700, 1]])
    assert [note.code for note in notes] == ["plates.spikes"] * 2 and "at 0.6 s" in notes[0].message
