"""Tests of torchid.io.bids_motion: a Motion-BIDS file is what a TRC of the same numbers is."""

import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from walker import walking_trial

from torchid.config import Config, load_config
from torchid.errors import InputError
from torchid.evaluation import trials
from torchid.folder.people import told_of
from torchid.folder.statements import Person
from torchid.folder.survey import survey
from torchid.geometry.result import GeometryFit
from torchid.io import read_trial
from torchid.io.pairing import find_recordings
from torchid.io.storage import write_storage
from torchid.live import run as live
from torchid.recording import Markers
from torchid.run.sequence import run_key
from torchid.session import Session
from torchid.storage.results import OutputFolder

NAME = "sub-01_ses-1_task-walk_tracksys-omc"


@pytest.fixture
def markers(seed: int) -> Markers:
    """Of somebody who walks, one of them hidden for a while."""
    found = walking_trial(seed).markers
    found.position[20:24, 3] = torch.nan
    return found


def save(root: Path, markers: Markers, latency: bool = False, swapped: bool = False, **stated) -> Path:
    """A data set in mm, Z up, whose rate stands at its root; ``swapped`` has y before x."""
    folder = root / "sub-01" / "ses-1" / "motion"
    folder.mkdir(parents=True)
    order = [1, 0, 2] if swapped else [0, 1, 2]
    values = 1000.0 * markers.position[:, :, order].reshape(len(markers.time), -1).numpy()
    rows = [("xyz"[k], "POS", label, "mm", "lab") for label in markers.labels for k in order]
    rows.insert(1, ("x", "ACCEL", "sensor", "m/s^2", "lab"))
    values = np.insert(values, 1, 9.81, axis=1)
    if latency:
        rows.append(("n/a", "LATENCY", "n/a", "s", "n/a"))
        values = np.column_stack([values, markers.time.numpy()])
    head = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\n"
    lines = ["\t".join((f"c{k}", *row)) for k, row in enumerate(rows)]
    (folder / f"{NAME}_channels.tsv").write_text(head + "\n".join(lines) + "\n")
    frame = {"reference_frame": {"Levels": {"lab": {"SpatialAxes": "ALS"}}}}
    (folder / f"{NAME}_channels.json").write_text(json.dumps(frame))
    cells = ["\t".join("n/a" if np.isnan(x) else f"{x:.9f}" for x in row) for row in values]
    (folder / f"{NAME}_motion.tsv").write_text("\n".join(cells) + "\n")
    (root / "task-walk_motion.json").write_text(json.dumps({"SamplingFrequency": 100, **stated}))
    (root / "participants.tsv").write_text(
        "participant_id\tsex\tweight\theight\nsub-01\tF\t62.5\t168\nsub-02\tM\t90\t190\n"
    )
    return folder / f"{NAME}_motion.tsv"


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("latency", [False, True])
def test_positions_are_those_of_the_tracked_points(tmp_path: Path, markers: Markers, latency: bool, swapped: bool):
    """Whatever the order of the columns, in m; ``n/a`` is a gap and other channels are none."""
    trial = read_trial("walk", save(tmp_path, markers, latency, swapped))
    assert trial.markers.labels == markers.labels and trial.forces is None
    assert_allclose(trial.markers.time, markers.time, atol=1e-9)
    assert_allclose(trial.markers.position, markers.position, atol=1e-9, equal_nan=True)
    assert {"format": "BIDS", "subject": "sub-01", "up": "z"}.items() <= trial.parameters.items()


def test_the_nearest_description_and_the_effective_rate_hold(tmp_path: Path, markers: Markers):
    """A file beside it overrules the one at the root, key by key."""
    path = save(tmp_path, markers, SamplingFrequencyEffective=50.0)
    assert read_trial("walk", path).markers.rate == pytest.approx(50.0)
    path.with_name(f"{NAME}_motion.json").write_text('{"SamplingFrequencyEffective": 200}')
    assert read_trial("walk", path).markers.rate == pytest.approx(200.0)
    path.with_name(NAME.replace("walk", "run") + "_motion.json").write_text('{"SamplingFrequencyEffective": 1}')
    assert read_trial("walk", path).markers.rate == pytest.approx(200.0)


def test_forces_of_the_same_name_and_the_participant_are_found(tmp_path: Path, markers: Markers):
    """A MOT without the tracking system in its name, and the row of participants.tsv."""
    path = save(tmp_path, markers)
    columns = tuple(f"ground_force_1_{what}{axis}" for what in "vpm" for axis in "xyz")
    forces = path.with_name("sub-01_ses-1_task-walk_grf.mot")
    write_storage(forces, columns, markers.time.numpy(), np.tile([0, 0, 600.0, 0.1, 0, 0, 0, 0, 0], (220, 1)))
    assert find_recordings(tmp_path) == [(path, forces)]
    found = survey(tmp_path)
    assert found[0].has_forces
    person = told_of(tmp_path, found, Person()).person
    assert (person.sex, person.mass_kg, person.height_m) == ("female", 62.5, 1.68)


@pytest.mark.parametrize(
    ("file", "old", "new", "code"),
    [
        ("channels.tsv", "POS", "ORNT", "bids.positions"),
        ("channels.tsv", "c0\tx", "c0\ty", "bids.channels"),
        ("channels.tsv", "c0\tx\tPOS", "c0\tx\tVEL", "bids.channels"),
        ("channels.tsv", "tracked_point", "point", "bids.channels"),
        ("channels.tsv", "\tmm\tlab\nc3", "\tm\tlab\nc3", "bids.channels"),
        ("channels.tsv", "c0\tx\tPOS\tM0\tmm\tlab\n", "", "text.row"),
        ("channels.json", "{", "", "bids.sidecar"),
    ],
)
def test_descriptions_that_do_not_fit_are_refused(tmp_path: Path, markers: Markers, file, old, new, code):
    """Each with a code of its own."""
    path = save(tmp_path, markers)
    changed = path.with_name(f"{NAME}_{file}")
    assert old in changed.read_text()
    changed.write_text(changed.read_text().replace(old, new))
    with pytest.raises(InputError) as refused:
        read_trial("walk", path)
    assert refused.value.code == code


def test_what_is_absent_is_asked_for(tmp_path: Path, markers: Markers):
    """The rate, and the description of the columns."""
    path = save(tmp_path, markers, SamplingFrequency="n/a")
    with pytest.raises(InputError, match="SamplingFrequency.*n/a"):
        read_trial("walk", path)
    (tmp_path / "task-walk_motion.json").write_text("{}")
    with pytest.raises(InputError, match="SamplingFrequency") as refused:
        read_trial("walk", path)
    assert refused.value.found == ""
    (tmp_path / "task-walk_motion.json").write_text('{"SamplingFrequency": "100"}')
    assert read_trial("walk", path).markers.rate == pytest.approx(100.0)
    path.with_name(f"{NAME}_channels.tsv").unlink()
    with pytest.raises(InputError, match=f"{NAME}_channels.tsv beside it"):
        read_trial("walk", path)


def keys_of(config: Config) -> list[str]:
    """Of what a run, an evaluation and a stream store."""
    folder = Mock(spec=OutputFolder)
    folder.stage.return_value = Mock(spec=GeometryFit)
    live._from_standing(config, Mock(spec=Session), folder, lambda stage, part: None)
    return [run_key(config), str(trials._files(config, list(config.trials))), folder.stage.call_args.args[1]]


@pytest.mark.parametrize("file", [f"{NAME}_channels.tsv", f"{NAME}_channels.json", "../../../task-walk_motion.json"])
def test_what_is_stored_is_not_taken_up_after_a_description_was_corrected(tmp_path: Path, markers: Markers, file: str):
    """Its unit, its axes or its rate: each is part of the recording, wherever it stands."""
    path = save(tmp_path, markers)
    written = tmp_path / "c.yaml"
    trial = f"{{name: x, file: {path.relative_to(tmp_path)}}}"
    written.write_text(f"subject: {{name: s}}\nmarkers: plug_in_gait\ntrials: [{trial}]\n")
    config = load_config(written)
    before, changed = keys_of(config), path.parent / file
    assert keys_of(config) == before
    changed.write_text(changed.read_text() + "\n")
    assert all(one != other for one, other in zip(keys_of(config), before, strict=True))
