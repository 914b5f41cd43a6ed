"""Forces against feet: what is planted is named by the line that mends it, and nothing is named where nothing is."""

import functools
import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from rates import at_least
from walker import BODY, FOOT, MASS, walking_trial

from torchid.checks.finding import InstrumentFault, record_of
from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.feet import floor_height
from torchid.checks.plates_against_feet.finding import BELIEVED
from torchid.checks.plates_against_feet.judge import judge
from torchid.checks.plates_against_feet.readings import changed
from torchid.checks.plates_against_feet.session import Recording, judge_recording, judge_session, refuse_disagreement
from torchid.config.sections import Config
from torchid.conventions import GRAVITY
from torchid.errors import InputError
from torchid.io import ReadOptions, read_trial
from torchid.io.grf import forces_from_storage
from torchid.io.mend import CHANNELS, ForcesAs, PlateAs, mend, ordered_corners, reframed
from torchid.io.plate_axes import from_plate, in_plate
from torchid.io.plate_limits import within_limits
from torchid.io.resample import synchronise
from torchid.io.storage import Storage
from torchid.recording import Forces, Plate, Trial
from torchid.session.opening import setup_of


@functools.cache
def options_of(line: str) -> ReadOptions:
    """What a line means in a trial's entry of a config."""
    entry = {"name": "t", "file": "t.c3d", **yaml.safe_load(f"{{{line}}}")}
    config = Config.model_validate_json(json.dumps({"subject": {"name": "s"}, "markers": "opencap", "trials": [entry]}))
    return replace(setup_of(config).reading(config.trials[0]), wanted=frozenset())


def read_as(trial: Trial, options: ReadOptions) -> Trial:
    """The trial as reading would give it with these options (but for the vertical)."""
    assert trial.forces is not None
    forces = mend(reframed(trial.forces, options.plates), options.forces_as, options.plates)
    if forces is not None and not torch.equal(forces.time, trial.markers.time):
        return synchronise(replace(trial, forces=forces))
    return replace(trial, forces=forces)


def channels(trial: Trial, plate: int, change) -> Trial:
    """The trial with the six channels of a plate changed."""
    forces = trial.forces
    assert forces is not None
    wrench, own = forces.wrench.clone(), forces.plates[plate]
    wrench[:, plate] = from_plate(change(in_plate(wrench[:, plate], own)), own)
    return replace(trial, forces=replace(forces, wrench=wrench))


def in_other_corners(trial: Trial, plate: int, order: list[int]) -> Trial:
    """The trial as a file gives it that lists a plate's corners in another order."""
    forces = trial.forces
    assert forces is not None
    own, wrench = forces.plates[plate], forces.wrench.clone()
    assert own.corners is not None
    wrong = replace(own, corners=own.corners[order])
    wrench[:, plate] = from_plate(in_plate(wrench[:, plate], own), wrong)
    plates = tuple(wrong if k == plate else p for k, p in enumerate(forces.plates))
    return replace(trial, forces=replace(forces, wrench=wrench, plates=plates))


def scaled(trial: Trial, factor: float) -> Trial:
    assert trial.forces is not None
    return replace(trial, forces=replace(trial.forces, wrench=trial.forces.wrench * factor))


def swapped(a: str, b: str):
    """Channels a and b exchanged, each read in the other's unit."""
    i, j, unit = CHANNELS.index(a), CHANNELS.index(b), torch.tensor([1.0] * 3 + [1e-3] * 3).double()

    def change(six: torch.Tensor) -> torch.Tensor:
        six = six.clone()
        six[:, [i, j]] = six[:, [j, i]] * unit[[i, j]] / unit[[j, i]]
        return six

    return change


def exchanged(trial: Trial) -> Trial:
    """The channels of two plates with each other's corners."""
    forces = trial.forces
    assert forces is not None
    one, two = forces.plates
    both = [from_plate(in_plate(forces.wrench[:, k], p), q) for k, p, q in ((1, two, one), (0, one, two))]
    return replace(trial, forces=replace(forces, wrench=torch.stack(both, dim=1)))


def late(trial: Trial, seconds: float) -> Trial:
    assert trial.forces is not None
    return synchronise(replace(trial, forces=replace(trial.forces, time=trial.forces.time + seconds)))


def turned(trial: Trial, matrix: list[list[float]]) -> Trial:
    """Forces in other axes than the markers."""
    R = torch.tensor(matrix).double()
    forces = trial.forces
    assert forces is not None
    parts = [forces.wrench[..., :3] @ R.T, forces.wrench[..., 3:] @ R.T * torch.linalg.det(R)]
    return replace(trial, forces=replace(forces, wrench=torch.cat(parts, dim=-1)))


DRAWS, RATE = 10, 0.98
"""Walks, and the share of them in which a planted fault is named and mended, or right forces are left alone.

Measured in 30 walks: 390 of 390 faults and 60 of 60 right ones."""
PLANTED = {
    "turned by 90": (lambda t: in_other_corners(t, 1, [1, 2, 3, 0]), "plates"),
    "turned by 180": (lambda t: in_other_corners(t, 0, [2, 3, 0, 1]), "plates"),
    "turned by 270": (lambda t: in_other_corners(t, 1, [3, 0, 1, 2]), "plates"),
    "corners mirrored": (lambda t: in_other_corners(t, 0, [1, 0, 3, 2]), "plates"),
    "left-handed": (lambda t: channels(t, 1, lambda w: w * torch.tensor([-1.0, 1, 1, 1, -1, -1])), "plates"),
    "fz and my": (lambda t: channels(t, 0, swapped("fz", "my")), "plates"),
    "N mm": (lambda t: channels(t, 0, lambda w: w * torch.tensor([1.0, 1, 1, 1e3, 1e3, 1e3])), "plates"),
    "plates exchanged": (exchanged, "plates"),
    "reversed": (lambda t: scaled(t, -1.0), "forces_as"),
    "kN": (lambda t: scaled(t, 1e-3), "forces_as"),
    "body weights": (lambda t: scaled(t, 1 / (GRAVITY * MASS)), "forces_as"),
    "late": (lambda t: late(t, 0.12), "forces_as"),
    "early": (lambda t: late(t, -0.08), "forces_as"),
}


@pytest.mark.parametrize("corners", [True, False])
def test_right_forces_are_not_accused(seed, corners):
    """Walks whose forces are right are left alone, with corners and without."""
    found = [judge(walking_trial(seed + draw, corners), MASS) for draw in range(DRAWS)]
    assert found.count(()) >= at_least(RATE, DRAWS), found


@pytest.mark.parametrize("kept", [0, 1, 2, 16])
@pytest.mark.parametrize("seen", [0.0, 0.2, 1.0])
def test_few_or_rarely_seen_markers_are_no_defect(seed, kept, seen):
    """Without feet to agree with, nothing is said of forces; floors of such recordings are where their markers come."""
    trial = walking_trial(seed)
    position = trial.markers.position[:, :kept].clone()
    position[torch.rand(len(position), generator=torch.Generator().manual_seed(seed)) >= seen] = torch.nan
    markers = replace(trial.markers, labels=trial.markers.labels[:kept], position=position)
    assert judge(replace(trial, markers=markers), MASS) == ()
    assert (floor_height(markers) < float("inf")) == (kept > 0 and seen > 0.5)


@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_named_by_the_line_that_mends_it(seed, fault):
    """The line parses as a config's, is of the right kind, gives the right forces back, and nothing is left to say."""
    found = [lines_and_error(seed + draw, PLANTED[fault][0]) for draw in range(DRAWS)]
    bound = 0.25 if fault in ("late", "early") else 0.03  # feet are a clock of 20 ms
    right = [bool(lines) and all(line.startswith(PLANTED[fault][1]) for line in lines) and error < bound
             for lines, error in found]  # fmt: skip
    assert sum(right) >= at_least(RATE, DRAWS), found


def lines_and_error(seed: int, plant: Callable[[Trial], Trial]) -> tuple[list[str], float]:
    """What is advised for a planted fault, and the relative error of the forces that are read so; infinite where more
    would be advised then."""
    right = walking_trial(seed)
    mended = plant(right)
    lines = [f.changes[0].line for f in judge(mended, MASS) if f.changes]
    for line in lines:
        mended = read_as(mended, options_of(line))
    assert mended.forces is not None and right.forces is not None
    inner = slice(40, -40)
    error = (mended.forces.wrench[inner] - right.forces.wrench[inner]).nan_to_num().square().mean().sqrt()
    left = float(error / right.forces.wrench[inner].square().mean().sqrt())
    return lines, left if judge(mended, MASS) == () else math.inf


@pytest.mark.parametrize(
    "matrix",
    [[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], [[-1.0, 0, 0], [0, 1, 0], [0, 0, 1]], [[1.0, 0, 0], [0, -1, 0], [0, 0, 1]]],
)
def test_other_axes_of_a_file_of_its_own_are_named(seed, matrix):
    """Turned about the vertical, or left-handed."""
    faulty = turned(walking_trial(seed, corners=False), matrix)
    (finding,) = judge(faulty, MASS)
    assert finding.changes and judge(read_as(faulty, options_of(finding.changes[0].line)), MASS) == ()


def moved(trial: Trial, number: int | None, key: str, shift: np.ndarray) -> Trial:
    """The trial as a file gives it whose plate, or all of whose plates, are described away from their place."""
    by = (float(shift[0]), float(shift[1]))
    file, plates = (ForcesAs(shift_m=by), {}) if number is None else (ForcesAs(), {number: PlateAs(**{key: by})})
    return replace(trial, forces=mend(trial.forces, file, plates))


@pytest.mark.parametrize(
    "key, corners, whole",
    [("shift_m", True, False), ("shift_m", False, False), ("origin_shift_m", True, False), ("shift_m", True, True)],
)
def test_the_place_of_a_plate_is_found(seed, key, corners, whole):
    """By any amount and into any direction: its corners, its ORIGIN, or the origin of all forces.

    The line puts the pressures within 45 mm of where they are, which is what the standard deviation says, and leaves
    nothing to say. Where pressures are on the plate either way, corners and ORIGIN are told side by side.
    """
    random, right = np.random.default_rng(seed), walking_trial(seed, corners)
    far, way, number = np.exp(random.uniform(np.log(0.25), np.log(5.0))), random.uniform(0, 2 * np.pi), seed % 2 + 1
    shift = far * np.array([np.cos(way), np.sin(way)])
    faulty = moved(right, None if whole else number, key, shift)
    (finding,) = judge(faulty, MASS)
    assert 1 <= len(finding.changes) <= 1 + (corners and not whole)
    (change,) = (one for one in finding.changes if whole or any(getattr(one.plates[number], key)))
    told = change.forces_as.shift_m if whole else getattr(change.plates[number], key)
    assert np.linalg.norm(told + shift) < 0.045, (change.line, shift)
    assert all(judge(read_as(faulty, options_of(one.line)), MASS) == () for one in finding.changes)
    mended = read_as(faulty, options_of(change.line))
    if corners:
        got, wanted = (trial.forces.plates[number - 1].corners for trial in (mended, right))
        torch.testing.assert_close(got, wanted, atol=0.045, rtol=0)


def test_forces_of_another_walk_are_named_but_not_mended(seed):
    """Forces of steps at other times have no line that mends them, and one that leaves them out."""
    right = walking_trial(seed, corners=False)
    other = replace(right.forces, wrench=right.forces.wrench.flip(0))
    (finding, *_) = judge(replace(right, forces=other), MASS)
    assert not finding.changes and "another trial" in finding.what and "use: false" in finding.remedy()
    assert read_as(right, options_of("forces_as: {use: false}")).forces is None


@pytest.mark.parametrize("factor, words", [(2.0, "times as large"), (None, "upside down")])
def test_another_world_is_told(seed, factor, words):
    """Markers twice as large, and a recording that stands on its head, each get a true sentence."""
    trial = walking_trial(seed, corners=False)
    half = torch.tensor([1.0, -1.0, -1.0]).double()
    position = trial.markers.position * (factor or half)
    assert trial.forces is not None
    wrench = trial.forces.wrench if factor else trial.forces.wrench * half.repeat(2)
    world = replace(
        trial, markers=replace(trial.markers, position=position), forces=replace(trial.forces, wrench=wrench)
    )
    assert words in " ".join(f.what for f in judge(world, MASS))


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("mass", [MASS, None])
def test_volts_are_mended_by_the_weight(seed, whole, mass):
    """Channels in volts get the gain that makes a person's weight of them, where a record or other plates tell it."""
    random, right, number = np.random.default_rng(seed), walking_trial(seed), seed % 2 + 1
    volts = float(random.uniform(5e-5, 1.8e-4) if whole else random.uniform(0.003, 0.02))
    faulty = scaled(right, volts) if whole else channels(right, number - 1, lambda six: volts * six)
    (finding,) = judge(faulty, mass)
    assert "volts" in finding.what
    if whole and mass is None:
        assert not finding.changes
        return
    (change,) = finding.changes
    gain = change.forces_as.gain if whole else change.plates[number].gain
    assert abs(gain * volts - 1.0) < 0.12, change.line
    assert judge(read_as(faulty, options_of(change.line)), mass) == ()


@pytest.mark.parametrize("factor", [0.0, 1e-3])
@pytest.mark.parametrize("part", ["forces", "moments"])
def test_scales_of_nothing_are_told(seed, factor, part):
    """Forces without moments and moments without forces: a thousandth is mended, with 0 the plate is left out."""
    right, number = walking_trial(seed), seed % 2 + 1
    signs = torch.tensor([factor] * 3 + [1.0] * 3 if part == "forces" else [1.0] * 3 + [factor] * 3).double()
    faulty = channels(right, number - 1, lambda six: six * signs)
    (finding,) = judge(faulty, MASS)
    assert "scaled by 0 or far too little" in finding.what and len(finding.changes) == (factor > 0)
    mended = read_as(faulty, options_of(finding.changes[0].line if factor else finding.instead.line))
    assert judge(mended, MASS) == ()
    if factor:
        torch.testing.assert_close(mended.forces.wrench, right.forces.wrench, atol=1e-4, rtol=1e-6)


def test_plates_that_read_nothing_under_feet_are_told(seed):
    """All channels scaled by 0: nothing is loaded although feet stand. Plates beside the feet may read nothing."""
    right = walking_trial(seed)
    silent = scaled(right, 0.0)
    (finding,) = judge(silent, MASS)
    assert "yet a foot stands on it" in finding.what and not finding.changes
    away = moved(silent, None, "shift_m", np.array([0.0, 5.0]))
    assert judge(away, MASS) == ()


def recording(trial: Trial, options: ReadOptions | None = None) -> tuple[Trial, Recording]:
    """A trial that is read by ``read_as``, as its options have it."""
    again = Recording(lambda o: read_as(trial, o), options or ReadOptions(), MASS)
    return read_as(trial, again.options), again


@pytest.mark.parametrize("force", ["fx", "fy", "fz"])
def test_channels_that_overload_a_plate_are_named(seed, force):
    """A moment in N mm that is read as a force leaves the plate out: the line brings it back."""
    right, number = walking_trial(seed), seed % 2 + 1
    faulty = channels(right, number - 1, swapped(force, "my"))

    def read(options: ReadOptions) -> Trial:
        trial = read_as(faulty, options)
        assert trial.forces is not None
        forces, _, numbers = within_limits(trial.forces, "walk.c3d")
        out = {"plates overloaded": str(numbers[0])} if numbers else {}
        return replace(trial, forces=forces, parameters=out)

    assert read(ReadOptions()).parameters == {"plates overloaded": str(number)}
    again = Recording(read, ReadOptions(), MASS)
    (finding,) = judge_recording(read(ReadOptions()), again)
    mended = read(options_of(finding.lines()[0]))
    assert not judge_recording(mended, Recording(read, options_of(finding.lines()[0]), MASS))
    error = (mended.forces.wrench - right.forces.wrench).nan_to_num().square().mean().sqrt()
    assert float(error / right.forces.wrench.square().mean().sqrt()) < 0.03, finding.lines()


def test_moments_about_origins_beside_pressures_are_told(seed):
    """Of a MOT whose points are pressures and whose moments are about the plates' origins, 0.4 m off or more."""
    right = walking_trial(seed)
    p_WP_W = right.forces.centre_of_pressure().nan_to_num()
    force, moment = right.forces.wrench[..., :3], right.forces.wrench[..., 3:]
    random = np.random.default_rng(seed)
    away = random.choice([-1, 1], (2, 3)) * random.uniform(0.3, 0.6, (2, 3)) * [1, 1, 0]
    origin = torch.stack([plate.corners.mean(dim=0) for plate in right.forces.plates]) + torch.from_numpy(away)
    about_origin = moment - torch.linalg.cross(origin.expand_as(force), force)
    bare = tuple(replace(plate, corners=None) for plate in right.forces.plates)

    def read(options: ReadOptions) -> Trial:
        own = torch.linalg.cross(p_WP_W, force) + options.forces_as.moment_gain * about_origin
        forces = Forces(right.forces.time, torch.cat([force, own], dim=-1), bare)
        return replace(right, forces=forces, parameters={"forces": "walk.mot"})

    (finding,) = judge_recording(read(ReadOptions()), Recording(read, ReadOptions(), MASS))
    assert finding.lines() == ["forces_as: {moment_gain: 0}"]
    mended = options_of(finding.lines()[0])
    assert judge_recording(read(mended), Recording(read, mended, MASS)) == ()


def test_a_wrong_word_of_the_user_is_taken_back(seed):
    """A config that turns a plate which was right is told so."""
    found = judge_recording(*recording(walking_trial(seed), options_of("plates: {1: {turn_deg: 180}}")))
    assert found and found[0].lines() == ["forces_as: {}, plates: {}"]


def test_a_session_is_refused_once_for_all_its_trials(seed):
    """A plate that is turned in every trial is mended by one line of the config."""
    trials = {f"walk{k}": recording(in_other_corners(walking_trial(seed + k), 0, [2, 3, 0, 1])) for k in range(2)}
    assert set(judge_session(trials)) == {"walk0", "walk1"}
    with pytest.raises(InputError) as caught:
        refuse_disagreement(trials)
    assert caught.value.code == "forces.feet" and "turn_deg: 180" in caught.value.remedy
    assert "to the config, for every trial" in caught.value.remedy
    mended = {name: recording(trial, options_of("plates: {1: {turn_deg: 180}}")) for name, (trial, _) in trials.items()}
    refuse_disagreement(mended)


def test_cures_that_contradict_each_other_are_not_both_advised(seed):
    """One plate, turned by 180 degrees in one walk and by 90 in the next, is not both: the trials are named, and no
    line but the one that leaves the plate out."""
    faulty = {
        "walk0": in_other_corners(walking_trial(seed), 0, [2, 3, 0, 1]),
        "walk1": in_other_corners(walking_trial(seed + 1), 0, [1, 2, 3, 0]),
    }
    trials = {name: recording(trial) for name, trial in faulty.items()}
    found = judge_session(trials)
    assert set(found) == set(faulty) and not any(f.changes for each in found.values() for f in each)
    with pytest.raises(InputError) as caught:
        refuse_disagreement(trials)
    assert "contradict each other about plate 1" in caught.value.remedy and "use: false" in caught.value.remedy
    one = found["walk0"][0].as_finding("walk.c3d")
    assert not one.cures and one.config == "" and "walk1: `plates: {1: {turn_deg: " in one.message


def test_a_finding_says_the_same_everywhere(seed):
    """A plate that has moved: fault, size, sd, line, and one sentence for check, error and JSON."""
    (finding,) = judge(moved(walking_trial(seed), 1, "shift_m", np.array([0.4, 0.3])), MASS)
    one = finding.as_finding("walk.c3d")
    record = record_of(one)
    assert one.fault is InstrumentFault.PLACE and abs(one.size - 0.5) < 0.07 and one.unit == "m" and one.sd < 0.1
    assert record.place == "walk.c3d, plate 1" and record.config == finding.changes[0].line
    assert record.message == one.note.message == f"{record.found}. Cure: {record.remedy}"
    assert record.config in record.remedy and one.cures[0].hypothesis.startswith("shift_m=[")


def test_channels_of_a_plate_come_back(seed):
    """From a wrench to a plate's channels and back, and a turned plate turns forces about its centre."""
    generator = torch.Generator().manual_seed(seed)
    wrench = torch.randn(5, 6, generator=generator, dtype=torch.float64)
    plate = walking_trial(seed).forces.plates[0]
    torch.testing.assert_close(from_plate(in_plate(wrench, plate), plate), wrench)
    for turn in (90, 180, 270):
        corners = ordered_corners(plate.corners, PlateAs(turn_deg=turn))
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        R = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]]).double()
        side, new = plate.corners[0] - plate.corners[1], corners[0] - corners[1]
        torch.testing.assert_close(new / new.norm(), R @ (side / side.norm()), atol=1e-9, rtol=0)
        square = replace(plate, corners=plate.corners * torch.tensor([1.0, 1.2, 1.0]).double())
        moved = replace(square, corners=ordered_corners(square.corners, PlateAs(turn_deg=turn)))
        force = from_plate(in_plate(wrench, square), moved)[:, :3]
        torch.testing.assert_close(force, wrench[:, :3] @ R.T, atol=1e-9, rtol=0)


def test_changes_of_reading_are_undone_by_reading(seed):
    """What a change does to the samples of a trial is what ``changed`` predicts from the frames."""
    trial = walking_trial(seed)
    for change in (
        Change("", ForcesAs(gain=2.0, mirror="x", turn_deg=90)),
        Change("", plates={2: PlateAs(mirror="y")}),
    ):
        read = read_as(trial, ReadOptions(forces_as=change.forces_as, plates=change.plates))
        torch.testing.assert_close(read.forces.wrench, changed(trial.forces, change))


def test_a_plate_that_is_not_there_is_refused(seed):
    """A config that names a plate which the file lacks is told which there are."""
    trial = walking_trial(seed)
    with pytest.raises(InputError, match="Known: 1, 2"):
        mend(trial.forces, ForcesAs(), {3: PlateAs(turn_deg=90)})
    with pytest.raises(InputError, match="forces_as"):
        mend(walking_trial(seed, corners=False).forces, ForcesAs(), {1: PlateAs(mirror="x")})


@pytest.mark.data
@pytest.mark.parametrize(
    "name, line",
    [
        ("plate_turned_180/turned.c3d", "plates: {2: {turn_deg: 180}}"),
        ("plate_turned_180/right.c3d", ""),
        ("moment_Nmm/moment_Nmm.mot", "forces_as: {moment_gain: 0.001}"),
        ("moment_Nmm/right.mot", ""),
        ("mot_zup_trc_yup/zup.mot", "up: y, forces_as: {up: z}"),
        ("mot_zup_trc_yup/right.mot", ""),
    ],
)
def test_files_that_went_wrong_are_mended(data_dir, name, line):
    """The line that is advised, read again, leaves nothing to say."""
    path = data_dir.parent / "cases" / name
    if not path.is_file():
        pytest.skip("no files that went wrong beside the recordings")
    markers, forces = (path, None) if path.suffix == ".c3d" else (path.parent / "walking1.trc", path)

    def read(options: ReadOptions) -> Trial:
        return synchronise(read_trial("t", markers, forces, options=options))

    found = judge_recording(read(ReadOptions()), Recording(read, ReadOptions()))
    assert ", ".join(f.changes[0].line for f in found) == line
    if line:
        assert judge_recording(read(options_of(line)), Recording(read, options_of(line))) == ()


def test_plates_of_a_mot_are_scaled_in_their_free_moment_alone(seed):
    """A MOT in N mm read with the line that mends it is the right one to the last digit, loaded or not."""

    random = np.random.default_rng(seed)
    columns = tuple(f"ground_force_{kind}{axis}" for kind in "vpm" for axis in "xyz")
    values = np.array([50, 700, -30, 0.3, 0.0, 0.2, 0.0, 5, 0]) * (1 + 1e-3 * random.normal(size=(30, 9)))
    values[:10] = 0.0
    time = np.arange(30) / 100
    right, _ = forces_from_storage(Storage(columns, time, values), "right")
    in_mm = values * np.r_[np.ones(6), np.full(3, 1e3)]
    mended, _ = forces_from_storage(Storage(columns, time, in_mm), "in N mm", lambda number: 1e-3)
    torch.testing.assert_close(mended.wrench, right.wrench)


def test_two_faults_of_one_recording_lead_to_a_line_that_mends_both(seed):
    """Reversed and late: each run names what is left, on top of what the config says, and the second one ends."""
    faulty = late(scaled(walking_trial(seed), -1.0), 0.12)
    options = ReadOptions()
    for _ in range(3):
        found = judge_recording(*recording(faulty, options))
        if not found:
            break
        options = options_of(found[0].lines()[0])
    assert not found and options.forces_as.gain == -1.0 and abs(options.forces_as.lag_ms - 120) < 30


def test_two_bad_plates_are_mended_by_one_line(seed):
    """A config has each key once, so that both plates stand in one line."""
    faulty = in_other_corners(in_other_corners(walking_trial(seed), 0, [2, 3, 0, 1]), 1, [1, 2, 3, 0])
    (finding,) = judge_recording(*recording(faulty))
    assert judge_recording(*recording(faulty, options_of(finding.lines()[0]))) == ()


def standing_trial(seed: int, apart: float, loads: tuple[float, ...]) -> Trial:
    """Somebody who stands for 2 s with the feet so far apart, on one plate or on two."""
    walk = walking_trial(seed, corners=False)
    random = np.random.default_rng(seed)
    feet = [FOOT * [1, side, 1] + [-0.1, 0.5 * apart * side, 0] for side in (1, -1)]
    place = np.concatenate([*feet, BODY])
    position = place + 1e-3 * random.normal(size=(len(walk.markers.time), *place.shape))
    wrench = np.zeros((len(position), len(loads), 6))
    for k, load in enumerate(loads):
        y = 0.0 if len(loads) == 1 else 0.5 * apart * (1 - 2 * k)
        wrench[:, k, 2], wrench[:, k, 3] = load, y * load
    markers = replace(walk.markers, position=torch.from_numpy(position))
    plates = tuple(Plate(f"plate {k + 1}") for k in range(len(loads)))
    return replace(walk, markers=markers, forces=Forces(walk.markers.time, torch.from_numpy(wrench), plates))


@pytest.mark.parametrize("apart", [0.15, 0.3, 0.6])
@pytest.mark.parametrize("loads", [(700.0,), (350.0, 350.0)])
def test_standing_is_not_accused(seed, apart, loads):
    """Feet together or wide, on one plate or on two: the pressure lies under or between them."""
    assert judge(standing_trial(seed, apart, loads), MASS) == ()


def test_what_cannot_be_told_is_not_accused(seed):
    """One foot marked alone, a plate that is only touched, and forces that the user believes."""
    walk = walking_trial(seed)
    left = tuple(k for k in range(len(walk.markers.labels)) if not 4 <= k < 8)
    one = replace(walk.markers, labels=tuple(f"M{k}" for k in left), position=walk.markers.position[:, list(left)])
    assert judge(replace(walk, markers=one), MASS) == ()
    faulty = in_other_corners(walk, 0, [2, 3, 0, 1])
    assert judge_recording(*recording(faulty)) and not judge_recording(*recording(faulty, options_of(BELIEVED)))
    touched = walk.forces.wrench.clone()
    touched[:, 1] = 0.04 * touched[:, 0]
    assert judge(replace(walk, forces=replace(walk.forces, wrench=touched)), MASS) == ()


def test_markers_that_lie_beside_upright_forces_are_told(seed):
    """Two files with other verticals, of somebody who stands: read with both verticals, they agree."""
    right = standing_trial(seed, 0.2, (350.0, 350.0))
    lying = right.markers.position[..., [0, 2, 1]] * torch.tensor([1.0, 1.0, -1.0])
    faulty = replace(right, markers=replace(right.markers, position=lying))

    def reread(change: Change) -> Trial | None:
        return right if (change.up, change.forces_as.up) == ("y", "z") else None

    found = judge(faulty, MASS, reread)
    assert found and found[0].changes[0].line == "up: y, forces_as: {up: z}"
