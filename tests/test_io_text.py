"""Tests of torchid.io.table, storage, trc and grf: text files with everything that laboratories do to them."""

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from trc_files import write_trc

from torchid.errors import InputError, TorchidError
from torchid.io import ReadOptions, read_trial
from torchid.io.mend import PlateAs
from torchid.io.resample import synchronise
from torchid.io.storage import read_storage, write_storage
from torchid.io.trc import read_trc
from torchid.recording import Markers

FRAMES, MARKERS = 12, 7


def cloud(seed: int = 0) -> np.ndarray:
    """Markers [m] of somebody 1.7 m tall in a Y-up laboratory."""
    random = np.random.default_rng(seed)
    base = random.uniform([-0.2, 0.05, -0.2], [0.2, 1.6, 0.2], (MARKERS, 3))
    base[0, 1], base[1, 1] = 0.05, 1.7
    return base + 0.01 * random.normal(size=(FRAMES, MARKERS, 3))


def trc_text(position: np.ndarray, units: str = "m", rate: float = 100.0, labels: list[str] | None = None) -> str:
    """A plain TRC."""
    labels = labels or [f"M{chr(65 + k)}" for k in range(position.shape[1])]
    head = [
        "PathFileType\t4\t(X/Y/Z)\tx.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{len(position)}\t{len(labels)}\t{units}\t{rate}\t1\t{len(position)}",
        "Frame#\tTime\t" + "\t\t\t".join(labels) + "\t\t",
        "\t\t" + "\t".join(f"{a}{k + 1}" for k in range(len(labels)) for a in "XYZ"),
        "",
    ]
    rows = [
        "\t".join([str(k + 1), f"{k / rate:.6f}", *(f"{x:.8g}" for x in row.ravel())]) for k, row in enumerate(position)
    ]
    return "\n".join([*head, *rows]) + "\n"


def save(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def codes(notes) -> set[str]:
    return {note.code for note in notes}


def mot_text(
    columns: list[str], values: np.ndarray, rate: float = 100.0, header: str = "nRows={}\ninDegrees=no"
) -> str:
    """A plain MOT."""
    rows = ["\t".join([f"{k / rate:.6f}", *(f"{x:.10g}" for x in row)]) for k, row in enumerate(values)]
    return "\n".join(["forces", header.format(len(values)), "endheader", "\t".join(["time", *columns]), *rows]) + "\n"


def test_blank_cells_keep_their_columns(tmp_path: Path) -> None:
    """A gap of three blank cells is NaN and leaves every other marker where it is."""
    position = cloud()
    lines = trc_text(position).split("\n")
    cells = lines[8].split("\t")
    cells[2 + 3 : 2 + 6] = ["", "", ""]
    cells[-3:] = ["", "", ""]
    lines[8] = "\t".join(cells)
    trc = read_trc(save(tmp_path / "a.trc", "\n".join(lines)))
    expected = position.copy()
    expected[2, 1] = expected[2, -1] = np.nan
    assert_allclose(trc.position, expected, atol=1e-7)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\t\t\tMB", "\t\t\t MB "),
        lambda text: text.replace("X1\tY1\tZ1", "X0\tY0\tZ0"),
        lambda text: text.replace("\tOrigNumFrames", "").replace("\t1\t12\n", "\t1\n"),
        lambda text: text.replace("\t100.0\t12\t", "\t\t100.0\t\t   12\t\t"),
        lambda text: text.replace("\t\t\n", "\n", 1),
        lambda text: text.rstrip("\n"),
    ],
)
def test_harmless_styles_read_the_same(tmp_path: Path, change) -> None:
    """Line ends, byte order mark, padding, numbering, a missing key, doubled tabs and trailing tabs do not matter."""
    position = cloud()
    trial = read_trial("a", save(tmp_path / "a.trc", change(trc_text(position))))
    assert_allclose(
        trial.markers.position, np.stack([position[..., 0], -position[..., 2], position[..., 1]], -1), atol=1e-7
    )
    assert trial.markers.labels[:2] == ("MA", "MB")
    assert_allclose(trial.markers.rate, 100.0)


@pytest.mark.parametrize("spelling", ["NaN", "nan", "-nan(ind)", "1.#QNAN", "N/A", "0"])
def test_spellings_of_missing(tmp_path: Path, spelling: str) -> None:
    """Five spellings of NaN, and exact zeros, are missing markers."""
    lines = trc_text(cloud()).split("\n")
    cells = lines[7].split("\t")
    cells[2:5] = [spelling] * 3
    lines[7] = "\t".join(cells)
    trial = read_trial("a", save(tmp_path / "a.trc", "\n".join(lines)))
    assert_array_equal(np.argwhere(trial.markers.position.isnan().any(-1).numpy()), [[1, 0]])


@pytest.mark.parametrize(
    ("change", "code", "place"),
    [
        (lambda lines: lines[:8] + [lines[8][:60]] + lines[9:], "text.row", "line 9"),
        (lambda lines: lines[:8] + [lines[8] + "\t7\t8"] + lines[9:], "text.row", "line 9"),
        (lambda lines: lines[:8] + [lines[8].replace(".", ",")] + lines[9:], "text.decimal_comma", "line 9"),
        (lambda lines: lines[:8] + [lines[8].replace("0.", "O.")] + lines[9:], "text.number", "line 9"),
        (lambda lines: lines[:8] + [lines[9], lines[8]] + lines[10:], "time.order", "line 10, column time"),
        (lambda lines: [lines[k] for k in (*range(8), *range(8, 18, 3))], "time.irregular", "line "),
        (lambda lines: ["hello"] + lines[1:], "trc.signature", "line 1"),
        (lambda lines: [*lines[:3], lines[3].replace("Frame#\t", ""), *lines[4:]], "trc.columns", "line 4"),
        (lambda lines: [*lines[:3], "", *lines[3:]], "trc.columns", "line 4"),
        (lambda lines: lines[:6], "trc.empty", ""),
        (lambda lines: lines[:3], "trc.header", "line 3, the last"),
        (lambda lines: [lines[0], lines[1][:40], ""], "trc.header", "line 2, the last"),
        (lambda lines: [line.replace("MA", "ground_force_vx") for line in lines], "trc.forces", "label line"),
    ],
)
def test_broken_trc_is_refused_with_its_place(tmp_path: Path, change, code: str, place: str) -> None:
    """Each way to break a TRC gets its own code and says where."""
    path = save(tmp_path / "a.trc", "\n".join(change(trc_text(cloud()).rstrip("\n").split("\n"))))
    with pytest.raises(InputError) as caught:
        read_trc(path)
    assert caught.value.code == code and caught.value.remedy
    assert place in caught.value.place


def test_an_incomplete_last_row_is_left_out_and_said(tmp_path: Path) -> None:
    """A file cut in its last row loses that row and nothing else."""
    trc = read_trc(save(tmp_path / "a.trc", trc_text(cloud())[:-40]))
    assert len(trc.time) == FRAMES - 1
    assert {"text.last_row", "trc.counts"} <= codes(trc.notes)


@pytest.mark.parametrize("style", ["{:.6f}", "{:.6e}", "{:.6g}"])
@pytest.mark.parametrize("tab", ["", "\t"])
def test_no_cut_is_silent(tmp_path: Path, style: str, tab: str) -> None:
    """Wherever the last row of a MOT is cut, it is left out, or kept with the word that it has no line end."""
    rows = ["\t".join([f"{k / 100:.2f}", *(style.format(x) for x in row)]) + tab for k, row in enumerate(standing())]
    text = "\n".join(["endheader", "\t".join(["time", *force_columns()]), *rows])
    full = read_storage(save(tmp_path / "a.mot", text + "\n"))
    assert full.notes == ()
    for cut in range(1, len(rows[-1])):
        found = read_storage(save(tmp_path / "a.mot", text[:-cut]))
        (said,) = codes(found.notes)
        assert said == ("text.no_line_end" if len(found.values) == FRAMES else "text.last_row")
        lost = np.abs(found.values - full.values[: len(found.values)]).max()
        assert lost <= (1e-4 if style != "{:.6g}" else 0.1), f"{cut} characters cut change {lost}"


def test_a_missing_cell_is_not_read_as_shifted_columns(tmp_path: Path) -> None:
    """A cell less in one row, or in all, is refused, though tabs at the ends of rows make up for it."""
    head, rows = trc_text(cloud()).split("\n")[:6], [f"{row}\t" for row in trc_text(cloud()).rstrip().split("\n")[6:]]
    cut = ["\t".join(row.split("\t")[:8] + row.split("\t")[9:]) for row in rows]
    with pytest.raises(InputError, match="shifted") as caught:
        read_trc(save(tmp_path / "a.trc", "\n".join([*head, *rows[:3], cut[3], *rows[4:]]) + "\n"))
    assert (caught.value.code, caught.value.place) == ("text.row", "line 10")
    with pytest.raises(InputError, match=r"MG.*trc\.shifted"):
        read_trc(save(tmp_path / "a.trc", "\n".join([*head, *cut]) + "\n"))


def test_a_point_with_a_coordinate_missing_is_a_gap_and_said(tmp_path: Path) -> None:
    """One blank coordinate makes the point a gap, with marker and line."""
    lines = trc_text(cloud()).split("\n")
    cells = lines[8].split("\t")
    cells[6] = ""
    lines[8] = "\t".join(cells)
    trc = read_trc(save(tmp_path / "a.trc", "\n".join(lines)))
    assert_array_equal(np.argwhere(np.isnan(trc.position).any(-1)), [[2, 1]])
    (said,) = [note.message for note in trc.notes if note.code == "trc.partial"]
    assert "MB in line 9" in said


def test_missing_rows_and_wrong_frame_numbers_are_said(tmp_path: Path) -> None:
    """Rows cut out become frames of gaps; frame numbers that leap while time goes on are named with their line."""
    lines = trc_text(cloud()).split("\n")
    trc = read_trc(save(tmp_path / "a.trc", "\n".join(lines[:10] + lines[12:])))
    assert len(trc.time) == FRAMES and codes(trc.notes) == {"time.gaps", "trc.counts"}
    assert_array_equal(np.flatnonzero(np.isnan(trc.position).all(axis=(1, 2))), [4, 5])
    assert_array_equal(trc.lines[[3, 4, 6]], [10, 0, 11])
    lines[10] = lines[10].replace("5\t", "9\t", 1)
    (said,) = read_trc(save(tmp_path / "a.trc", "\n".join(lines))).notes
    assert said.code == "trc.frame_numbers" and "line 11" in said.message


def test_an_absurd_marker_sample_is_named_with_its_line(tmp_path: Path) -> None:
    """A digit too many in one cell of a TRC is a gap of that marker, in that line."""
    position = cloud()[:1] + 1e-3 * np.random.default_rng(5).normal(size=(FRAMES, MARKERS, 3))
    position[4, 3, 0] += 9.0
    trial = read_trial("a", save(tmp_path / "a.trc", trc_text(position)))
    assert_array_equal(np.argwhere(trial.markers.position.isnan().any(-1).numpy()), [[4, 3]])
    (said,) = [note.message for note in trial.notes if note.code == "markers.spikes"]
    assert "MD (frame 5, line 11)" in said


def test_unlabelled_points_after_the_labelled_are_left_out(tmp_path: Path) -> None:
    """Rows with more cells than labels are read where the header counts more markers than it labels."""
    lines = trc_text(cloud()).split("\n")
    lines[2] = lines[2].replace(f"\t{MARKERS}\t", "\t20\t")
    rows = [line + "\t1.5\t2.5\t3.5" * (k % 3) for k, line in enumerate(lines[6:-1])]
    trc = read_trc(save(tmp_path / "a.trc", "\n".join([*lines[:6], *rows]) + "\n"))
    assert_allclose(trc.position, cloud(), atol=1e-7)
    assert "trc.counts" in codes(trc.notes)


def test_units_from_header_data_or_user(tmp_path: Path) -> None:
    """mm, m and inches read the same; an absent unit is told from the cloud; a lying one is refused or overridden."""
    position = cloud()
    reference = read_trial("a", save(tmp_path / "a.trc", trc_text(position))).markers.position
    for units, factor in (("mm", 1e3), ("in", 1 / 0.0254), ("Meters", 1.0), ("", 1e3)):
        trial = read_trial("a", save(tmp_path / "b.trc", trc_text(position * factor, units)))
        assert_allclose(trial.markers.position, reference, atol=1e-6)
        assert ("units.assumed" in codes(trial.notes)) == (not units)
    lying = save(tmp_path / "c.trc", trc_text(position, "mm"))
    with pytest.raises(InputError, match=r"units\.implausible"):
        read_trial("a", lying)
    told = read_trial("a", lying, options=ReadOptions(units="m"))
    assert_allclose(told.markers.position, reference, atol=1e-7)
    assert "units.override" in codes(told.notes)


def test_rounded_times_become_uniform(tmp_path: Path) -> None:
    """Times rounded to 3 digits at 60 Hz give 60 Hz, not 58.8 Hz, and that is said."""
    position = np.tile(cloud(), (5, 1, 1))
    lines = trc_text(position, rate=60.0).split("\n")
    for k in range(len(position)):
        cells = lines[6 + k].split("\t")
        lines[6 + k] = "\t".join([cells[0], f"{k / 60.0:.3f}", *cells[2:]])
    trc = read_trc(save(tmp_path / "a.trc", "\n".join(lines)))
    assert_allclose(trc.time, np.arange(len(position)) / 60.0, atol=1e-9)
    assert "time.rounded" in codes(trc.notes)


@pytest.mark.parametrize("y_up", [True, False])
def test_trc_round_trip(tmp_path: Path, y_up: bool) -> None:
    """What write_trc writes reads back to 1e-8 m, gaps included, in either axes."""
    position = torch.from_numpy(cloud())
    position = torch.stack([position[..., 0], -position[..., 2], position[..., 1]], -1)
    position[3:5, 2] = torch.nan
    markers = Markers(tuple("ABCDEFG"), torch.arange(FRAMES, dtype=torch.float64) / 100 + 1.5, position)
    write_trc(tmp_path / "a.trc", markers, y_up)
    back = read_trial("a", tmp_path / "a.trc", options=ReadOptions(up="y" if y_up else "z")).markers
    torch.testing.assert_close(back.position, position, atol=1e-8, rtol=0, equal_nan=True)
    torch.testing.assert_close(back.time, markers.time)
    assert [path.name for path in tmp_path.iterdir()] == ["a.trc"]


def test_a_rate_that_the_times_contradict_is_said(tmp_path: Path) -> None:
    """The time column stands above DataRate, and both are named."""
    lines = trc_text(cloud()).split("\n")
    lines[2] = lines[2].replace("100.0", "250.0", 1)
    trc = read_trc(save(tmp_path / "a.trc", "\n".join(lines)))
    assert_allclose(trc.time, np.arange(FRAMES) / 100.0)
    (said,) = [note.message for note in trc.notes if note.code == "trc.rate"]
    assert "250 Hz" in said and "100 Hz" in said


def test_storage_round_trip_and_header_styles(tmp_path: Path) -> None:
    """MOT written by us, with SIMM keys, padded endheader and blank lines reads back exactly."""
    values = np.random.default_rng(1).normal(size=(9, 3))
    write_storage(tmp_path / "a.sto", ("a", "b", "c"), np.arange(9) / 10, values, in_degrees=True)
    storage = read_storage(tmp_path / "a.sto")
    assert storage.columns == ("a", "b", "c") and storage.in_degrees is True
    assert_allclose(storage.values, values, rtol=1e-11)
    assert_allclose(storage.column("b"), values[:, 1], rtol=1e-11)
    text = (tmp_path / "a.sto").read_text().replace("endheader", "datacolumns 4\n\nendheader ")
    assert_array_equal(read_storage(save(tmp_path / "b.mot", text)).values, storage.values)
    unknown = read_storage(save(tmp_path / "c.mot", text.replace("inDegrees=yes", "note here")))
    assert unknown.in_degrees is None


def test_a_header_that_counts_otherwise_is_said(tmp_path: Path) -> None:
    """Rows and columns are those that are there; a header that states others is repeated beside them."""
    text = mot_text(["a", "b"], np.zeros((9, 2)), header="nRows=7\nnColumns=4")
    storage = read_storage(save(tmp_path / "a.mot", text))
    assert storage.values.shape == (9, 2)
    said = [note.message for note in storage.notes if note.code == "storage.counts"]
    assert said == ["nrows is 7, the file holds 9", "ncolumns is 4, the file holds 3"]
    text = mot_text(["a", "b"], np.zeros((9, 2)), header="datarows 7\nnRows=9\ndatacolumns 4")
    said = [
        note.message for note in read_storage(save(tmp_path / "b.mot", text)).notes if note.code == "storage.counts"
    ]
    assert said == ["datarows is 7, the file holds 9", "datacolumns is 4, the file holds 3"]


@pytest.mark.parametrize(
    ("change", "place", "found"),
    [
        (lambda text: text.replace("endheader", ""), "header", "forces"),
        (lambda text: text.split("endheader")[0] + "endheader\n", "header", "forces"),
        (lambda text: text.replace("time\ta", "frame\ta"), "line 5", "frame, a, b"),
        (lambda text: "", "header", "''"),
    ],
)
def test_what_is_no_storage_is_refused_with_its_place(tmp_path: Path, change, place: str, found: str) -> None:
    """Without endheader, names of columns or a first column of times nothing is read."""
    path = save(tmp_path / "a.sto", change(mot_text(["a", "b"], np.zeros((9, 2)))))
    with pytest.raises(InputError) as caught:
        read_storage(path)
    assert caught.value.code == "storage.header" and caught.value.source == str(path) and caught.value.remedy
    assert caught.value.place == place and found in caught.value.found


def pair(folder: Path, values: np.ndarray, names: list[str] | None = None):
    """A trial of a plain TRC beside a MOT with these values, whose first row stands in line 6."""
    mot = save(folder / "a.mot", mot_text(names or force_columns(), values))
    return read_trial("a", save(folder / "a.trc", trc_text(cloud())), mot)


def standing(seed: int = 2) -> np.ndarray:
    """Rows of force, centre of pressure and free moment of somebody of 700 N who stands in a Y-up laboratory."""
    random = np.random.default_rng(seed)
    force = random.normal(size=(FRAMES, 3)) * 20 + [0, 700, 0]
    point, free = 0.3 + 0.01 * random.normal(size=(FRAMES, 3)), random.normal(size=(FRAMES, 3))
    return np.concatenate([force, point, free], axis=1)


def wrench_of(values: np.ndarray) -> np.ndarray:
    """The wrench p x F + T about the origin, rotated to Z up."""
    force, moment = values[:, :3], np.cross(values[:, 3:6], values[:, :3]) + values[:, 6:]
    return np.stack([force[:, 0], -force[:, 2], force[:, 1], moment[:, 0], -moment[:, 2], moment[:, 1]], axis=1)


@pytest.mark.parametrize("names", [("ground_force_{}", "ground_torque_{}"), ("FP1_{}", "FP1_moment_{}")])
def test_columns_of_forces_become_wrenches(tmp_path: Path, names: tuple[str, str]) -> None:
    """Force, centre of pressure and free moment give the wrench about the origin."""
    columns = [names[0].format(w + a) for w in "vp" for a in "xyz"] + [names[1].format(a) for a in "xyz"]
    trial = pair(tmp_path, standing(), columns)
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench[:, 0], wrench_of(standing()), atol=1e-6)


def test_vectors_in_cells_read_as_columns(tmp_path: Path) -> None:
    """A STO of Vec3 gives the wrench of the same numbers in columns; other types are refused by name."""
    values = standing()
    rows = [
        "\t".join([f"{k / 100:.6f}", *(",".join(f"{x:.10g}" for x in row[c : c + 3]) for c in (0, 3, 6))])
        for k, row in enumerate(values)
    ]
    text = "\n".join(["DataType=Vec3", "version=3", "endheader", "time\tf1\tp1\tm1", *rows]) + "\n"
    trc = save(tmp_path / "a.trc", trc_text(cloud()))
    trial = read_trial("a", trc, save(tmp_path / "a.sto", text))
    assert trial.forces is not None and trial.forces.plates[0].name == "f1"
    assert_allclose(trial.forces.wrench[:, 0], wrench_of(values), atol=1e-6)
    with pytest.raises(InputError, match=r"Quaternion.*storage\.type"):
        read_storage(save(tmp_path / "b.sto", text.replace("=Vec3", "=Quaternion")))


def test_only_a_vertical_free_moment_is_enough(tmp_path: Path) -> None:
    """A file with one column of free moment is read with it, and the rest is said to be zero."""
    values = standing()
    values[:, [6, 8]] = 0.0
    trial = pair(tmp_path, np.delete(values, [6, 8], axis=1), force_columns()[:6] + ["ground_torque_1_y"])
    assert trial.forces is not None and "mot.no_moment" in codes(trial.notes)
    assert_allclose(trial.forces.wrench[:, 0], wrench_of(values), atol=1e-6)


def force_columns(prefix: str = "ground_force_1") -> list[str]:
    return [f"{prefix}_{w}{a}" for w in "vpm" for a in "xyz"]


def test_garbage_centre_of_pressure_without_force_is_harmless(tmp_path: Path) -> None:
    """Where the force is zero, a centre of pressure of 331 m or NaN leaves only the free moment."""
    values = np.zeros((FRAMES, 9))
    values[:, 3], values[:6, 4] = 331.7, np.nan
    values[6:, 1], values[6:, 3], values[:, 7] = 700.0, 0.2, 0.5
    trial = read_trial(
        "a", save(tmp_path / "a.trc", trc_text(cloud())), save(tmp_path / "a.mot", mot_text(force_columns(), values))
    )
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench[:6, 0], np.tile([0, 0, 0, 0, 0, 0.5], (6, 1)), atol=1e-12)
    assert_allclose(trial.forces.wrench[6:, 0, 5], 0.5, atol=1e-12)


@pytest.mark.parametrize("force", [0.0, 15.0])
def test_no_centre_of_pressure_without_load_is_no_load(tmp_path: Path, force: float) -> None:
    """NaN or 331 m of centre of pressure, and NaN of free moment, under less than 20 N are no load, and said."""
    values = standing()
    values[2:5, :3] = [0.0, force, 0.0]
    values[2:5, 3:] = np.nan
    values[6] = [0.0, 15.0, 0.0, 331.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    trial = pair(tmp_path, values)
    values[[2, 3, 4, 6]] = 0.0
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench[:, 0], wrench_of(values), atol=1e-6)
    (said,) = [note.message for note in trial.notes if note.code == "mot.no_load"]
    assert "4 rows" in said and "lines 8 to 10, 12" in said


@pytest.mark.parametrize("column", range(9))
def test_missing_values_under_load_are_gaps(tmp_path: Path, column: int) -> None:
    """A NaN in any column under load leaves a gap of that row, which is said with line and column."""
    values = standing()
    values[4, column] = np.nan
    trial = pair(tmp_path, values)
    assert trial.forces is not None
    assert_array_equal(np.flatnonzero(trial.forces.wrench.isnan().any(-1)), [4])
    (said,) = [note.message for note in trial.notes if note.code == "mot.gaps"]
    assert "line 10" in said and force_columns()[column] in said


@pytest.mark.parametrize(
    ("cell", "value"),
    [((4, 3), 50.0), ((4, 5), 1e5), ((4, 4), -0.6), ((4, 1), 20e3), ((4, 1), -700.0), ((4, 0), -2e4), ((4, 7), 80.0)],
)
def test_one_absurd_cell_of_forces_is_a_gap(tmp_path: Path, cell: tuple[int, int], value: float) -> None:
    """A centre of pressure metres away, 20 kN, a pull, a free moment of 80 N m: the row is a gap, the cell named."""
    values = standing()
    values[cell] = value
    trial = pair(tmp_path, values)
    assert trial.forces is not None
    assert_array_equal(np.flatnonzero(trial.forces.wrench.isnan().any(-1)), [4])
    (said,) = [note.message for note in trial.notes if note.code == "mot.spikes"]
    assert f"line 10, column {force_columns()[cell[1]]} is {value:g}" in said


@pytest.mark.parametrize(
    ("change", "code", "place"),
    [
        (lambda v: v.__setitem__((slice(0, 8), 1), np.nan), "mot.nan", "line 6, column ground_force_1_vy"),
        (lambda v: v.__setitem__((slice(None), 3), 300.0), "mot.cop_units", "ground_force_1"),
        (lambda v: v.__setitem__((slice(3, 7), 3), 30.0), "mot.cop_units", "ground_force_1"),
        (lambda v: v.__imul__([1e3] * 3 + [1.0] * 6), "mot.force_units", "column ground_force_1_vy"),
    ],
)
def test_forces_that_cannot_be_are_refused(tmp_path: Path, change, code: str, place: str) -> None:
    """NaN in most rows, centres of pressure in mm or far off in many, and forces above 20 kN are refused."""
    values = standing()
    change(values)
    with pytest.raises(InputError) as caught:
        pair(tmp_path, values)
    assert caught.value.code == code and place in caught.value.place


def test_forces_that_leap_throughout_are_left_and_said(tmp_path: Path) -> None:
    """Free moments of hundreds of N m to and fro are no single spikes: nothing is taken out, the columns are named."""
    values = standing()
    values[:, 7] = 300.0 * (-1.0) ** np.arange(FRAMES)
    trial = pair(tmp_path, values)
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench[:, 0], wrench_of(values), atol=1e-6)
    (said,) = [note for note in trial.notes if note.code == "mot.leaping"]
    assert "ground_force_1_my" in said.message and said.source.endswith("a.mot")


def test_too_few_forces_for_a_clock_are_refused(tmp_path: Path) -> None:
    """No row is refused where it is read, one where it would have to be put on the clock of the markers."""
    with pytest.raises(InputError, match=r"a\.mot.*mot\.empty"):
        pair(tmp_path, standing()[:0])
    with pytest.raises(InputError, match=r"a\.mot, trial .*found: 1\).*forces\.short"):
        synchronise(pair(tmp_path, standing()[:1]))


def test_a_change_of_a_plate_that_needs_corners_is_refused_without(tmp_path: Path) -> None:
    """A MOT has no corners in which a plate could be turned or an axis reversed; its gain needs none."""
    pair(tmp_path, standing())
    turned = (PlateAs(turn_deg=180), PlateAs(corners=(2, 1, 4, 3)), PlateAs(corner_unit="m"))
    for change in (PlateAs(mirror="x"), PlateAs(exchange=("fx", "fy")), PlateAs(reads=1), *turned):
        with pytest.raises(InputError, match=r"plates\.corners") as caught:
            read_trial("a", tmp_path / "a.trc", tmp_path / "a.mot", options=ReadOptions(plates={1: change}))
        assert caught.value.place == "ground_force_1" and "forces_as" in caught.value.remedy
        assert caught.value.source == str(tmp_path / "a.mot")
    read_trial("a", tmp_path / "a.trc", tmp_path / "a.mot", options=ReadOptions(plates={1: PlateAs(gain=1.1)}))


def test_missing_rows_of_forces_are_gaps(tmp_path: Path) -> None:
    """Rows taken out of a MOT leave NaN at their times."""
    lines = mot_text(force_columns(), standing()).split("\n")
    mot = save(tmp_path / "a.mot", "\n".join(lines[:9] + lines[11:]))
    trial = read_trial("a", save(tmp_path / "a.trc", trc_text(cloud())), mot)
    assert trial.forces is not None and "time.gaps" in codes(trial.notes)
    assert_array_equal(np.flatnonzero(trial.forces.wrench.isnan().any(-1)), [4, 5])
    assert_allclose(trial.forces.time, trial.markers.time, atol=1e-9)


def test_times_in_ms_are_refused_or_read_by_the_rate(tmp_path: Path) -> None:
    """A MOT in ms is refused, by its rate or beside its markers; a TRC whose DataRate proves ms is read so."""

    def in_ms(text: str, column: int) -> str:
        rows = [line.split("\t") for line in text.split("\n")]
        for row in rows:
            if len(row) > 5 and row[0].replace(".", "").isdigit():
                row[column] = f"{float(row[column]) * 1000:.6f}"
        return "\n".join("\t".join(row) for row in rows)

    trc = save(tmp_path / "a.trc", trc_text(cloud()))
    for rate in (100.0, 10000.0):
        values = np.tile(standing(), (int(rate / 100), 1))
        mot = save(tmp_path / "a.mot", in_ms(mot_text(force_columns(), values, rate), 0))
        with pytest.raises(InputError, match=r"1000.*time\.unit") as caught:
            read_trial("a", trc, mot)
        assert caught.value.source == str(mot)
    slow = read_trc(save(tmp_path / "b.trc", in_ms(trc_text(cloud()), 1)))
    assert_allclose(slow.time, np.arange(FRAMES) / 100.0)
    assert "time.ms" in codes(slow.notes)


def test_unmatched_columns_are_listed(tmp_path: Path) -> None:
    """A MOT of joint angles given as forces is refused with its column names."""
    mot = save(tmp_path / "a.mot", mot_text(["pelvis_tilt", "knee_angle_r"], np.zeros((FRAMES, 2))))
    with pytest.raises(InputError, match="pelvis_tilt") as caught:
        read_trial("a", save(tmp_path / "a.trc", trc_text(cloud())), mot)
    assert caught.value.code == "mot.columns"


def test_ground_reaction_decides_the_vertical_axis(tmp_path: Path) -> None:
    """Force along Y or Z says which axis is up; an override against it is refused."""
    trc = save(tmp_path / "a.trc", trc_text(cloud()))
    for axis, column in (("y", 1), ("z", 2)):
        values = np.zeros((FRAMES, 9))
        values[:, column] = 700.0
        mot = save(tmp_path / "a.mot", mot_text(force_columns(), values))
        trial = read_trial("a", trc, mot)
        assert trial.parameters["up"] == axis and trial.forces is not None
        assert_allclose(trial.forces.wrench[:, 0, 2], 700.0)
        other = "z" if axis == "y" else "y"
        with pytest.raises(InputError, match=r"axes\.contradiction"):
            read_trial("a", trc, mot, options=ReadOptions(up=other))


def test_clocks_without_overlap_are_refused_and_partial_overlap_said(tmp_path: Path) -> None:
    """Forces of another time are refused; forces of a part of the trial are kept and said."""
    trc = save(tmp_path / "a.trc", trc_text(cloud()))
    values = np.zeros((FRAMES, 9))
    values[:, 1] = 700.0
    text = mot_text(force_columns(), values)
    lines = text.split("\n")
    part = "\n".join(lines[:5] + lines[9:])
    assert "trial.overlap" in codes(read_trial("a", trc, save(tmp_path / "a.mot", part)).notes)
    moved = "\n".join(line.replace("0.", "9.", 1) if line[:2] == "0." else line for line in lines)
    with pytest.raises(InputError, match=r"trial\.no_overlap"):
        read_trial("a", trc, save(tmp_path / "b.mot", moved))


def test_a_role_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    """The three that exist are named."""
    with pytest.raises(
        InputError, match=r"trial a: .*found: calibration\)\. Use one of static, fit, heldout \[trial\.role\]"
    ):
        read_trial("a", tmp_path / "a.trc", role="calibration")


@pytest.mark.parametrize(
    ("name", "forces", "found"), [("a.csv", None, ".csv"), ("a", None, "no suffix"), ("a.c3d", "b.txt", ".txt")]
)
def test_unknown_combinations_are_refused(tmp_path: Path, name: str, forces: str | None, found: str) -> None:
    """Formats that carry no markers, or no forces, are refused with a remedy."""
    with pytest.raises(InputError) as caught:
        read_trial("a", tmp_path / name, forces)
    assert (caught.value.code, caught.value.found) == ("trial.format", found)
    assert ("markers" in caught.value.remedy) == (forces is None) and caught.value.remedy
    assert caught.value.source == (forces or str(tmp_path / name))


@pytest.mark.parametrize("suffix", [".trc", ".mot"])
def test_mutated_text_gives_a_trial_or_a_typed_error(tmp_path: Path, suffix: str) -> None:
    """150 random damages to a TRC or a MOT never raise anything but a TorchidError."""
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    random = np.random.default_rng(seed)
    values = np.zeros((FRAMES, 9))
    values[:, 1] = 700.0
    texts = {".trc": trc_text(cloud()), ".mot": mot_text(force_columns(), values)}
    for case in range(150):
        for name, text in texts.items():
            data = np.frombuffer(text.encode(), np.uint8).copy()
            for _ in range(random.integers(1, 5) if name == suffix else 0):
                at = int(random.integers(0, len(data)))
                length = len(data[at : at + int(random.choice([1, 2, 30]))])
                data[at : at + length] = random.choice(np.frombuffer(b"0123456789.-e\t\n x,\xff\x00", np.uint8), length)
            (tmp_path / f"a{name}").write_bytes(data.tobytes())
        try:
            read_trial("a", tmp_path / "a.trc", tmp_path / "a.mot")
        except TorchidError as error:
            assert error.code
        except Exception as error:
            raise AssertionError(f"seed {seed} case {case}") from error
