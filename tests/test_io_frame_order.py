"""Tests of torchid.io.frame_order: pairs of frames in each other's place are said, and nothing else is."""

import numpy as np
import pytest

from torchid.io import frame_order, read_trial
from torchid.io.frame_order import frames_out_of_order

FRAMES, MARKERS = 300, 9


def walking(random: np.random.Generator) -> np.ndarray:
    """Markers (frames, markers, 3) [m] that go at 1 m/s and swing, at 100 Hz, with the noise of cameras and gaps."""
    time = np.arange(FRAMES)[:, None, None] / 100.0
    swing = 0.2 * np.sin(5.0 * time + random.uniform(0.0, 6.0, (1, MARKERS, 3)))
    position = swing + time * [1.0, 0.0, 0.0] + 2e-4 * random.normal(size=(FRAMES, MARKERS, 3))
    position[4:-4][random.random((FRAMES - 8, MARKERS)) < 0.02] = np.nan
    return position


@pytest.mark.parametrize("where", ["first", "middle", "last"])
def test_exchanged_frames_are_said(seed: int, where: str) -> None:
    """Two neighbouring frames that are exchanged, at the ends too, are named; the recording as it was is not."""
    random = np.random.default_rng(seed)
    position = walking(random)
    assert frames_out_of_order(position, "x") == []
    frame = {"first": 0, "middle": int(random.integers(1, FRAMES - 2)), "last": FRAMES - 2}[where]
    position[[frame, frame + 1]] = position[[frame + 1, frame]]
    (note,) = frames_out_of_order(position, "x")
    assert note.code == "markers.order" and f"({frame + 1} and {frame + 2})" in note.message


@pytest.mark.parametrize("kind", ["lost", "elsewhere"])
def test_missing_and_moved_frames_are_said(seed: int, kind: str) -> None:
    """Four to six frames taken out, or a block of two to five that changes place with the next, show in all markers.

    Of losses of two frames at 100 Hz one in ten does not show, of blocks of six neither.
    """
    random = np.random.default_rng(seed)
    position, least = walking(random), 4 if kind == "lost" else 2
    size, frame = (
        int(random.integers(least, least + (3 if kind == "lost" else 4))),
        int(random.integers(20, FRAMES - 30)),
    )
    if kind == "lost":
        position = np.delete(position, slice(frame, frame + size), axis=0)
    else:
        block, after = position[frame : frame + size].copy(), position[frame + size : frame + 2 * size].copy()
        position[frame : frame + 2 * size] = np.concatenate([after, block])
    (note,) = frames_out_of_order(position, "x")
    assert note.code == "markers.order" and "leap on together" in note.message
    assert f"{frame if kind == 'lost' else frame + size} and" in note.message


def test_noise_and_few_markers_say_nothing(seed: int) -> None:
    """Standing still, where nothing but noise moves, and four markers."""
    random = np.random.default_rng(seed)
    still = random.uniform(-1.0, 1.0, (1, MARKERS, 3)) + 1e-3 * random.normal(size=(2000, MARKERS, 3))
    assert frames_out_of_order(still, "x") == []
    together = still[:1] + 4e-5 * random.normal(size=(400, 1, 3))  # a quiet body that trembles as one
    assert frames_out_of_order(together, "x") == []
    position = walking(random)[:, :4]
    position[[50, 51]] = position[[51, 50]]
    assert frames_out_of_order(position, "x") == []


def test_no_public_recording_is_accused(data_dir) -> None:
    """Walks, runs, jumps and squats at 50 to 200 Hz are in order, none steps, none repeats a frame."""
    paths = [*data_dir.rglob("*.trc"), *(path for path in data_dir.rglob("*.c3d") if path.stat().st_size < 2e6)]
    for path in paths:
        codes = {note.code for note in read_trial("a", path).notes}
        assert not codes & {"markers.order", "markers.steps", "markers.repeated", "plates.load", "plates.force"}, path


def test_what_most_exceed_is_a_quantile(seed: int) -> None:
    """NumPy's, which goes row by row: with markers that are not seen, and steps beside which nothing moves."""
    random = np.random.default_rng(seed)
    leaps = random.exponential(size=(200, 8))
    leaps[random.random(leaps.shape) < 0.2] = np.nan
    leaps[random.random(leaps.shape) < 0.1] = np.inf
    enough = np.isfinite(leaps).sum(axis=1) >= frame_order.MARKERS[0]
    found, quantile = frame_order.of_most(leaps), np.nanquantile(leaps[enough], frame_order.MOST, axis=1)
    np.testing.assert_allclose(found[enough].clip(max=1e6), quantile.clip(max=1e6), rtol=1e-12)
    assert not found[~enough].any()
