"""Tests of torchid.io.b3d: trials of AddBiomechanics' container are what a TRC and a MOT of the same numbers are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from b3d_bytes import B3dTrial, b3d_bytes, write_b3d
from numpy.testing import assert_allclose, assert_array_equal
from trc_files import write_trc
from typer.testing import CliRunner
from walker import walking_trial

from torchid.cli import app
from torchid.config import load_config
from torchid.conventions import y_up_to_z_up
from torchid.errors import ConfigError, InputError
from torchid.folder.survey import names_of, survey
from torchid.io import ReadOptions, read_trial
from torchid.io.files import file_on_disk
from torchid.io.mend import ForcesAs
from torchid.io.pairing import find_recordings, pair_files
from torchid.io.storage import write_storage
from torchid.recording import Trial


@pytest.fixture
def walk(seed: int) -> Trial:
    """Somebody who walks over two plates, with a marker that is hidden for a while."""
    trial = walking_trial(seed, corners=False)
    trial.markers.position[20:24, 3] = torch.nan
    return trial


def turned(values: torch.Tensor) -> np.ndarray:
    """Vectors of W in axes that are Y up."""
    return y_up_to_z_up(y_up_to_z_up(y_up_to_z_up(values))).numpy()


def stored(trial: Trial, name: str = "walk", **changes) -> B3dTrial:
    """A trial as a .b3d holds it: the free moment of each plate at its centre of pressure."""
    assert trial.forces is not None
    force, about = trial.forces.wrench[..., :3], trial.forces.wrench[..., 3:]
    point = trial.forces.centre_of_pressure(0.0).nan_to_num()
    free = about - torch.linalg.cross(point, force)
    return replace(
        B3dTrial(name, turned(trial.markers.position), turned(force), turned(point), turned(free)), **changes
    )


def save(path: Path, trial: Trial, *trials: B3dTrial) -> Path:
    return write_b3d(path, trial.markers.labels, list(trials) or [stored(trial)], trial.markers.rate)


def codes(trial: Trial) -> set[str]:
    return {note.code for note in trial.notes}


def test_a_trial_is_what_a_trc_and_a_mot_of_its_numbers_are(tmp_path: Path, walk: Trial) -> None:
    """Markers to the digits of a TRC, gaps where it has blank cells, wrenches about the same origin."""
    one = stored(walk)
    write_trc(tmp_path / "walk.trc", walk.markers)
    columns = tuple(f"ground_force_{k + 1}_{what}{axis}" for k in range(2) for what in "vpm" for axis in "xyz")
    values = np.concatenate([x[:, k] for k in range(2) for x in (one.force, one.point, one.torque)], axis=1)
    write_storage(tmp_path / "walk.mot", columns, walk.markers.time.numpy(), values)
    text = read_trial("walk", tmp_path / "walk.trc", tmp_path / "walk.mot")
    own = read_trial("walk", save(tmp_path / "S1.b3d", walk) / "walk")
    assert own.markers.labels == text.markers.labels and own.forces is not None and text.forces is not None
    assert_allclose(own.markers.time, text.markers.time, atol=1e-9)
    assert_allclose(own.markers.position, text.markers.position, atol=1e-8, equal_nan=True)
    assert own.markers.position[20:24, 3].isnan().all()
    assert_allclose(own.forces.wrench, text.forces.wrench, atol=1e-6, equal_nan=True)
    assert_allclose(own.forces.wrench, walk.forces.wrench, atol=1e-9)  # type: ignore[union-attr]
    assert [plate.name for plate in own.forces.plates] == ["plate 1", "plate 2"]


def test_the_header_says_whom_it_shows(tmp_path: Path, walk: Trial) -> None:
    """Mass, stature, sex and age come into the facts of every trial; parts of one subject have one name."""
    trial = read_trial("walk", save(tmp_path / "S1_split2.b3d", walk) / "walk")
    said = {"subject": "S1", "mass_kg": "72.5", "height_m": "1.76", "sex": "female", "age_years": "31", "up": "y"}
    assert said.items() <= trial.parameters.items()
    (one,) = survey(tmp_path)
    assert (one.name, one.stated["sex"], one.stated["age_years"], one.has_forces) == ("walk", "female", "31", True)


def test_each_trial_has_its_own_frames(tmp_path: Path, walk: Trial) -> None:
    """Trials of other lengths stand one behind the other; names that are alike are numbered, slashes are none."""
    short = stored(walk, "walk")
    short = replace(short, **{key: getattr(short, key)[40:130] for key in ("position", "force", "point", "torque")})
    path = save(tmp_path / "a.b3d", walk, stored(walk, "run/1"), short, stored(walk, "walk"))
    names = [file.name for file, _ in find_recordings(tmp_path)]
    assert names == ["run_1", "walk", "walk_2"]
    found = [read_trial(name, path / name) for name in names]
    assert [len(trial.markers.time) for trial in found] == [220, 90, 220]
    assert_array_equal(found[1].markers.position[:30], found[2].markers.position[40:70])
    assert_array_equal(found[1].forces.wrench[:30], found[2].forces.wrench[40:70])  # type: ignore[union-attr]


def test_frames_whose_forces_are_not_known_are_gaps(tmp_path: Path, walk: Trial) -> None:
    """Of all plates, and said with the reason; where no frame is known there are no forces."""
    missing = [0] * 220
    missing[50:80] = [5] * 30
    path = save(
        tmp_path / "a.b3d", walk, stored(walk, "part", missing=missing), stored(walk, "all", missing=[14] * 220)
    )
    trial = read_trial("part", path / "part")
    assert trial.forces is not None
    gaps = trial.forces.wrench.isnan().all(dim=(1, 2))
    assert gaps.nonzero().flatten().tolist() == list(range(50, 80)) and not trial.forces.wrench[~gaps].isnan().any()
    (said,) = (note.message for note in trial.notes if note.code == "b3d.forces_unknown")
    assert "30 of 220" in said and "not over a plate" in said
    none = read_trial("all", path / "all")
    assert none.forces is None and "b3d.forces_unknown" in codes(none)


def test_without_plates_the_first_pass_tells_the_forces(tmp_path: Path, walk: Trial) -> None:
    """By the bodies that touch the ground, and said; bodies that never bear anything are no measurement."""
    idle = {key: np.zeros((220, 2, 3)) for key in ("force", "point", "torque")}
    by_body, empty = stored(walk, "a", by_body=True), stored(walk, "b", by_body=True, **idle)
    path = save(tmp_path / "a.b3d", walk, by_body, empty)
    trial = read_trial("a", path / "a")
    assert trial.forces is not None and "b3d.by_body" in codes(trial)
    assert [plate.name for plate in trial.forces.plates] == ["calcn_r", "calcn_l"]
    assert_allclose(trial.forces.wrench, walk.forces.wrench, atol=1e-9)  # type: ignore[union-attr]
    assert read_trial("b", path / "b").forces is None


def test_moments_about_the_origin_are_told_from_free_ones(tmp_path: Path, walk: Trial) -> None:
    """Some programs store them so; the wrench is the same, and that is said."""
    free = stored(walk)
    path = save(tmp_path / "a.b3d", walk, replace(free, torque=free.torque + np.cross(free.point, free.force)))
    trial = read_trial("walk", path)
    assert trial.forces is not None and "b3d.moments" in codes(trial)
    assert_allclose(trial.forces.wrench, walk.forces.wrench, atol=1e-9)  # type: ignore[union-attr]


def test_corners_are_kept_where_they_are_a_plate_s(tmp_path: Path, seed: int) -> None:
    """Corners that are all at one place are none."""
    trial = walking_trial(seed)
    assert trial.forces is not None
    corners = torch.stack([plate.corners for plate in trial.forces.plates])  # type: ignore[misc]
    stored_corners = turned(corners)
    stored_corners[1] = 0.0
    found = read_trial("walk", save(tmp_path / "a.b3d", trial, stored(trial, corners=stored_corners)) / "walk")
    assert found.forces is not None and found.forces.plates[1].corners is None
    assert_allclose(found.forces.plates[0].corners, corners[0], atol=1e-12)  # type: ignore[arg-type]


def test_a_gain_of_moments_is_applied_once(tmp_path: Path, walk: Trial) -> None:
    """As in a MOT: to the free moments alone."""
    path = save(tmp_path / "a.b3d", walk)
    one, two = (read_trial("a", path, options=ReadOptions(forces_as=ForcesAs(moment_gain=g))) for g in (1.0, 3.0))
    free = turned(walk.forces.wrench[..., 3:])  # type: ignore[union-attr]
    assert np.abs(free).max() > 1.0
    grown = (two.forces.wrench - one.forces.wrench).numpy()  # type: ignore[union-attr]
    assert_allclose(grown[..., :3], 0.0, atol=1e-12)
    assert_allclose(grown[..., 3:], 2.0 * y_up_to_z_up(torch.from_numpy(stored(walk).torque)), atol=1e-9)


def test_a_config_names_a_trial_as_if_the_file_were_a_folder(tmp_path: Path, walk: Trial) -> None:
    """The file has to be there; a trial that is not is refused with the names of those that are."""
    path = save(tmp_path / "S1.b3d", walk, stored(walk, "a"), stored(walk, "b"))
    (tmp_path / "c.yaml").write_text(
        "subject: {name: s}\nmarkers: plug_in_gait\nout: out\ntrials: [{name: x, file: S1.b3d/b}]\n"
    )
    (trial,) = load_config(tmp_path / "c.yaml").trials
    assert trial.file == path / "b" and file_on_disk(trial.file) == path
    for wrong in (path / "c", path):
        with pytest.raises(InputError, match="a and b") as refused:
            read_trial("x", wrong)
        assert refused.value.code == "b3d.trial"
    path.unlink()
    with pytest.raises(ConfigError, match="no such file"):
        load_config(tmp_path / "c.yaml")


def test_check_takes_a_file_of_trials_as_a_folder(tmp_path: Path, walk: Trial) -> None:
    """Every trial is checked; a file of forces behind it belongs to none of them."""
    path = save(tmp_path / "S1.b3d", walk, stored(walk, "a"), stored(walk, "b"))
    assert pair_files([path]) == [(path / "a", None), (path / "b", None)]
    assert pair_files([path / "b"]) == [(path / "b", None)]
    assert pair_files([path / "b", tmp_path / "a.mot"]) == [(path / "b", tmp_path / "a.mot")]
    for whole in (path, tmp_path):
        with pytest.raises(InputError, match="without markers"):
            pair_files([whole, tmp_path / "a.mot"])
    said = CliRunner().invoke(app, ["check", str(path)]).output
    assert said.count("220 frames") == 2


def test_what_stands_behind_a_dot_is_part_of_a_trial_s_name(tmp_path: Path, walk: Trial) -> None:
    """Speeds, in a session as in a check."""
    path = save(tmp_path / "S1.b3d", walk, stored(walk, "speed_1.2"), stored(walk, "speed_1.4"))
    (tmp_path / "b").mkdir()
    save(tmp_path / "b" / "S2.b3d", walk, stored(walk, "speed_1.4"))
    files = [file for file, _ in find_recordings(tmp_path)]
    whole = [file for file, _ in find_recordings(path)]
    assert sorted(names_of(files, tmp_path)) == ["S1.b3d_speed_1.4", "S2.b3d_speed_1.4", "speed_1.2"]
    assert names_of(whole, path) == ["speed_1.2", "speed_1.4"]
    assert "speed_1.2" in CliRunner().invoke(app, ["check", str(path)]).output.splitlines()


def test_a_file_that_is_not_there_is_said_to_be_absent(tmp_path: Path) -> None:
    """It is no empty folder."""
    said = CliRunner().invoke(app, ["check", str(tmp_path / "S1.b3d")])
    assert said.exit_code == 2 and "No such file" in said.output and "folder" not in said.output


def test_a_damaged_file_among_others_is_one_recording_that_is_refused(tmp_path: Path, walk: Trial) -> None:
    """It keeps no folder from being surveyed."""
    save(tmp_path / "good.b3d", walk)
    (tmp_path / "bad.b3d").write_bytes(b"\x10" * 64)
    found = {one.file.name: one.refusal for one in survey(tmp_path)}
    assert set(found) == {"walk", "bad.b3d"} and found["walk"] is None
    assert found["bad.b3d"] is not None and found["bad.b3d"].code == "b3d.header"


def test_a_file_that_was_cut_or_damaged_is_refused(tmp_path: Path, walk: Trial, seed: int) -> None:
    """Wherever it is cut; and bytes between the numbers of a frame are the same in all frames."""
    whole = b3d_bytes(walk.markers.labels, [stored(walk)], 100.0)
    random = np.random.default_rng(seed)
    path = tmp_path / "a.b3d"
    for stop in (0, 5, 8, 40, len(whole) - 1, *random.integers(9, len(whole), 20)):
        path.write_bytes(whole[:stop])
        with pytest.raises(InputError):
            read_trial("walk", path / "walk")
    marked = bytearray(whole)
    # The second frame begins with the key of its markers.
    first = 8 + int.from_bytes(whole[:8], "little")
    second = first + (len(whole) - first) // 220
    assert marked[second] == 2 << 3 | 2
    marked[second] ^= 1
    path.write_bytes(marked)
    with pytest.raises(InputError, match="frame 2") as refused:
        read_trial("walk", path / "walk")
    assert refused.value.code == "b3d.frames"
