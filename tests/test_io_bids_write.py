"""Tests of torchid.io.bids_write: what is written as Motion-BIDS is what its reader reads."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from torchid.io import read_trial
from torchid.io.bids_write import BidsChannel, entity_labels, motion_files, write_bids_motion
from torchid.io.files import is_derivative
from torchid.io.pairing import find_recordings

STEM = "sub-1/motion/sub-1_task-walk_tracksys-omc"
LABELS = ("C7", 'L"knee', "Fußspitze r", " heel\tl")
"""As people and programs write them: quotes, letters beyond ASCII, a tab."""


def save(root: Path, pieces: list[np.ndarray], rate: float = 100.0, axes: str = "FLU") -> Path:
    """A recording of four points with a latency behind them and a moment."""
    channels = [
        BidsChannel(f"{label} {axis}", axis, "POS", label, "m", "n/a", "W") for label in LABELS for axis in "xyz"
    ]
    channels += [BidsChannel("t", "n/a", "LATENCY", "n/a", "s"), BidsChannel("knee", "n/a", "MISC", "shank", "N*m")]

    def place(name: str) -> Path:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        return root / name

    frames = {"W": {"SpatialAxes": axes}}
    write_bids_motion(STEM, channels, iter(pieces), {"SamplingFrequency": rate}, frames, place)
    assert sorted(str(path.relative_to(root)) for path in root.rglob("*.*")) == sorted(motion_files(STEM))
    return root / motion_files(STEM)[0]


def values(seed: int, frames: int, rate: float, start: float = 0.0) -> np.ndarray:
    """Of these channels, one point hidden for a while and a moment that is not known."""
    place, size, phase = np.random.default_rng(seed).uniform(0.01, 1.0, (3, 14))
    time = np.arange(frames) / rate
    found = place + 0.1 * size * np.sin(time[:, None] + 6.0 * phase)
    found[3:5, 3:6], found[1, 13], found[:, 12] = np.nan, np.nan, start + time
    return found


@pytest.mark.parametrize(("rate", "start"), [(100.0, 0.0), (120.0, 7.5), (1000.0, 3600.0), (59.94, -0.25)])
def test_what_is_written_is_read(tmp_path: Path, seed: int, rate: float, start: float) -> None:
    """Positions to seven digits, gaps, labels, clock and axes, without a word of repair; in pieces, too."""
    wanted = values(seed, 40, rate, start)
    trial = read_trial("walk", save(tmp_path, [wanted[:7], wanted[7:8], wanted[8:]], rate))
    assert trial.markers.labels == tuple(label.strip().replace("\t", "\N{REPLACEMENT CHARACTER}") for label in LABELS)
    position = wanted[:, :12].reshape(40, 4, 3)
    assert_allclose(trial.markers.position, position, rtol=5e-7, atol=1e-12, equal_nan=True)
    assert_allclose(trial.markers.time, wanted[:, 12], atol=2e-6)
    assert trial.markers.rate == pytest.approx(rate, rel=1e-6)
    assert {"subject": "sub-1", "units": "m", "up": "z"}.items() <= trial.parameters.items()
    assert {note.code for note in trial.notes} == {"axes.up"}


@pytest.mark.parametrize(("axes", "up"), [("FLU", "z"), ("ALS", "z"), ("FUR", "y"), ("RSA", "y")])
def test_both_spellings_of_the_axes_tell_the_vertical(tmp_path: Path, seed: int, axes: str, up: str) -> None:
    """Superior and up are one; the specification's text has the one and its example the other."""
    trial = read_trial("walk", save(tmp_path, [values(seed, 40, 100.0)], axes=axes))
    assert trial.parameters["up"] == up and "axes.up" in {note.code for note in trial.notes}


def test_every_cell_is_a_number_or_unknown(tmp_path: Path, seed: int) -> None:
    """Counts are those of the channels; names of the columns stand in the first row of the description alone."""
    table = save(tmp_path, [values(seed, 5, 100.0)])
    cells = [line.split("\t") for line in table.read_text().splitlines()]
    assert len(cells) == 5 and {len(row) for row in cells} == {14}
    assert [cell for row in cells for cell in row if not re.fullmatch(r"-?\d+(\.\d+)?(e-\d+)?", cell)] == ["n/a"] * 7
    about = json.loads((tmp_path / f"{STEM}_motion.json").read_text())
    assert about["SamplingFrequency"] == 100.0 and about["MissingValues"] == "n/a"
    counts = {key: count for key, count in about.items() if key.endswith("Count") and count}
    assert counts == {
        "TrackedPointsCount": 4, "MotionChannelCount": 12, "POSChannelCount": 12, "LATENCYChannelCount": 1,
        "MiscChannelCount": 1,
    }  # fmt: skip
    with (tmp_path / f"{STEM}_channels.tsv").open(newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    assert list(rows[0])[:5] == ["name", "component", "type", "tracked_point", "units"] and len(rows) == 14
    assert len({row["name"] for row in rows}) == 14


@given(st.lists(st.text(max_size=60), unique=True, max_size=12))
def test_labels_of_any_names_differ_and_are_letters_and_digits(names: list[str]) -> None:
    """Also on disks that take small and large letters for the same."""
    labels = entity_labels(names)
    assert all(re.fullmatch("[A-Za-z0-9]{1,48}", label) for label in labels)
    assert len({label.casefold() for label in labels}) == len(names)


def test_plain_names_are_their_labels() -> None:
    """What cannot stand in a name of BIDS is left out; only names that would be alike are marked."""
    assert entity_labels(["walk_1", "Geh-Versuch é", "S04"]) == ["walk1", "GehVersuche", "S04"]
    marked = entity_labels(["walk_1", "walk1", "Walk 1", "run"])
    assert marked[3] == "run" and all(re.fullmatch("[wW]alk1[0-9a-f]{8}", one) for one in marked[:3])
    assert entity_labels(["walk1"]) == ["walk1"]


def test_results_are_no_recordings_unless_they_are_named(tmp_path: Path, seed: int) -> None:
    """A folder of recordings in which a run wrote its data set holds what it held before."""
    table = save(tmp_path / "out" / "bids", [values(seed, 5, 100.0)])
    recorded = save(tmp_path / "raw", [values(seed, 5, 100.0)])
    said = tmp_path / "out" / "bids" / "dataset_description.json"
    kinds = {"{": 2, '{"DatasetType": "raw"}': 2, '["derivative"]': 2, '{"DatasetType": "derivative"}': 1}
    for text, found in kinds.items():
        said.write_text(text)
        assert is_derivative(said.parent) == (found == 1)
        assert len(find_recordings(tmp_path)) == found
    assert find_recordings(tmp_path) == [(recorded, None)] and find_recordings(said.parent) == [(table, None)]
