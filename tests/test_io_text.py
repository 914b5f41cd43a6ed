"""Tests of torchid.io.table, storage, trc and grf: text files with everything that laboratories do to them."""

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from torchid.errors import InputError, TorchidError
from torchid.io import ReadOptions, read_trial
from torchid.io.storage import read_storage, write_storage
from torchid.io.trc import read_trc, write_trc
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
        (lambda lines: lines[:8] + [lines[9], lines[8]] + lines[10:], "time.order", "data row"),
        (lambda lines: lines[:9] + lines[12:], "time.irregular", "data row"),
        (lambda lines: ["hello"] + lines[1:], "trc.signature", "line 1"),
        (lambda lines: lines[:6], "trc.empty", ""),
        (lambda lines: [line.replace("MA", "ground_force_vx") for line in lines], "trc.forces", "label line"),
    ],
)
def test_broken_trc_is_refused_with_its_place(tmp_path: Path, change, code: str, place: str) -> None:
    """Each way to break a TRC gets its own code and says where."""
    path = save(tmp_path / "a.trc", "\n".join(change(trc_text(cloud()).rstrip("\n").split("\n"))))
    with pytest.raises(InputError) as caught:
        read_trc(path)
    assert caught.value.code == code
    assert place in caught.value.place


def test_an_incomplete_last_row_is_left_out_and_said(tmp_path: Path) -> None:
    """A file cut in its last row loses that row and nothing else."""
    trc = read_trc(save(tmp_path / "a.trc", trc_text(cloud())[:-40]))
    assert len(trc.time) == FRAMES - 1
    assert {"text.last_row", "trc.counts"} <= codes(trc.notes)


def test_units_from_header_data_or_user(tmp_path: Path) -> None:
    """mm, m and inches read the same; an absent unit is told from the cloud; a lying one is refused or overridden."""
    position = cloud()
    reference = read_trial("a", save(tmp_path / "a.trc", trc_text(position))).markers.position
    for units, factor in (("mm", 1e3), ("in", 1 / 0.0254), ("Meters", 1.0), ("", 1e3)):
        trial = read_trial("a", save(tmp_path / "b.trc", trc_text(position * factor, units)))
        assert_allclose(trial.markers.position, reference, atol=1e-6)
    lying = save(tmp_path / "c.trc", trc_text(position, "mm"))
    with pytest.raises(InputError, match=r"units\.implausible"):
        read_trial("a", lying)
    assert_allclose(read_trial("a", lying, options=ReadOptions(units="m")).markers.position, reference, atol=1e-7)


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


NAMES = [
    ("ground_force_{a}", "ground_torque_{t}"),
    ("1_ground_force_{a}", "1_ground_torque_{t}"),
    ("ground_force_1_{a}", "ground_force_1_m{t}"),
    ("R_ground_force_{a}", "R_ground_torque_{t}"),
    ("ground_force_calcn_r_{a}", "ground_torque_calcn_r_{t}"),
    ("ground_force_2_{a}", "ground_moment_2_m{t}"),
    ("FP1_{a}", "FP1_m{t}"),
]


@pytest.mark.parametrize(("force_name", "moment_name"), NAMES)
def test_column_names_of_all_styles(tmp_path: Path, force_name: str, moment_name: str) -> None:
    """Every style of names gives the wrench p x F + T about the origin, rotated to Z up."""
    random = np.random.default_rng(2)
    force = random.normal(size=(FRAMES, 3)) * 20 + [0, 700, 0]
    point, free = random.normal(size=(FRAMES, 3)) * 0.3, random.normal(size=(FRAMES, 3))
    columns = [force_name.format(a=w + a) for w in "vp" for a in "xyz"] + [moment_name.format(t=a) for a in "xyz"]
    mot = save(tmp_path / "a.mot", mot_text(columns, np.concatenate([force, point, free], axis=1)))
    trial = read_trial("a", save(tmp_path / "a.trc", trc_text(cloud())), mot)
    assert trial.forces is not None
    moment = np.cross(point, force) + free
    expected = np.stack([force[:, 0], -force[:, 2], force[:, 1], moment[:, 0], -moment[:, 2], moment[:, 1]], axis=1)
    assert_allclose(trial.forces.wrench[:, 0], expected, atol=1e-6)


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


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda v: v.__setitem__((3, 1), np.nan), "mot.nan"),
        (lambda v: v.__setitem__((slice(None), 3), 300.0), "mot.cop_units"),
    ],
)
def test_forces_that_cannot_be_are_refused(tmp_path: Path, change, code: str) -> None:
    """NaN under load and centres of pressure in mm are refused."""
    values = np.zeros((FRAMES, 9))
    values[:, 1] = 700.0
    change(values)
    mot = save(tmp_path / "a.mot", mot_text(force_columns(), values))
    with pytest.raises(InputError) as caught:
        read_trial("a", save(tmp_path / "a.trc", trc_text(cloud())), mot)
    assert caught.value.code == code


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


@pytest.mark.parametrize(("name", "forces"), [("a.csv", None), ("a.c3d", "b.txt")])
def test_unknown_combinations_are_refused(tmp_path: Path, name: str, forces: str | None) -> None:
    """Formats that carry no markers, or no forces, are refused with a remedy."""
    with pytest.raises(InputError) as caught:
        read_trial("a", tmp_path / name, forces)
    assert caught.value.remedy


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
