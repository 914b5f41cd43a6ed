"""Tests of torchid.io.plates: four types of plates show the same physics, and a bad plate falls alone."""

from pathlib import Path

import numpy as np
import pytest
from c3d_bytes import C3dBuilder, labels, standing
from numpy.testing import assert_allclose

from torchid.io.c3d import read_c3d
from torchid.io.mend import PlateAs
from torchid.io.options import ReadOptions
from torchid.io.plates import baseline, plate_frame

FRAMES, RATIO = 10, 4
SAMPLES = FRAMES * RATIO
ORIGIN = {
    1: [0.0, 0.0, 0.0],
    2: [3.0, -2.0, -40.0],
    3: [120.0, 200.0, -45.0],
    4: [-1.0, 2.0, -37.0],
    7: [110.0, 190.0, -45.0],
}


def corners(seed: int) -> np.ndarray:
    """Corners (4, 3) [mm] of a plate of 600 by 400 mm anywhere on the floor, Z of its axes down."""
    random = np.random.default_rng(seed)
    angle, centre = random.uniform(0, 2 * np.pi), np.append(random.uniform(-2000, 2000, 2), 5.0)
    x, y = np.array([np.cos(angle), np.sin(angle), 0]), np.array([np.sin(angle), -np.cos(angle), 0])
    return np.array([centre + 300 * a * x + 200 * b * y for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))])


def wrenches(seed: int) -> np.ndarray:
    """Wrenches (samples, 6) [N, N m] on somebody standing near the origin."""
    random = np.random.default_rng(seed)
    return random.normal(size=(SAMPLES, 6)) * [50, 50, 80, 60, 60, 20] + [0, 0, 700, 0, 0, 0]


def channels(kind: int, place: np.ndarray, wrench: np.ndarray, calibration: np.ndarray) -> np.ndarray:
    """What the channels of a plate of this type would hold [N, N mm, mm], by the C3D specification."""
    R_WF, p_WF = plate_frame(place / 1000.0)
    force = wrench[:, :3] @ R_WF
    moment = 1000.0 * (wrench[:, 3:] - np.cross(p_WF, wrench[:, :3])) @ R_WF
    origin = np.array(ORIGIN[kind])
    if kind == 1:
        px, py = -moment[:, 1] / force[:, 2], moment[:, 0] / force[:, 2]
        free = moment[:, 2] - (px * force[:, 1] - py * force[:, 0])
        return np.column_stack([force, px, py, free])
    if kind in (3, 7):
        eight = _eight(force, moment + np.cross([0, 0, origin[2]], force), origin[0], origin[1])
        return eight if kind == 3 else eight @ np.linalg.inv(calibration).T
    six = np.column_stack([force, moment + np.cross(origin, force)])
    return six if kind == 2 else six @ np.linalg.inv(calibration).T


def _eight(force: np.ndarray, moment: np.ndarray, a: float, b: float) -> np.ndarray:
    """Eight sensor forces with this sum and moment; the remaining freedom is set to zero."""
    (fx, fy, fz), (mx, my, mz) = force.T, moment.T
    x12, x34 = fx / 2, fx / 2
    y14 = fy / 2 + mz / (2 * a)
    z1, z2 = fz / 4 + mx / (4 * b) - my / (4 * a), fz / 4 + mx / (4 * b) + my / (4 * a)
    z3, z4 = fz / 4 - mx / (4 * b) + my / (4 * a), fz / 4 - mx / (4 * b) - my / (4 * a)
    return np.column_stack([x12, x34, y14, fy - y14, z1, z2, z3, z4])


def setup(kinds: list[int], seed: int = 0, **changes) -> tuple[C3dBuilder, np.ndarray]:
    """A file with plates of these types, and the wrenches (samples, plates, 6) behind its channels."""
    calibration = np.diag([2.0, 2.0, 5.0, 700.0, 700.0, 400.0]) + np.random.default_rng(9).normal(size=(6, 6)) * 0.05
    places = [corners(seed + k) for k in range(len(kinds))]
    truth = np.stack([wrenches(seed + 50 + k) for k in range(len(kinds))], axis=1)
    parts = [
        channels(kind, places[k], truth[:, k], np.eye(8) if kind == 7 else calibration) for k, kind in enumerate(kinds)
    ]
    numbers = np.zeros((8, len(kinds)), int)
    for k, part in enumerate(parts):
        numbers[: part.shape[1], k] = 1 + sum(p.shape[1] for p in parts[:k]) + np.arange(part.shape[1])
    units = {1: ["N"] * 3 + ["mm"] * 2 + ["Nmm"], 2: ["N"] * 3 + ["Nmm"] * 3, 3: ["N"] * 8, 4: ["V"] * 6, 7: ["V"] * 8}
    group = {
        "USED": np.array([len(kinds)]),
        "TYPE": np.array(kinds),
        "CHANNEL": numbers,
        "CORNERS": np.stack([place.T for place in places], axis=2),
        "ORIGIN": np.array([ORIGIN[kind] for kind in kinds]).T,
        "CAL_MATRIX": np.tile(calibration[:, :, None], (1, 1, len(kinds))),
    }
    built = C3dBuilder(points=standing(FRAMES), labels=labels(8), analogs=np.concatenate(parts, axis=1), ratio=RATIO)
    built.parameters = {
        "ANALOG": {"UNITS": [unit for kind in kinds for unit in units[kind]]},
        "FORCE_PLATFORM": group | changes,
    }
    return built, truth


def refusals(trial) -> dict[int, str]:
    """The refused plates with the beginning of the reason."""
    said = [note.message.split(" cannot be used: ") for note in trial.notes if note.code == "plates.refused"]
    return {int(plate.removeprefix("plate ")): reason.split(":")[0] for plate, reason in said}


def codes(trial) -> set[str]:
    return {note.code for note in trial.notes}


@pytest.mark.parametrize("case", range(3))
def test_type_7_is_type_3_behind_a_calibration(tmp_path: Path, seed: int, case: int) -> None:
    """Eight channels that a matrix of 8 by 8 turns into the sensors' forces hold the wrench of type 3."""
    seed += case
    calibration = np.diag(np.full(8, 150.0)) + np.random.default_rng(seed).normal(size=(8, 8))
    truth = wrenches(seed)
    built, _ = setup([7], seed, CAL_MATRIX=calibration[:, :, None])
    built.analogs = channels(7, corners(seed), truth, calibration)
    forces = read_c3d(built.save(tmp_path / "a.c3d")).forces
    assert forces is not None
    assert_allclose(forces.wrench[:, 0], truth, atol=2e-3, rtol=1e-5)


@pytest.mark.parametrize(("kind", "reason"), [(5, "inches"), (6, "sensors"), (11, "types 1, 2, 3, 4, 7 are")])
def test_types_that_are_not_read_say_why(tmp_path: Path, kind: int, reason: str) -> None:
    """A plate of another type falls alone, and its note gives the reason."""
    built, truth = setup([2, 2], TYPE=np.array([2, kind]))
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench, truth[:, :1], atol=2e-3, rtol=1e-5)
    assert refusals(trial) == {2: f"type {kind} is not read"}
    assert [note for note in trial.notes if note.code == "plates.refused" and reason in note.message]


def test_plates_that_share_a_channel_are_refused(tmp_path: Path) -> None:
    """Of two plates with a channel in common nothing tells which is right; the third stays."""
    built, truth = setup([2, 2, 2])
    built.parameters["FORCE_PLATFORM"]["CHANNEL"][2, 1] = 3
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert [plate.name for plate in trial.forces.plates] == ["plate 3"]
    assert_allclose(trial.forces.wrench, truth[:, 2:], atol=2e-3, rtol=1e-5)
    assert refusals(trial) == {
        1: "its channels 3 are also those of plate 2",
        2: "its channels 3 are also those of plate 1",
    }


@pytest.mark.parametrize("fault", ["bent", "skewed", "crosswise", "trapezium"])
def test_corners_that_are_no_rectangle_are_refused(tmp_path: Path, fault: str) -> None:
    """A corner out of the plane, slanted or unequal sides, another order: the plate falls, and its misfit is said."""
    built, _ = setup([2, 2])
    place = built.parameters["FORCE_PLATFORM"]["CORNERS"][:, :, 1].T.copy()
    along = (place[0] - place[1]) / 600.0
    if fault == "bent":
        place[2, 2] += 120.0
    elif fault == "skewed":
        place[:2] += 100.0 * along
    elif fault == "trapezium":
        place[0] += 100.0 * along
    else:
        place = place[[0, 2, 1, 3]]
    built.parameters["FORCE_PLATFORM"]["CORNERS"][:, :, 1] = place.T
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None and [plate.name for plate in trial.forces.plates] == ["plate 1"]
    assert set(refusals(trial)) == {2} and "mm from the nearest rectangle" in str(trial.notes)
    assert ("in another order" in str(trial.notes)) == (fault == "crosswise")


def test_measured_corners_stay_and_are_said(tmp_path: Path) -> None:
    """Corners that were measured some millimetres off are kept; beyond what is usual, that is said."""
    for shift, said in ((4.0, False), (30.0, True)):
        built, _ = setup([2])
        built.parameters["FORCE_PLATFORM"]["CORNERS"][2, 1, 0] += shift
        trial = read_c3d(built.save(tmp_path / "a.c3d"))
        assert trial.forces is not None and len(trial.forces.plates) == 1
        assert ("mm from a rectangle" in str(trial.notes)) == said


def test_a_type_list_longer_than_used(tmp_path: Path) -> None:
    """A plate beyond USED that the file describes in full is read; an empty one or a copy is not; both are said."""
    built, truth = setup([2, 4], USED=np.array([1]))
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench, truth, atol=2e-3, rtol=1e-5)
    assert [note for note in trial.notes if note.code == "plates.used" and "read as well" in note.message]
    for name, index in (("CORNERS", np.s_[:, :, 1]), ("CHANNEL", np.s_[:, 1])):
        built, truth = setup([2, 4], USED=np.array([1]))
        stored = built.parameters["FORCE_PLATFORM"][name]
        stored[index] = 0 if name == "CORNERS" else stored[:, 0]
        trial = read_c3d(built.save(tmp_path / "a.c3d"))
        assert trial.forces is not None
        assert_allclose(trial.forces.wrench, truth[:, :1], atol=2e-3, rtol=1e-5)
        assert [note for note in trial.notes if note.code == "plates.used" and "plate 2 is left out" in note.message]


@pytest.mark.parametrize("case", range(3))
def test_types_1_to_4_hold_equal_physics(tmp_path: Path, seed: int, case: int) -> None:
    """A wrench about the world's origin comes back from the channels of every type, wherever the plate lies."""
    seed += case
    built, truth = setup([1, 2, 3, 4], seed)
    forces = read_c3d(built.save(tmp_path / "a.c3d")).forces
    assert forces is not None
    assert_allclose(forces.wrench, truth, atol=2e-3, rtol=1e-5)
    found = forces.plates[2].corners
    assert found is not None
    assert_allclose(found, corners(seed + 2) / 1000.0, atol=1e-6)


def test_origin_above_the_surface_is_turned_over(tmp_path: Path) -> None:
    """An ORIGIN with positive z is the opposite vector: same wrench, and said."""
    built, truth = setup([2, 4], ORIGIN=-np.array([ORIGIN[2], ORIGIN[4]]).T)
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench, truth, atol=2e-3, rtol=1e-5)
    assert "plates.assumed" in codes(trial)


def test_moments_in_newton_metres(tmp_path: Path) -> None:
    """The unit of the moment channels is read, not taken for N mm."""
    built, truth = setup([2])
    built.analogs[:, 3:] /= 1000.0
    built.parameters["ANALOG"]["UNITS"] = ["N"] * 3 + ["Nm"] * 3
    forces = read_c3d(built.save(tmp_path / "a.c3d")).forces
    assert forces is not None
    assert_allclose(forces.wrench, truth, atol=2e-3, rtol=1e-5)


def two(value: list) -> np.ndarray:
    return np.array(value)


@pytest.mark.parametrize(
    "change",
    [
        {"TYPE": two([21, 2])},
        {"CHANNEL": np.array([[0, 7], [2, 8], [3, 9], [4, 10], [5, 11], [6, 12]])},
        {"CHANNEL": np.array([[1, 7], [2, 8], [3, 9], [4, 10], [5, 11], [60, 12]])},
        {"CHANNEL": np.array([[1, 7], [1, 8], [3, 9], [4, 10], [5, 11], [6, 12]])},
        {"CORNERS": np.stack([np.zeros((3, 4)), corners(1).T], axis=2)},
        {"CORNERS": np.stack([np.full((3, 4), np.nan), corners(1).T], axis=2)},
        {"CORNERS": np.stack([corners(0).T / 1000.0, corners(1).T], axis=2)},
        {"CORNERS": np.stack([corners(0).T + [[0] * 4, [0] * 4, [0, 400, 0, 0]], corners(1).T], axis=2)},
    ],
)
def test_a_bad_plate_is_refused_alone(tmp_path: Path, change: dict) -> None:
    """A plate of unknown type, with impossible channels or corners is left out and said; its neighbour stays."""
    built, truth = setup([2, 2], **change)
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert [plate.name for plate in trial.forces.plates] == ["plate 2"]
    assert_allclose(trial.forces.wrench[:, 0], truth[:, 1], atol=2e-3, rtol=1e-5)
    assert [note for note in trial.notes if note.code == "plates.refused" and "plate 1" in note.message]


def test_short_scale_refuses_the_plate_that_needs_it(tmp_path: Path) -> None:
    """Analog channels without SCALE are not guessed."""
    built, _ = setup([2, 2])
    built.parameters["ANALOG"]["SCALE"] = np.ones(6)
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert [plate.name for plate in trial.forces.plates] == ["plate 1"]
    assert {"c3d.analog_scale", "plates.refused"} <= codes(trial)


@pytest.mark.parametrize("change", [{"USED": np.array([0])}, {"TYPE": None}])
def test_no_plates_leaves_the_markers(tmp_path: Path, change: dict) -> None:
    """USED 0 or no TYPE: kinematics stay readable, and the absence of forces is said."""
    built, _ = setup([2], **change)
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is None and "plates.none" in codes(trial)
    assert len(trial.markers.labels) == 8


def test_two_dimensional_used_and_type(tmp_path: Path) -> None:
    """USED and TYPE stored as matrices read like vectors."""
    built, truth = setup([2, 2], USED=np.array([[2]]), TYPE=np.array([[2, 2]]))
    forces = read_c3d(built.save(tmp_path / "a.c3d")).forces
    assert forces is not None
    assert_allclose(forces.wrench, truth, atol=2e-3, rtol=1e-5)


def test_a_reversed_plate_is_said_and_left(tmp_path: Path) -> None:
    """A plate that pulls the subject down is reported, not turned."""
    built, truth = setup([2])
    built.analogs = -built.analogs
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench, -truth, atol=2e-3, rtol=1e-5)
    assert "plates.sign" in codes(trial)


def on_the_plate(seed: int) -> tuple[C3dBuilder, np.ndarray]:
    """Plates of types 2 and 4 that bear somebody on their middles, and the wrenches behind their channels."""
    built, truth = setup([2, 4], seed)
    random = np.random.default_rng(seed)
    for k, kind in enumerate((2, 4)):
        R_WF, p_WF = plate_frame(corners(seed + k) / 1000.0)
        force = random.normal(size=(SAMPLES, 3)) * [40.0, 40.0, 80.0] + [0.0, 0.0, 700.0]
        point = p_WF + (random.uniform(-0.1, 0.1, (SAMPLES, 3)) * [1, 1, 0]) @ R_WF.T
        truth[:, k] = np.concatenate([force, np.cross(point, force)], axis=1)
        matrix = built.parameters["FORCE_PLATFORM"]["CAL_MATRIX"][:, :, k]
        built.analogs[:, 6 * k : 6 * k + 6] = channels(kind, corners(seed + k), truth[:, k], matrix)
    return built, truth


def test_forces_that_nobody_bears_leave_the_plate_out(tmp_path: Path, seed: int) -> None:
    """A scale that makes meganewtons of one plate: it is left out and said, unless the config gives its gain."""
    built, truth = on_the_plate(seed % 1000)
    number, factor = seed % 2 + 1, 10.0 ** np.random.default_rng(seed).uniform(3.0, 20.0)
    built.parameters["ANALOG"]["SCALE"] = np.where(np.arange(12) // 6 == number - 1, factor, 1.0)
    path = built.save(tmp_path / "a.c3d")
    trial = read_c3d(path)
    assert trial.forces is not None and [plate.name for plate in trial.forces.plates] == [f"plate {3 - number}"]
    assert [note for note in trial.notes if note.code == "plates.force" and f"plate {number}" in note.message]
    assert trial.parameters["plates overloaded"] == str(number)
    told = read_c3d(path, options=ReadOptions(plates={number: PlateAs(gain=1.0 / factor)})).forces
    assert told is not None
    assert_allclose(told.wrench, truth, atol=2e-3, rtol=1e-4)


def test_single_samples_that_nobody_bears_are_gaps(tmp_path: Path, seed: int) -> None:
    """Two samples of 30 kN beside each other, which are no spike, become gaps and are said."""
    built, _ = on_the_plate(seed % 1000)
    at = int(np.random.default_rng(seed).integers(4, SAMPLES - 4))
    built.analogs[at : at + 2, 2] = -30e3
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert np.flatnonzero(np.isnan(trial.forces.wrench[:, 0, 2].numpy())).tolist() == [at, at + 1]
    assert [note for note in trial.notes if note.code == "plates.force" and "2 samples" in note.message]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda built: built.parameters["ANALOG"]["UNITS"].__setitem__(slice(3, 5), ["Nm"] * 2), "pressure lies"),
        (lambda built: built.parameters["ANALOG"]["UNITS"].__setitem__(5, "Nm"), "free moment is"),
        (lambda built: built.parameters["ANALOG"].update(SCALE=np.array([60.0, *[1.0] * 11])), "pushed sideways"),
        (lambda built: built.parameters["FORCE_PLATFORM"]["ORIGIN"].__setitem__((0, 0), 3000.0), "pressure lies"),
    ],
)
def test_a_load_that_no_contact_gives_is_said(tmp_path: Path, seed: int, change, said: str) -> None:
    """Units of the moments, one channel's scale, an origin metres off: said of that plate alone, whose load is kept."""
    built, _ = on_the_plate(seed % 1000)
    built.analogs[:, 0] += 30.0
    built.analogs[:, 5] += 3000.0
    path = tmp_path / "a.c3d"
    assert "plates.load" not in codes(read_c3d(built.save(path)))
    change(built)
    trial = read_c3d(built.save(path))
    assert trial.forces is not None and len(trial.forces.plates) == 2
    (note,) = [note for note in trial.notes if note.code == "plates.load"]
    assert note.message.startswith("plate 1") and said in note.message


def test_offsets_stay_and_are_reported(tmp_path: Path) -> None:
    """An unloaded plate that reads 12 N keeps them, with a note."""
    built, truth = setup([2])
    R_WF, _ = plate_frame(corners(0) / 1000.0)
    built.analogs[: SAMPLES // 2] = np.append(np.array([0.0, 0.0, 12.0]) @ R_WF, [0.0, 0.0, 0.0])
    trial = read_c3d(built.save(tmp_path / "a.c3d"))
    assert trial.forces is not None
    assert_allclose(trial.forces.wrench[: SAMPLES // 2, 0, 2], 12.0, atol=1e-4)
    assert [note for note in trial.notes if note.code == "plates.baseline" and "12.0 N" in note.message]


def test_baseline_needs_a_free_plate() -> None:
    """A plate that always carries somebody has no baseline; a drifting free one has its median."""
    assert baseline(np.full(100, 700.0)) is None
    assert baseline(np.concatenate([np.full(2, 0.0), np.full(98, 650.0)])) is None
    drifting = baseline(np.concatenate([np.linspace(5, 9, 50), np.full(50, 700.0)]))
    assert drifting is not None
    assert_allclose(drifting, 7.0, atol=0.1)
