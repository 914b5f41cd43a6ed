"""Tests of ``torchid check`` on folders and configs: what is found and paired, its exit code, and its JSON."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from trc_files import write_trc
from typer.testing import CliRunner

from torchid.checks import report as check_report
from torchid.checks.as_json import schema
from torchid.cli import app
from torchid.errors import InputError
from torchid.io.pairing import find_recordings, pair_files
from torchid.recording import Markers

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from documentation.check_schema import PAGE, text

runner = CliRunner()
GROUND = "nRows=2\nnColumns=4\nendheader\ntime\tground_force_vx\tground_force_vy\tground_force_vz\n0\t0\t700\t0\n"
ANGLES = "nRows=2\nnColumns=2\nendheader\ntime\tknee_angle_r\n0\t10\n"


def recording(path: Path, gaps: int = 0) -> Path:
    """A TRC of a swaying cloud of eight markers, tall along Y; as many as ``gaps`` are mostly missing."""
    random = np.random.default_rng(3)
    time = np.arange(60) / 100.0
    position = random.uniform([-0.2, -0.2, 0.1], [0.2, 0.2, 1.7], (8, 3)) + 1e-3 * random.normal(size=(60, 8, 3))
    position[:40, :gaps] = np.nan
    path.parent.mkdir(parents=True, exist_ok=True)
    write_trc(path, Markers(tuple("ABCDEFGH"), torch.from_numpy(time), torch.from_numpy(position)))
    return path


def tree(folder: Path, files: dict[str, str]) -> None:
    """Empty marker files and force files with the content given, below a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)


@pytest.mark.parametrize(
    ("markers", "forces", "belongs"),
    [
        ("static1.trc", "static1_grf.mot", True),
        ("a/markers.trc", "a/grf.sto", True),
        ("markers_walk.trc", "grf_walk.mot", True),
        ("MarkerData/walk 2.trc", "ForceData/walk_2_forces.mot", True),
        ("walk.trc", "Forces/walk.MOT", True),
        ("walk1.trc", "walk2_grf.mot", False),
        ("a/markers.trc", "b/grf.sto", False),
        ("a/deep/walk.trc", "walk_grf.mot", False),
    ],
)
def test_forces_find_their_markers(tmp_path: Path, markers: str, forces: str, belongs: bool) -> None:
    """By name and place, never those of another trial; a motion of that name is none."""
    tree(tmp_path, {markers: "", forces: GROUND})
    assert find_recordings(tmp_path) == [(tmp_path / markers, tmp_path / forces if belongs else None)]
    tree(tmp_path, {forces: ANGLES})
    assert find_recordings(tmp_path) == [(tmp_path / markers, None)]


def test_forces_of_a_folder_with_markers_of_its_own_are_theirs(tmp_path: Path) -> None:
    """Two subjects' folders side by side do not lend each other forces; hidden files are passed over."""
    tree(
        tmp_path, {"s1/walk.trc": "", "s2/walk.trc": "", "s2/walk_grf.mot": GROUND, "s1/b.C3D": "", "s1/notes.txt": ""}
    )
    tree(tmp_path, {".cache/x.trc": "", "s1/._walk.trc": ""})
    one, two = tmp_path / "s1", tmp_path / "s2"
    assert find_recordings(tmp_path) == [
        (one / "b.C3D", None),
        (one / "walk.trc", None),
        (two / "walk.trc", two / "walk_grf.mot"),
    ]


def timed(file: Path, start: float, rows: int) -> None:
    """A TRC, or a table of forces, at 100 Hz from a time on."""
    times = [start + 0.01 * k for k in range(rows)]
    if file.suffix == ".trc":
        head = f"PathFileType\t4\t(X/Y/Z)\tx\nDataRate\n100 100 {rows} 1 m 100 1 {rows}\nFrame#\tTime\tA\n\t\tX1\n\n"
        file.write_text(head + "".join(f"{k}\t{t:.2f}\t0\t0\t1\n" for k, t in enumerate(times, 1)))
    else:
        head = f"x\nnRows={rows}\nnColumns=4\nendheader\ntime\tground_force_vx\tground_force_vy\tground_force_vz\n"
        file.write_text(head + "".join(f"{t:.2f}\t0\t700\t0\n" for t in times))


def test_forces_of_another_name_find_the_markers_that_begin_and_end_with_them(tmp_path: Path) -> None:
    """Only where no other file on either side does, and never those that a name gives to others."""
    walk, squat, plates, other = (tmp_path / name for name in ("walk.trc", "squat.trc", "plates.mot", "other.mot"))
    timed(walk, 0.0, 240)
    timed(squat, 0.0, 500)
    timed(plates, 0.0, 241)
    assert find_recordings(tmp_path) == [(squat, None), (walk, plates)]
    timed(other, 0.0, 240)
    assert find_recordings(tmp_path) == [(squat, None), (walk, None)]
    timed(other, 1.0, 240)
    assert find_recordings(tmp_path) == [(squat, None), (walk, plates)]
    timed(tmp_path / "plates.trc", 3.0, 90)
    assert dict(find_recordings(tmp_path)) == {squat: None, walk: None, tmp_path / "plates.trc": plates}


def test_files_to_check_are_paired_in_order(tmp_path: Path) -> None:
    """A force file belongs to the marker file before it; one without, another kind and an empty folder are refused."""
    a, b, f = Path("a.TRC"), Path("b.c3d"), Path("a_grf.mot")
    assert pair_files([a, f, b]) == [(a, f), (b, None)]
    refused = [([f], "check.order"), ([a, f, f], "check.order"), ([Path("a.txt")], "check.kind")]
    for files, code in [*refused, ([tmp_path], "check.empty")]:
        with pytest.raises(InputError) as caught:
            pair_files(files)
        assert caught.value.code == code


def test_problems_end_with_two(tmp_path: Path) -> None:
    """A folder without problems ends with 0; one with a problem, or with a file that cannot be read, with 2."""
    recording(tmp_path / "good" / "a.trc")
    assert runner.invoke(app, ["check", str(tmp_path)]).exit_code == 0
    recording(tmp_path / "gaps" / "b.trc", gaps=6)
    result = runner.invoke(app, ["check", str(tmp_path)])
    assert result.exit_code == 2 and "markers.gaps" in result.stdout and "no problems found" in result.stdout
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "c.c3d").write_bytes(b"<html>")
    result = runner.invoke(app, ["check", str(tmp_path / "good"), str(tmp_path / "bad")])
    assert result.exit_code == 2 and "c3d.signature" in result.stderr and "a.trc" in result.stdout


@pytest.mark.parametrize("form", [(), ("--json",)])
def test_a_defect_in_one_recording_leaves_the_others_to_be_checked(tmp_path: Path, monkeypatch, form) -> None:
    """It is listed with its kind and words, the next recording is shown, and the exit code is that of a defect."""
    for name in ("a", "b", "c"):
        recording(tmp_path / f"{name}.trc")
    whole = check_report.check_trial

    def broken(trial, *rest):
        if trial.name == "b":
            raise RuntimeError("input tensor\nmust be non-empty")
        return whole(trial, *rest)

    monkeypatch.setattr(check_report, "check_trial", broken)
    result = runner.invoke(app, ["check", *form, str(tmp_path)])
    assert result.exit_code == 1 and "RuntimeError: input tensor must be non-empty" in result.output
    if form:
        found = json.loads(result.stdout)
        assert [one["name"] for one in found["files"]] == ["a", "c"]
        assert [one["code"] for one in found["refused"]] == ["torchid.defect"]
    else:
        assert "c.trc" in result.output


def test_warnings_end_with_zero(tmp_path: Path) -> None:
    """One marker that is mostly missing, and a row that lacks its end, are said and harm nothing."""
    recording(tmp_path / "a.trc", gaps=1)
    path = recording(tmp_path / "b.trc")
    path.write_text(path.read_text().rstrip("\n").rsplit("\t", 2)[0])
    result = runner.invoke(app, ["check", str(tmp_path)])
    assert result.exit_code == 0 and result.stdout.count("no problems found") == 2, result.output
    said = [line for line in result.stdout.splitlines() if line.startswith("~ ")]
    assert any("markers.gaps" in line for line in said) and any("b.trc" in line for line in said)


def test_lines_are_whole_where_nobody_watches(tmp_path: Path) -> None:
    """A file's name and a long cure stand in one line each when the text goes into a file."""
    path = recording(tmp_path / ("deep " * 20).strip() / "b.trc", gaps=6)
    lines = runner.invoke(app, ["check", str(tmp_path)]).stdout.splitlines()
    assert [line for line in lines if line.startswith("! ") and str(path) in line and line.endswith("[markers.gaps]")]


def fits(value, shape: dict, whole: dict) -> bool:
    """Whether JSON has the shape that a schema demands, in the few words that ours uses."""
    if "$ref" in shape:
        return fits(value, whole["$defs"][shape["$ref"].split("/")[-1]], whole)
    if "anyOf" in shape:
        return any(fits(value, one, whole) for one in shape["anyOf"])
    kinds = {"string": str, "integer": int, "number": (int, float), "null": type(None), "array": list, "object": dict}
    wanted = shape["type"] if isinstance(shape["type"], list) else [shape["type"]]
    own, inner = shape.get("properties", {}), shape.get("additionalProperties", {})
    return (
        any(isinstance(value, kinds[kind]) for kind in wanted)
        and (not isinstance(value, list) or all(fits(one, shape["items"], whole) for one in value))
        and (not isinstance(value, dict) or set(shape.get("required", ())) <= set(value))
        and (not isinstance(value, dict) or all(fits(v, own.get(k, inner), whole) for k, v in value.items()))
    )  # fmt: skip


def test_json_is_as_its_schema_says(tmp_path: Path) -> None:
    """Problems and refusals alike; numbers that are not known are null, and a wrong kind would not fit."""
    recording(tmp_path / "b.trc", gaps=6)
    (tmp_path / "c.c3d").write_bytes(b"<html>")
    result = runner.invoke(app, ["check", "--json", str(tmp_path)])
    found = json.loads(result.stdout, parse_constant=pytest.fail)
    assert result.exit_code == 2 and fits(found, schema(), schema())
    assert [note["code"] for note in found["files"][0]["problems"]] == ["markers.gaps"]
    assert [error["code"] for error in found["refused"]] == ["c3d.signature"] and found["refused"][0]["remedy"]
    found["files"][0]["markers"]["count"] = "8"
    assert not fits(found, schema(), schema())


def test_the_published_schema_is_the_present_one() -> None:
    """``PYTHONPATH=scripts python -m documentation.check_schema`` writes it."""
    assert PAGE.read_text(encoding="utf-8") == text()


@pytest.mark.parametrize(
    ("own", "code"),
    [("A: pelviss", "markers.segment"), ("A: pelvis", "markers.root"), ("A: pelvis\nB: pelvis\nC: pelvis", "")],
)
def test_a_configs_markers_are_checked(tmp_path: Path, own: str, code: str) -> None:
    """A marker set with an unknown segment, or with none of the labels, is refused before a run; else it is told."""
    recording(tmp_path / "a.trc")
    (tmp_path / "lab.yaml").write_text(own)
    (tmp_path / "c.yaml").write_text("{subject: {name: S}, markers: lab.yaml, trials: [{name: a, file: a.trc}]}")
    result = runner.invoke(app, ["check", str(tmp_path / "c.yaml")])
    assert result.exit_code == (2 if code else 0) and code in result.stderr
    assert code or "markers.unlisted" in result.stdout
