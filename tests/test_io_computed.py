"""Tests of torchid.io.computed and labels: what a program computed is told from markers, whatever its name."""

import tracemalloc

import numpy as np
import pytest

from torchid.io.computed import EXACT, computed_points, left_out_as_computed
from torchid.io.labels import select_markers

FRAMES = 120
NOISE = 5e-5
"""A fine camera system's noise [m], twenty times ``EXACT``."""


def turning(frames: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Poses (frames, 3, 3) and places (frames, 3) of a segment that walks 1 m and turns about all axes."""
    time = np.linspace(0.0, 1.0, frames)
    a, b, c = random.uniform(0.2, 0.6, (3, 1)) * np.sin(2 * np.pi * (time + random.uniform(size=(3, 1))))
    zero, one = np.zeros(frames), np.ones(frames)
    turns = [
        [np.cos(a), -np.sin(a), zero, np.sin(a), np.cos(a), zero, zero, zero, one],
        [np.cos(b), zero, np.sin(b), zero, one, zero, -np.sin(b), zero, np.cos(b)],
        [one, zero, zero, zero, np.cos(c), -np.sin(c), zero, np.sin(c), np.cos(c)],
    ]
    x, y, z = (np.stack(turn, axis=1).reshape(frames, 3, 3) for turn in turns)
    return x @ y @ z, np.stack([time, 0.02 * np.sin(9 * time), 1.0 + 0.03 * np.cos(9 * time)], axis=1)


def segments(seed: int, frames: int = FRAMES, noise: float = NOISE) -> np.ndarray:
    """Twelve markers (frames, 12, 3), four on each of three segments, in single precision as C3D stores them."""
    random, parts = np.random.default_rng(seed), []
    for k in range(3):
        pose, place = turning(frames, random)
        points = random.uniform(-0.15, 0.15, (4, 3)) + np.array([0.0, 0.0, 0.4 * k])
        parts.append(np.einsum("tij,pj->tpi", pose, points) + place[:, None])
    markers = np.concatenate(parts, axis=1)
    return stored(markers + noise * random.normal(size=markers.shape))


def stored(position: np.ndarray, step: float = 0.0) -> np.ndarray:
    """As a file keeps it: single precision in mm, or whole steps [m]."""
    return np.round(position / step) * step if step else (position * 1e3).astype(np.float32).astype(float) / 1e3


def axes(markers: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Origin and axis ends (frames, 4, 3) of a frame on the first three markers, its axes ``length`` (frames,) long."""
    x = markers[:, 1] - markers[:, 0]
    z = np.cross(x, markers[:, 2] - markers[:, 0])
    y = np.cross(z, x)
    ends = [markers[:, :3].mean(axis=1)]
    ends += [ends[0] + length[:, None] * v / np.linalg.norm(v, axis=1, keepdims=True) for v in (x, y, z)]
    return np.stack(ends, axis=1)


def told(markers: np.ndarray, others: np.ndarray, *more: np.ndarray) -> set[int]:
    """Columns that are told, markers first, in a file that holds all of these points."""
    position = np.concatenate([markers, others, *more], axis=1)
    return {int(label) for label in computed_points(tuple(map(str, range(position.shape[1]))), position)}


@pytest.mark.parametrize("growing", [0.0, 0.1])
@pytest.mark.parametrize("step", [0.0, 1e-4])
def test_axes_of_a_frame_are_told(seed: int, growing: float, step: float) -> None:
    """Origin and three axes go, also where the axes' length follows the segment's, and where a file keeps 0.1 mm."""
    markers = segments(seed)
    length = 0.1 + growing * np.linspace(0.0, 1.0, FRAMES)
    assert told(stored(markers, step), stored(axes(markers, length), step)) == {12, 13, 14, 15}


def test_a_marker_at_the_origin_of_a_frame_stays(seed: int) -> None:
    """A frame that starts at a marker is left out, its marker is not."""
    markers = segments(seed)
    frame = axes(markers, np.full(FRAMES, 0.05))
    frame += markers[:, :1] - frame[:, :1]
    assert told(markers, stored(frame)) == {12, 13, 14, 15}


def test_a_marker_on_an_axis_stays(seed: int) -> None:
    """A knee's marker at a constant distance along the axis of a computed frame is a marker, as in Plug-in Gait."""
    markers = segments(seed)
    frame = axes(markers[:, 4:8], np.full(FRAMES, 0.3))
    knee = frame[:, :1] + (frame[:, 1:2] - frame[:, :1]) / 6
    assert told(markers, stored(knee), stored(frame)) == {13, 14, 15, 16}


def test_copies_midpoints_and_fixed_points_are_told(seed: int) -> None:
    """A copy with gaps, a point half-way and one at a third go; so do five landmarks that a rigid segment carries."""
    random, markers = np.random.default_rng(seed), segments(seed)
    copy = markers[:, 5:6].copy()
    copy[40:60] = np.nan
    middle = stored(markers[:, :1] + np.array([0.5, 1 / 3])[:, None] * (markers[:, 1:2] - markers[:, :1]))
    pose, place = turning(FRAMES, random)
    carried = stored(np.einsum("tij,pj->tpi", pose, random.uniform(-0.2, 0.2, (5, 3))) + place[:, None])
    assert told(markers, copy, middle, carried) == set(range(12, 20))


def test_values_that_are_no_places_are_told(seed: int) -> None:
    """A power in one coordinate and an angle that lies 20 m away go."""
    markers, time = segments(seed), np.linspace(0.0, 1.0, FRAMES)
    power = np.stack([0 * time, 0 * time, np.sin(9 * time)], axis=1)[:, None]
    angle = np.stack([20 + time, -15 + time, 3 * time], axis=1)[:, None]
    assert told(markers, power, angle) == {12, 13}


@pytest.mark.parametrize("frames", [1, 3, 50, 700])
def test_markers_stay(seed: int, frames: int) -> None:
    """Nothing is told of markers alone, with gaps, in short and long recordings."""
    markers = segments(seed, frames)
    markers[frames // 3 : frames // 2, ::3] = np.nan
    assert not told(markers, markers[:, :0])


def test_markers_of_two_people_apart_stay(seed: int) -> None:
    """As many markers on either side of a hall: each side is a place in the room."""
    first = segments(seed)
    both = np.concatenate([first, first[:, ::-1] + np.array([15.0, 0.0, 0.0])], axis=1)
    assert "no place in a room" not in computed_points(tuple(f"m{k}" for k in range(24)), both).values()


def test_markers_that_a_filter_smoothed_stay(seed: int) -> None:
    """Noise of a rigid plate after a moving average over a quarter of a second is still noise."""
    window = np.ones(25) / 25
    markers = np.apply_along_axis(lambda one: np.convolve(one, window, "valid"), 0, segments(seed, FRAMES + 24))
    assert not told(stored(markers), markers[:, :0])


def test_a_recording_without_noise_keeps_its_markers(seed: int) -> None:
    """In a simulation all markers of a segment are fixed to each other; an averaged standing trial hardly moves."""
    assert not told(segments(seed, noise=0.0), np.zeros((FRAMES, 0, 3)))
    standing = segments(seed, 1, 0.0) + EXACT / 10 * np.random.default_rng(seed).normal(size=(60, 12, 3))
    assert not told(standing, standing[:, :0])


def test_what_the_user_lists_is_a_marker() -> None:
    """A listed label stays whatever its name, its behaviour or the file's lists say; the note names the others."""
    markers = segments(0)
    position = np.concatenate([markers, stored(axes(markers, np.full(FRAMES, 0.1)))], axis=1)
    labels = tuple("ABCDEFGHIJKLMNOP")
    left, notes = left_out_as_computed(labels, position, frozenset(["m"]), "x")
    assert left == ("N", "O", "P") and "N (axis of a frame)" in notes[0].message
    chosen = select_markers(
        ["LASI", "L_HJC", "RKJC", "Hip"], "x", frozenset(["Hip"]), wanted=frozenset(["l hjc", "HIP"])
    )
    assert chosen.labels == ("LASI", "L_HJC", "Hip")


@pytest.mark.parametrize(
    "others",
    [
        ["PELO", "PELA", "PELL", "PELP"],
        ["LFE_MO", "LFE_MA", "LFE_ML", "LFE_MP"],
        ["Pelvis_ORIGIN", "Pelvis_X", "Pelvis_Y", "Pelvis_Z"],
        ["RThigh_O", "RThigh_X", "RThigh_Y", "RThigh_Z"],
        [
            "LHipAngles_M",
            "RKneePower",
            "LGroundReactionForce",
            "RAnkleMoment_M",
            "LNormalisedGRF",
            "LFootProgressAngles",
        ],
        ["LHJC", "RHJC_study", "midASIS", "L_AJC", "MODEL_COM", "worldbody_4X4", "CentreOfMassFloor"],
        ["L_knee_study"],
    ],
)
def test_outputs_are_told_by_their_names(others: list[str]) -> None:
    """Axes, quantities and centres of the programs that laboratories use go by name."""
    markers = ("LASI", "RTHI", "L_knee", "LTIB1", "FORCEPS", "R_Thigh_Proximal", "PX", "X", "Y")
    found = select_markers([*markers, *others], "x")
    assert found.labels == markers
    assert f"{len(others)} by their names" in found.notes[0].message


def test_estimated_markers_stay_where_nothing_else_was_measured() -> None:
    """OpenCap's ``_study`` markers are all that a recording by video has."""
    assert select_markers(["r_knee_study", "r_ankle_study"], "x").labels == ("r_knee_study", "r_ankle_study")


def test_many_points_take_little_room() -> None:
    """Three hundred points, as many as a file of all outputs has, are compared within 80 MB."""
    position = np.random.default_rng(0).normal(size=(400, 300, 3)).cumsum(axis=0)
    tracemalloc.start()
    computed_points(tuple(f"P{k}" for k in range(300)), position)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 80e6
