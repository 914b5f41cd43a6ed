"""Tests of torchid.io.c3d, c3d_header, c3d_layout and c3d_data on files built byte by byte."""

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from c3d_bytes import BLOCK, DEC, INTEL, MIPS, C3dBuilder, labels, standing
from numpy.testing import assert_allclose, assert_array_equal

from torchid.errors import InputError, TorchidError
from torchid.io.c3d import read_c3d
from torchid.io.mend import ForcesAs, PlateAs
from torchid.io.options import ReadOptions

FRAMES = 20


def plate_parameters(channels: int = 6) -> dict:
    """One type 2 plate of 0.6 by 0.4 m at the origin."""
    corners = np.array([[600.0, 0, 0], [0, 0, 0], [0, 400, 0], [600, 400, 0]]).T[:, :, None]
    return {
        "USED": np.array([1]),
        "TYPE": np.array([2]),
        "CHANNEL": np.arange(1, channels + 1)[:, None],
        "CORNERS": corners,
        "ORIGIN": np.array([[0.0], [0.0], [-40.0]]),
    }


def small(**changes) -> C3dBuilder:
    """A file with eight markers, one plate and two analog samples per frame."""
    analogs = np.tile([0.0, 0.0, -700.0, 0.0, 0.0, 0.0], (2 * FRAMES, 1)) + np.arange(2 * FRAMES)[:, None]
    settings = {
        "points": standing(FRAMES),
        "labels": labels(8),
        "analogs": analogs,
        "ratio": 2,
        "parameters": {"FORCE_PLATFORM": plate_parameters(), "ANALOG": {"UNITS": ["N"] * 3 + ["Nmm"] * 3}},
    }
    return C3dBuilder(**(settings | changes))


def with_parameters(**groups) -> C3dBuilder:
    """The small file with changed parameters."""
    built = small()
    for group, entries in groups.items():
        built.parameters.setdefault(group, {}).update(entries)
    return built


def codes(trial) -> set[str]:
    return {note.code for note in trial.notes}


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
@pytest.mark.parametrize("scale", [-1.0, 0.1])
def test_six_encodings_hold_the_same_numbers(tmp_path: Path, processor: int, scale: float) -> None:
    """Intel, DEC and MIPS, integers and reals: points agree to half a quantum, wrenches and times exactly."""
    built = small(processor=processor, scale=scale)
    built.points[3:6, 2] = np.nan
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    reference = read_c3d(small().save(tmp_path / "b.c3d"))
    expected = built.points / 1000.0
    assert_array_equal(trial.markers.position.isnan(), np.isnan(expected))
    tolerance = 0.05e-3 + 1e-7 if scale > 0 else 1e-7
    assert_allclose(trial.markers.position, expected, atol=tolerance, rtol=0)
    assert trial.forces is not None and reference.forces is not None
    assert_allclose(trial.forces.wrench, reference.forces.wrench, atol=1e-9)
    assert_array_equal(trial.forces.time, reference.forces.time)


def test_integer_analogs_follow_offset_and_format(tmp_path: Path) -> None:
    """Stored integers become (stored - OFFSET) SCALE GEN_SCALE, for signed and for unsigned storage."""
    force = -700.0
    for form, offset in (("SIGNED", 100), ("UNSIGNED", 40000)):
        stored = np.full((2 * FRAMES, 6), offset)
        stored[:, 2] += int(force / -0.25 / 2.0)
        analog = {
            "SCALE": np.full(6, -0.25), "OFFSET": np.full(6, offset), "GEN_SCALE": np.array([2.0]), "FORMAT": [form],
            "UNITS": ["N"] * 3 + ["Nmm"] * 3,
        }  # fmt: skip
        built = small(scale=0.1, analogs=stored)
        built.parameters["ANALOG"] = analog
        trial = read_c3d(built.save(tmp_path / "a.c3d"))
        assert trial.forces is not None
        assert_allclose(trial.forces.wrench[:, 0, 2], -force, rtol=1e-6)


@pytest.mark.parametrize("rate", [59.94, 119.88, 100.0, 239.76, 1000.0 / 3.0])
@pytest.mark.parametrize("ratio", [1, 3, 10, 17])
def test_rates_times_ratio_keep_every_frame_aligned(tmp_path: Path, rate: float, ratio: int) -> None:
    """Whatever the camera rate, analog samples and points of the last frame are where they belong."""
    analogs = np.arange(FRAMES * ratio)[:, None] * np.ones(6)
    trial = read_c3d(small(rate=rate, ratio=ratio, analogs=analogs).save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_allclose(trial.markers.position, standing(FRAMES) / 1000.0, atol=1e-6)
    assert_allclose(trial.forces.wrench[:, 0, 2], -np.arange(FRAMES * ratio), atol=1e-9)
    assert_allclose(trial.forces.time[::ratio], trial.markers.time, atol=1e-12)


def test_missing_in_all_disguises_is_nan(tmp_path: Path) -> None:
    """A negative residual, exact zeros, NaN and codes all become NaN, the latter with a note."""
    built = small()
    built.points[2, 0] = np.nan
    built.points[3, 1] = 0.0
    built.points[4, 2] = 9999999.0
    built.points[5, 3] = -16512.0
    built.points[:, 6] = np.nan
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    position, never = trial.markers.position[:, :6], trial.markers.position[:, 6]
    missing = np.argwhere(position.isnan().any(dim=-1).numpy())
    assert_array_equal(missing, [[2, 0], [3, 1], [4, 2], [5, 3]])
    assert {"markers.zeros", "markers.codes"} <= codes(trial) and never.isnan().all()
    assert [note.message[:2] for note in trial.notes if note.code == "markers.never_seen"] == ["1 "]


def test_first_frame_and_events_share_a_clock(tmp_path: Path) -> None:
    """Time starts at (first - 1) / rate, and events count on the same clock, or are shifted to it and said."""
    event = {"USED": np.array([1]), "LABELS": ["Foot Strike"], "CONTEXTS": ["Left"], "TIMES": np.array([[0.0], [2.55]])}
    built = small(first_frame=251)
    built.parameters["EVENT"] = event
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert_allclose(trial.markers.time[0], 2.5)
    assert trial.forces is not None
    assert_allclose(trial.forces.time[0], 2.5)
    assert trial.events[0].side == "Left" and trial.events[0].label == "Foot Strike"
    assert_allclose(trial.events[0].time, 2.55, atol=1e-6)
    built.parameters["EVENT"]["TIMES"] = np.array([[0.0], [0.05]])
    shifted = read_c3d(built.save(tmp_path / "b.c3d"))
    assert_allclose(shifted.events[0].time, 2.55, atol=1e-6)
    assert "events.shifted" in codes(shifted)


def test_labels_beyond_255_continue(tmp_path: Path) -> None:
    """LABELS2 carries on where LABELS ends."""
    names = labels(300)
    built = small(points=standing(4, 300), labels=names[:255], analogs=np.zeros((0, 0)), ratio=0)
    built.parameters = {"POINT": {"LABELS2": names[255:], "USED": np.array([300])}}
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.markers.labels == tuple(names)


def test_more_frames_than_a_word_holds(tmp_path: Path) -> None:
    """Beyond 65535 frames TRIAL:ACTUAL_END_FIELD counts, and without it the file's size."""
    frames = 65600
    moving = standing(1, 3) + np.arange(frames)[:, None, None] % 100
    built = C3dBuilder(points=moving, labels=labels(3), scale=0.1)
    start, end = np.array([1, 0]), np.array([frames % 65536, frames // 65536])
    built.parameters = {"TRIAL": {"ACTUAL_START_FIELD": start, "ACTUAL_END_FIELD": end}}
    assert len(read_c3d(built.save(tmp_path / "a.c3d"), options=ReadOptions(up="z")).markers.time) == frames
    built.parameters = {}
    assert (
        abs(len(read_c3d(built.save(tmp_path / "b.c3d"), options=ReadOptions(up="z")).markers.time) - frames)
        <= BLOCK // 24
    )


def test_every_cut_point_is_noticed(tmp_path: Path) -> None:
    """Wherever a file is cut, it is refused, or at most its last frame is missing and that is said."""
    data = small().build()
    path = tmp_path / "a.c3d"
    for size in range(0, len(data), 61):
        path.write_bytes(data[:size])
        try:
            trial = read_c3d(path)
        except InputError as error:
            assert error.code in ("c3d.signature", "c3d.truncated"), size
            continue
        complete = len(trial.markers.time) == FRAMES
        assert complete or (len(trial.markers.time) == FRAMES - 1 and "c3d.truncated" in codes(trial)), size


def test_truncated_data_is_read_when_asked(tmp_path: Path) -> None:
    """allow_truncated reads what is there and says how much was declared."""
    data = small().build()
    path = tmp_path / "a.c3d"
    path.write_bytes(data[: len(data) - 2 * BLOCK])
    with pytest.raises(InputError, match=r"20 frames declared.*c3d\.truncated"):
        read_c3d(path)
    trial = read_c3d(path, options=ReadOptions(allow_truncated=True))
    assert 0 < len(trial.markers.time) < FRAMES
    assert "c3d.truncated" in codes(trial)
    assert_allclose(trial.markers.position, standing(FRAMES)[: len(trial.markers.time)] / 1000.0, atol=1e-6)


@pytest.mark.parametrize("content", [b"", b"\2P", b"<html>" * 400, b"\0" * 4096, b"\2P" + b"\0" * 4000])
def test_what_is_no_c3d_is_refused(tmp_path: Path, content: bytes) -> None:
    """Empty, short, HTML and zero files are refused with a typed error."""
    path = tmp_path / "a.c3d"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_c3d(path)
    assert caught.value.code in ("c3d.signature", "c3d.processor")
    assert caught.value.remedy


def test_absent_file_is_an_input_error(tmp_path: Path) -> None:
    """A path that leads nowhere is the user's error, not a traceback."""
    with pytest.raises(InputError, match=r"file\.unreadable"):
        read_c3d(tmp_path / "none.c3d")


def test_leading_zeros_and_trailing_bytes_are_said(tmp_path: Path) -> None:
    """Zero bytes before the header are skipped, blocks after the data left alone, both with a note."""
    path = tmp_path / "a.c3d"
    path.write_bytes(b"\0" * 300 + small().build() + b"\7" * 3 * BLOCK)
    trial = read_c3d(path)
    assert {"c3d.leading_zeros", "c3d.trailing"} <= codes(trial)
    assert_allclose(trial.markers.position, standing(FRAMES) / 1000.0, atol=1e-6)


@pytest.mark.parametrize("name", ["USED", "RATE", "SCALE", "FRAMES", "DATA_START"])
def test_a_missing_point_parameter_is_taken_from_the_header(tmp_path: Path, name: str) -> None:
    """Without POINT:USED, RATE, SCALE, FRAMES or DATA_START the header's word serves."""
    trial = read_c3d(with_parameters(POINT={name: None}).save(tmp_path / "a.c3d"))
    assert_allclose(trial.markers.position, standing(FRAMES) / 1000.0, atol=1e-6)
    if name in ("USED", "RATE", "SCALE"):
        assert "c3d.parameter_missing" in codes(trial)


@pytest.mark.parametrize("scale", [0.0, np.nan, 1e30])
def test_an_impossible_scale_is_refused(tmp_path: Path, scale: float) -> None:
    """A scale of zero, NaN or beyond reason cannot tell integers from reals."""
    with pytest.raises(InputError, match=r"c3d\.scale"):
        read_c3d(with_parameters(POINT={"SCALE": np.array([scale])}).save(tmp_path / "a.c3d"))


def test_analog_rate_missing_or_contradicting(tmp_path: Path) -> None:
    """The header's ratio stands for a missing ANALOG:RATE; one that is off by more than 2 % is refused."""
    trial = read_c3d(with_parameters(ANALOG={"RATE": None}).save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_allclose(trial.forces.rate, 200.0)
    assert "c3d.parameter_missing" in codes(trial)
    with pytest.raises(InputError, match=r"c3d\.analog_rate"):
        read_c3d(with_parameters(ANALOG={"RATE": np.array([250.0])}).save(tmp_path / "a.c3d"))


def test_rotations_are_refused_by_name(tmp_path: Path) -> None:
    """Rotation data are not markers."""
    with pytest.raises(InputError, match=r"ROTATION:USED.*3 rotations.*c3d\.rotations"):
        read_c3d(with_parameters(ROTATION={"USED": np.array([3])}).save(tmp_path / "a.c3d"))


@pytest.mark.parametrize(("rate", "found"), [(0.0, "0"), (-100.0, "-100"), (np.nan, "nan"), (1e7, "1e+07")])
def test_a_rate_that_neither_header_nor_parameter_knows_is_refused(tmp_path: Path, rate: float, found: str) -> None:
    """Without a possible camera rate in either place nothing can be differentiated."""
    with pytest.raises(InputError, match=r"c3d\.rate") as caught:
        read_c3d(small(rate=rate).save(tmp_path / "a.c3d"))
    assert (caught.value.place, caught.value.found) == ("POINT:RATE", f"{found}, in the header {found}")
    assert caught.value.remedy


@pytest.mark.parametrize(("block", "start"), [(0, None), (1, None), (0, 1), (1, 1)])
def test_data_that_begin_nowhere_are_refused(tmp_path: Path, block: int, start: int | None) -> None:
    """Where neither POINT:DATA_START nor word 9 of the header names a block behind it, the data cannot be found."""
    value = None if start is None else np.array([start])
    data = bytearray(with_parameters(POINT={"DATA_START": value}).build())
    data[16:18] = struct.pack("<H", block)
    path = tmp_path / "a.c3d"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"c3d\.data_start") as caught:
        read_c3d(path)
    assert caught.value.place == "header word 9 and POINT:DATA_START" and caught.value.remedy
    assert caught.value.found == f"{block} and {'absent' if start is None else start}"


def test_frames_that_count_from_zero_begin_at_zero_seconds(tmp_path: Path) -> None:
    """Time does not start one frame before the recording, and that is said."""
    trial = read_c3d(small(first_frame=0).save(tmp_path / "a.c3d"))
    assert_allclose(trial.markers.time, np.arange(FRAMES) / 100.0)
    assert "c3d.first_frame" in codes(trial)


def test_a_sample_of_a_plate_that_is_no_number_is_a_gap(tmp_path: Path) -> None:
    """Its wrench is NaN, the others stay, and it is said how many there are."""
    built = small()
    built.analogs[5, 2] = np.nan
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_array_equal(np.flatnonzero(trial.forces.wrench.isnan().any(dim=-1)), [5])
    assert [note.message[:2] for note in trial.notes if note.code == "plates.invalid"] == ["1 "]


def test_a_plate_is_read_as_asked_or_named_where_it_is_not_there(tmp_path: Path) -> None:
    """What the user says of forces and plates is repeated; a number that no plate has is refused with those known."""
    path = small().save(tmp_path / "a.c3d")
    asked = ReadOptions(forces_as=ForcesAs(turn_deg=90), plates={1: PlateAs(gain=2.0)})
    said = {note.code: note.message for note in read_c3d(path, options=asked).notes}
    assert "{turn_deg: 90}" in said["forces.as_asked"] and "plate 1" in said["plates.as_asked"]
    for plates in ({3: PlateAs(gain=2.0)}, {1: PlateAs(reads=3)}):
        with pytest.raises(InputError, match=r"plates\.number") as caught:
            read_c3d(path, options=ReadOptions(plates=plates))
        assert caught.value.found == "3" and caught.value.remedy == "Known: 1"


def test_markers_only_and_plates_only_files_are_readable(tmp_path: Path) -> None:
    """A file without analogs has no forces, one without points has no markers; neither is an error."""
    markers = read_c3d(small(analogs=np.zeros((0, 0)), ratio=0, parameters={}).save(tmp_path / "a.c3d"))
    assert markers.forces is None and "plates.none" in codes(markers)
    plates = read_c3d(small(points=np.zeros((FRAMES, 0, 3)), labels=[]).save(tmp_path / "b.c3d"))
    assert plates.markers.position.shape == (FRAMES, 0, 3)
    assert plates.forces is not None
    empty = read_c3d(small(points=np.zeros((0, 8, 3)), analogs=np.zeros((0, 0)), ratio=0).save(tmp_path / "c.c3d"))
    assert empty.markers.position.shape == (0, 8, 3)


def test_a_lying_dimension_does_not_allocate(tmp_path: Path) -> None:
    """A parameter that claims 255^7 values is ignored and said; nothing of that size is reserved."""
    built = with_parameters(TRIAL={"LIE": np.array([1])})
    data = built.build()
    at = data.index(b"LIE") + 5
    lie = data[:at] + struct.pack("bB", 4, 7) + b"\xff" * 7 + data[at + 9 :]
    path = tmp_path / "a.c3d"
    path.write_bytes(lie)
    assert "c3d.parameters" in codes(read_c3d(path))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, None),
        ({"CONTEXTS": None}, None),
        ({"LABELS": None}, "events.count"),
        ({"TIMES": np.array([[0.0], [0.05]])}, "events.count"),
        ({"USED": np.array([3])}, "events.count"),
        ({"TIMES": np.array([[0.0, 0.0], [0.05, np.nan]])}, "events.invalid"),
        ({"TIMES": np.array([[0.0, 0.0], [0.05, 9.0]])}, "events.outside"),
    ],
)
def test_events_that_are_miscounted_are_said(tmp_path: Path, change: dict, said: str | None) -> None:
    """Labels, times and number of two events agree and lie in the trial, or it is said; contexts may be absent."""
    event = {"USED": np.array([2]), "LABELS": ["Foot Strike", "Foot Off"], "CONTEXTS": ["Left", "Right"],
             "TIMES": np.array([[0.0, 0.0], [0.05, 0.1]])}  # fmt: skip
    found = codes(read_c3d(with_parameters(EVENT=event | change).save(tmp_path / "a.c3d")))
    assert {code for code in found if code.startswith("events.")} == ({said} if said else set())


def test_parameters_that_stand_twice_are_said(tmp_path: Path) -> None:
    """A record that occurs again with another value is named; the same value again says nothing new."""
    plain = small().build()
    at, stop = plain.index(b"\4\1RATE"), BLOCK + plain[BLOCK + 2] * BLOCK
    end = at + 6 + struct.unpack("<H", plain[at + 6 : at + 8])[0]
    path = tmp_path / "a.c3d"
    for rate, expected in ((100.0, False), (50.0, True)):
        again = plain[at : end - 5] + struct.pack("<f", rate) + b"\0"
        section = plain[:at] + again + plain[at:stop]
        assert not section[stop:].strip(b"\0")
        path.write_bytes(section[:stop] + plain[stop:])
        told = [note for note in read_c3d(path).notes if note.code == "c3d.parameters"]
        assert bool(told) == expected and all("POINT:RATE" in note.message for note in told)


def test_subject_and_mass_are_stated(tmp_path: Path) -> None:
    """What the file says about the subject reaches the trial's parameters in SI units."""
    extra = {"PROCESSING": {"Bodymass": np.array([70.5]), "Height": np.array([1750.0])}, "SUBJECTS": {"NAMES": ["S 1"]}}
    facts = read_c3d(with_parameters(**extra).save(tmp_path / "a.c3d")).parameters
    assert (facts["mass_kg"], facts["height_m"], facts["subject"], facts["up"]) == ("70.5", "1.75", "S 1", "z")


def test_mutated_bytes_give_a_trial_or_a_typed_error(tmp_path: Path) -> None:
    """250 random damages (bits, runs, cuts, insertions) never crash, hang or raise anything but a TorchidError."""
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    random = np.random.default_rng(seed)
    original = np.frombuffer(small(scale=0.1, processor=DEC).build(), np.uint8)
    path = tmp_path / "a.c3d"
    for case in range(250):
        data = original.copy()
        end = len(data) if case % 5 == 0 else 3 * BLOCK
        for _ in range(random.integers(1, 6)):
            at = int(random.integers(0, end))
            length = int(random.choice([1, 1, 2, 4, 40]))
            data[at : at + length] = random.integers(0, 256, len(data[at : at + length]))
        if case % 7 == 0:
            data = data[: random.integers(0, len(data))]
        path.write_bytes(data.tobytes())
        begin = time.monotonic()
        try:
            read_c3d(path)
        except TorchidError as error:
            assert error.code
        except Exception as error:
            raise AssertionError(f"seed {seed} case {case}") from error
        assert time.monotonic() - begin < 1.0, f"seed {seed} case {case}"
