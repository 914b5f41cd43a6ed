"""Tests of torchid.io.c3d_witnesses: files whose header, parameters, labels and size contradict each other."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from c3d_bytes import BLOCK, DEC, INTEL, MIPS, C3dBuilder, labels, standing
from numpy.testing import assert_allclose, assert_array_equal

from torchid.errors import InputError
from torchid.io.c3d import read_c3d
from torchid.io.options import ReadOptions

FRAMES, MARKERS, CHANNELS, RATIO = 60, 9, 6, 4


def sound(**changes) -> C3dBuilder:
    """Nine markers, six channels and four analog samples per frame, counted from frame 5; no two layouts fit alike."""
    plate = {
        "USED": np.array([1]), "TYPE": np.array([2]), "CHANNEL": np.arange(1, 7)[:, None],
        "CORNERS": np.array([[600.0, 0, 0], [0, 0, 0], [0, 400, 0], [600, 400, 0]]).T[:, :, None],
        "ORIGIN": np.array([[0.0], [0.0], [-40.0]]),
    }  # fmt: skip
    analogs = np.tile([0.0, 0.0, -700.0, 0.0, 0.0, 0.0], (RATIO * FRAMES, 1)) + np.arange(RATIO * FRAMES)[:, None]
    trial = {"ACTUAL_START_FIELD": np.array([5, 0]), "ACTUAL_END_FIELD": np.array([FRAMES + 4, 0])}
    groups = {"FORCE_PLATFORM": plate, "ANALOG": {"UNITS": ["N"] * 3 + ["Nmm"] * 3}, "TRIAL": trial}
    settings = {"points": standing(FRAMES, MARKERS), "labels": labels(MARKERS), "analogs": analogs, "ratio": RATIO}
    return C3dBuilder(**(settings | {"parameters": groups, "first_frame": 5} | changes))


def word(number: int, value: int) -> Callable[[C3dBuilder, bytearray], None]:
    """Overwrite a word of the header; the first is 1."""

    def lie(built: C3dBuilder, data: bytearray) -> None:
        data[2 * number - 2 : 2 * number] = built.ints([value])

    return lie


def parameter(name: str, value: float, at: int = 0) -> Callable[[C3dBuilder, bytearray], None]:
    """Overwrite a number of a parameter, whose name must not occur twice in the file."""

    def lie(built: C3dBuilder, data: bytearray) -> None:
        group, name_only = name.split(":")
        begin = data.index(name_only.encode(), data.index(group.encode()))
        begin += len(name_only) + 2
        kind, count = struct.unpack("bB", data[begin : begin + 2])
        raw = built.floats([value]) if kind == 4 else built.ints([value])
        begin += 2 + count + at * len(raw)
        data[begin : begin + len(raw)] = raw

    return lie


def scale(built: C3dBuilder, data: bytearray) -> None:
    """Turn over the sign of the scale in the header."""
    data[12:16] = built.floats([-built.scale])


def scales(built: C3dBuilder, data: bytearray) -> None:
    """Turn over the sign of the scale wherever it is stated."""
    scale(built, data)
    parameter("POINT:SCALE", -built.scale)(built, data)


def blocks(built: C3dBuilder, data: bytearray) -> None:
    """The parameter section says that it has one block."""
    data[BLOCK + 2] = 1


def check_reads_alike(path: Path, built: C3dBuilder, lie: Callable[[C3dBuilder, bytearray], None], liar: str) -> None:
    """With the lie the file reads as without, and the liar is named in a note."""
    data = bytearray(built.build())
    path.write_bytes(data)
    right = read_c3d(path)
    assert not [note for note in right.notes if note.code.startswith("c3d.")]
    lie(built, data)
    path.write_bytes(data)
    found = read_c3d(path)
    assert_array_equal(found.markers.position, right.markers.position)
    assert_array_equal(found.markers.time, right.markers.time)
    assert found.forces is not None and right.forces is not None
    assert_array_equal(found.forces.wrench, right.forces.wrench)
    assert_array_equal(found.forces.time, right.forces.time)
    said = [note.message for note in found.notes if note.code.startswith("c3d.")]
    assert any(liar in text for text in said), said


LIES = [
    (parameter("POINT:USED", MARKERS - 1), "POINT:USED"),
    (parameter("POINT:USED", MARKERS + 1), "POINT:USED"),
    (word(2, MARKERS - 1), "header word 2"),
    (word(2, 3 * MARKERS), "header word 2"),
    (word(3, CHANNELS), "header word 3"),
    (word(3, CHANNELS * RATIO + 1), "header word 3"),
    (word(3, 0), "header word 3"),
    (word(10, RATIO - 1), "header word 10"),
    (word(10, RATIO * 2), "header word 10"),
    (parameter("ANALOG:USED", CHANNELS + 10), "ANALOG:USED"),
    (parameter("ANALOG:USED", 0), "ANALOG:USED"),
    (parameter("ANALOG:RATE", 700.0), "ANALOG:RATE"),
    (parameter("POINT:RATE", 50.0), "POINT:RATE"),
    (word(9, 2), "header word 9"),
    (parameter("POINT:DATA_START", 3), "POINT:DATA_START"),
    (scale, "the scale in the header"),
    (scales, "POINT:SCALE"),
    (word(5, FRAMES + 40), "frames"),
    (word(4, 1), "header word 4"),
    (parameter("POINT:FRAMES", FRAMES + 40), "frames"),
    (parameter("TRIAL:ACTUAL_START_FIELD", 1), "TRIAL:ACTUAL_START_FIELD"),
    (parameter("TRIAL:ACTUAL_END_FIELD", FRAMES), "frames"),
    (blocks, "beyond it"),
]


@pytest.mark.parametrize("storage", [-0.1, 0.1], ids=["reals", "integers"])
@pytest.mark.parametrize(("lie", "liar"), LIES, ids=[f"{k}-{liar}" for k, (_, liar) in enumerate(LIES)])
def test_one_lie_is_outvoted_and_named(tmp_path: Path, lie: Callable, liar: str, storage: float) -> None:
    """One wrong number in header or parameters changes nothing that is read, and a note says which it was."""
    check_reads_alike(tmp_path / "a.c3d", sound(scale=storage), lie, liar)


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
@pytest.mark.parametrize("storage", [-0.1, 0.1], ids=["reals", "integers"])
def test_size_and_numbers_tell_reals_from_integers(tmp_path: Path, processor: int, storage: float) -> None:
    """Where every stated scale has the wrong sign, the file's size and the stored numbers still tell reals apart."""
    check_reads_alike(tmp_path / "a.c3d", sound(scale=storage, processor=processor), scales, "POINT:SCALE")


def test_both_point_counts_wrong_but_not_labels_and_size(tmp_path: Path) -> None:
    """Labels and size together outvote a header and a parameter that leave points out."""

    def lie(built: C3dBuilder, data: bytearray) -> None:
        word(2, MARKERS - 2)(built, data)
        parameter("POINT:USED", MARKERS - 2)(built, data)

    check_reads_alike(tmp_path / "a.c3d", sound(), lie, "the number of POINT:LABELS")


def test_a_file_cut_in_half_is_not_taken_for_integers(tmp_path: Path) -> None:
    """Half of the data fit integers exactly; that the numbers are reals keeps the file truncated."""
    built = sound(analogs=np.zeros((0, 0)), ratio=0, parameters={}, points=standing(256, 8), labels=labels(8))
    data = built.build()
    size = 256 * 8 * 16
    path = tmp_path / "a.c3d"
    path.write_bytes(data[: len(data) - size // 2])
    with pytest.raises(InputError, match=r"c3d\.truncated"):
        read_c3d(path)
    assert len(read_c3d(path, options=ReadOptions(allow_truncated=True)).markers.time) == 128


def test_layouts_that_fit_alike_are_refused(tmp_path: Path) -> None:
    """Header against parameter, no labels, and less than a block of difference: both candidates are shown."""
    built = sound(points=standing(1, 9), labels=[], analogs=np.zeros((0, 0)), ratio=0, first_frame=1)
    built.parameters = {"POINT": {"LABELS": None, "USED": np.array([8])}}
    with pytest.raises(InputError, match=r"9 points.*; or 8 points.*c3d\.contradiction"):
        read_c3d(built.save(tmp_path / "a.c3d"))


@pytest.mark.parametrize("names", [None, labels(MARKERS)])
@pytest.mark.parametrize("size", [-3 * BLOCK, 3 * BLOCK])
def test_a_contradiction_that_the_size_does_not_settle_is_refused(
    tmp_path: Path, names: list[str] | None, size: int
) -> None:
    """In a file that was cut or goes on no layout fits: it is not called cut, which would advise to read it anyhow."""
    built = sound()
    built.parameters["POINT"] = {"LABELS": names, "USED": np.array([MARKERS - 1])}
    data = built.build()
    path = tmp_path / "a.c3d"
    path.write_bytes(data[:size] if size < 0 else data + b"\7" * size)
    with pytest.raises(InputError, match=r"none fits.*c3d\.contradiction"):
        read_c3d(path, options=ReadOptions(allow_truncated=True))


@pytest.mark.parametrize(("number", "value"), [(4, 65535), (4, 65533), (4, 3), (5, 2)])
def test_a_first_frame_that_its_last_contradicts(tmp_path: Path, number: int, value: int) -> None:
    """One end of the frames is wrong, the other that of a whole recording: time begins at 0, and a note says so."""
    built = sound(first_frame=1)
    del built.parameters["TRIAL"]
    data = bytearray(built.build())
    word(number, value)(built, data)
    path = tmp_path / "a.c3d"
    path.write_bytes(data)
    trial = read_c3d(path)
    assert len(trial.markers.time) == FRAMES and float(trial.markers.time[0]) == 0.0
    assert [note for note in trial.notes if note.code in ("c3d.header_disagrees", "c3d.frames")]


def test_two_scales_of_integers_are_refused(tmp_path: Path) -> None:
    """Nothing tells which quantum is right, so both are shown; reals need none."""
    for storage, refused in ((0.1, True), (-0.1, False)):
        built = sound(scale=storage)
        data = bytearray(built.build())
        data[12:16] = built.floats([2.0 * storage])
        path = tmp_path / "a.c3d"
        path.write_bytes(data)
        if refused:
            with pytest.raises(InputError, match=r"0\.1, in the header 0\.2.*c3d\.scale"):
                read_c3d(path)
        else:
            assert_allclose(read_c3d(path).markers.position, standing(FRAMES, MARKERS) / 1000.0, atol=1e-6)


@pytest.mark.parametrize("kind", ["put in", "lost", "whole block"])
def test_bytes_that_shift_the_data_are_said(tmp_path: Path, seed: int, kind: str) -> None:
    """Bytes put in or lost amid the data leave the file with other than whole blocks, or with one too many."""
    random = np.random.default_rng(seed)
    data = bytearray(sound().build())
    begin = len(data) - 4 * FRAMES * (4 * MARKERS + CHANNELS * RATIO)
    at = int(random.integers(begin // BLOCK * BLOCK, len(data) - 2 * BLOCK))
    if kind == "lost":
        padding = len(data) - begin - len(data[begin:].rstrip(b"\0"))
        del data[at : at + int(random.integers(1, max(2, min(60, padding))))]
    else:
        data[at:at] = random.integers(0, 256, BLOCK if kind == "whole block" else int(random.integers(1, 200))).tolist()
    path = tmp_path / "a.c3d"
    path.write_bytes(data)
    try:
        said = {note.code for note in read_c3d(path).notes}
    except InputError as error:
        said = {error.code}
    assert said & {"c3d.trailing", "c3d.truncated", "c3d.contradiction"}


def test_a_first_frame_without_a_last_is_heard(tmp_path: Path) -> None:
    """The header's first and last frame are moved together: what the file says elsewhere of the first says so."""
    built = sound()
    del built.parameters["TRIAL"]["ACTUAL_END_FIELD"]
    data = bytearray(built.build())
    path = tmp_path / "a.c3d"
    path.write_bytes(data)
    assert "c3d.header_disagrees" not in [note.code for note in read_c3d(path).notes]
    word(4, 8)(built, data)
    word(5, FRAMES + 7)(built, data)
    path.write_bytes(data)
    (note,) = [note for note in read_c3d(path).notes if note.code == "c3d.header_disagrees"]
    assert "TRIAL:ACTUAL_START_FIELD is 5; 8 is taken" in note.message
