"""Tests of torchid.folder: a folder of recordings becomes a config that loads, whatever its layout and its names."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from draws import seed_of
from recordings import DATA
from typer.testing import CliRunner

from torchid import run
from torchid.cli import app
from torchid.config import Config, load_config
from torchid.errors import ConfigError, DataError, InputError
from torchid.folder.config_text import config_text
from torchid.folder.people import PersonFacts, people_in, stature_of, told_of
from torchid.folder.proposal import Proposal, _doubts, propose
from torchid.folder.statements import Person, statements_of
from torchid.folder.survey import STATED, Surveyed, names_of, survey
from torchid.folder.writing import write_config
from torchid.io.c3d_write import write_c3d
from torchid.model.label_words import told_by_words
from torchid.model.marker_set import load_marker_set, marker_sets
from torchid.model.recognition import recognised, unrecognised
from torchid.session.opening import setup_of
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession, simulate_session

OPTIONS = SimulateOptions(fit=("squats", "squats", "squats", "arms"), heldout=(), duration_s=2.0)
ALL = ("static", "squats", "squats_2", "squats_3", "arms")
TWO = ("static", "arms")
FOLDERS = {
    "arnold2013_synthetic_truth": ("arnold2013", None),
    "btk_c3d/others": ("plug_in_gait", "FunctionalStatic"),
    "btk_c3d/PiG": ("plug_in_gait", "PiG_Calibration-FlatFoot-Full"),
    "hamner2013_subject04": ("hamner2013", None),
    "opencap_subject4": ("opencap", "static1"),
    "opensim_rajagopal_walk": ("rajagopal2016", None),
    "opensim_subject01_gait2354": ("gait2354", "subject01_static"),
    "schreiber_moissenet_2014001": ("schreiber2019", "2014001_ST"),
    "welk007_functional": ("opencap", "c3d_Trimmed_static1"),
}
"""Marker set and standing trial of real folders."""


@pytest.fixture(scope="module")
def person() -> SimulatedSession:
    """Somebody who stands, squats three times and moves the arms."""
    return simulate_session(OPTIONS, seed_of(__name__))


def laid_out(person: SimulatedSession, folder: Path, names: Sequence[str] = ALL, **stated: str) -> Path:
    """Recordings as C3D files of a folder, with what they state of the subject."""
    folder.mkdir(parents=True, exist_ok=True)
    for item in (person.trial(name) for name in names):
        parameters = {key: value for key, value in item.trial.parameters.items() if key not in STATED} | stated
        write_c3d(folder / f"{item.trial.name}.c3d", replace(item.trial, parameters=parameters))
    return folder


def roles(proposal: Proposal) -> dict[str, str]:
    return {use.of.name: use.role for use in proposal.uses}


def test_a_folder_becomes_a_session(person: SimulatedSession, tmp_path: Path) -> None:
    """Standing is found, one of three squats is held out, arms alone of their kind are fitted; the config loads."""
    proposal = propose(laid_out(person, tmp_path / "P 1, left"))
    assert proposal.markers.name == "simulated" and proposal.name == "P_1_left"
    assert roles(proposal) == {
        "arms": "fit", "squats": "fit", "squats_2": "fit", "squats_3": "heldout", "static": "static",
    }  # fmt: skip
    (tmp_path / "new.yaml").write_text(config_text(proposal, tmp_path), encoding="utf-8")
    config = load_config(tmp_path / "new.yaml")
    assert {trial.name: trial.role for trial in config.trials} == roles(proposal)
    assert all(trial.file.is_file() for trial in config.trials)
    assert config.markers == "simulated" and config.subject.height_m == proposal.told.person.height_m


def test_names_tell_nothing_but_what_is_in_the_files_does(person: SimulatedSession, tmp_path: Path) -> None:
    """With numbers for names the one who stands still is found all the same."""
    folder = laid_out(person, tmp_path / "all")
    for k, path in enumerate(sorted(folder.iterdir())):
        path.rename(folder / f"Trial{k:02d}.c3d")
    found = roles(propose(folder))
    assert [name for name, role in found.items() if role == "static"] == ["Trial04"]
    assert sorted(found.values()) == ["fit", "fit", "fit", "heldout", "static"]


def test_standing_markers_tell_the_stature(person: SimulatedSession, tmp_path: Path) -> None:
    """To six per cent of what the simulated person measures: the published proportions scatter by three."""
    (standing,) = (one for one in survey(laid_out(person, tmp_path, TWO)) if one.name == "static")
    assert stature_of(standing, load_marker_set("simulated")) == pytest.approx(person.subject.model.height, rel=0.06)


def test_what_files_state_of_the_person_is_taken_and_its_source_said(person: SimulatedSession, tmp_path: Path) -> None:
    """The user's word goes first, then the recordings', then files beside them; contradictions are said."""
    folder = laid_out(person, tmp_path / "a", TWO, mass_kg="71.5")
    (folder / "_subject.json").write_text(json.dumps({"massKg": 80.0, "heightM": 1.8, "sex": "female"}))
    told = propose(folder, Person(height_m=1.7)).told
    assert (told.person.mass_kg, told.person.height_m, told.person.sex) == (71.5, 1.7, "female")
    assert told.sources["height_m"] == "as given" and told.sources["sex"] == "_subject.json"
    assert sorted(told.contradictions) == [
        "height_m is 1.7 (as given) and 1.8 elsewhere", "mass_kg is 71.5 (arms.c3d) and 80.0 elsewhere",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "text", "known"),
    [
        ("sessionMetadata.yaml", "mass_kg: 62.6\nheight_m: 1.68\ngender_mf: f\n", (62.6, 1.68, "female")),
        ("Anna.mp", "$Bodymass = 58.2\n$Height = 1643\n", (58.2, 1.643, None)),
        ("Session 1.Session.enf", "[NODE]\nBODYMASS=58.2\nHEIGHT=164 cm\n", (58.2, 1.64, None)),
        ("participants.tsv", "participant_id\tsex\tweight\theight\nsub-01\tM\t81\t183\n", (81.0, 1.83, "male")),
        ("participants.tsv", "participant_id\tweight\nhere\t81\nsub-02\t60\n", (81.0, None, None)),
        ("participants.csv", "id;mass;height\n1;62,5;1,68\n", (62.5, 1.68, None)),
        ("x_Setup_Scale.xml", "<OpenSimDocument><ScaleTool><mass> 72.6 </mass><height> 1803.4 </height><age>99</age>"
         "</ScaleTool></OpenSimDocument>", (72.6, 1.8034, None)),
        ("_subject.json", '{"massKg": 25.0, "heightM": 1.2, "ageYears": 7}', (25.0, 1.2, None, 7.0)),
        ("participants.tsv", "participant_id\tage\tsex\tweight\nsub-01\t72.5\tF\t60\n", (60.0, None, "female", 72.5)),
        ("session.yaml", "mass: 70\nage: 31 years\n", (70.0, None, None, 31.0)),
        ("subject.json", '{"mass": 70, "age": "18-30", "ageMonths": 84}', (70.0, None, None)),
        ("subject.json", '{"mass": 70, "ageYears": 0}', (70.0, None, None)),
        ("subject.json", '{"mass": "70 kg", "height": "1.7 m", "age": "18m"}', (70.0, 1.7, None)),
        ("subject.json", '{"mass": "70 m", "height": "2 kg", "age": "8 yrs", "sex": "f"}', (None, None, "female", 8)),
        ("subject.json", '{"mass": 70, "bodyAge": 52}', (70.0, None, None)),
        # Of other contents, of several people, in other units, or damaged: nothing.
        ("subject.json", "{broken", (None, None, None)),
        ("subject.json", "[" * 100000, (None, None, None)),
        ("reference.json", '{"massKg": 62.88}', (None, None, None)),
        ("session_info.json", '{"camera": {"height": 1080, "width": 1920}}', (None, None, None)),
        ("subject.json", '{"mass": "140 lb", "height": "5\'8", "sex": "m"}', (None, None, "male")),
        ("subject.json", '{"mass": 1e999, "height": -1, "sex": "f"}', (None, None, "female")),
        ("participants.tsv", "participant_id\tweight\nsub-01\t81\nsub-02\t60\n", (None, None, None)),
        ("participants.csv", "id,mass\n1,62,5,7\n", (62.0, None, None)),
    ],
)  # fmt: skip
def test_facts_are_read_from_files_of_several_programs(
    person: SimulatedSession, name: str, text: str, known: tuple, tmp_path: Path
) -> None:
    """Each in its units."""
    place = tmp_path / "here"
    place.mkdir()
    (place / name).write_text(text)
    recording = Surveyed("arms", place / "arms.c3d", None)
    (place / "arms.c3d").touch()
    found = told_of(tmp_path, (recording,), Person()).person
    assert (found.mass_kg, found.sex) == (known[0], known[2])
    assert found.height_m == (known[1] if known[1] is None else pytest.approx(known[1]))
    assert found.age_years == (known[3] if len(known) > 3 else None)


def standing(folder: Path, name: str, **stated: str) -> Surveyed:
    """A recording of which only the statement is known."""
    return Surveyed(name, folder / f"{name}.c3d", None, stated=stated)


def test_people_are_told_apart_by_what_is_stated_of_them(tmp_path: Path) -> None:
    """By masses in recordings or in files beside them, under names of their own; silent ones go with their folder."""
    a, b = tmp_path / "a", tmp_path / "b"
    for folder in (a, b):
        folder.mkdir()
    both = [
        standing(a, "s1", subject="Subject", mass_kg="60"), standing(a, "w1"),
        standing(b, "s2", subject="Subject", mass_kg="80"), standing(b, "w2"), standing(tmp_path, "wand"),
    ]  # fmt: skip
    found = people_in(both, tmp_path)
    assert {name: {one.name for one in some} for name, some in found.items()} == {
        "Subject_60": {"s1", "w1", "wand"}, "Subject_80": {"s2", "w2", "wand"},
    }  # fmt: skip
    for folder, mass in ((a, 61.0), (b, 75.0)):
        (folder / "_subject.json").write_text(json.dumps({"massKg": mass}))
    found = people_in([standing(a, "w1"), standing(b, "w2")], tmp_path)
    assert {name: [one.name for one in some] for name, some in found.items()} == {"a": ["w1"], "b": ["w2"]}
    assert statements_of(standing(a, "w1"), tmp_path) == [(Person(mass_kg=61.0), "a/_subject.json")]


@pytest.mark.parametrize(("age", "mean"), [(None, "of adults"), (8.0, "of that age")])
def test_the_mean_stature_that_is_taken_is_said(age: float | None, mean: str) -> None:
    """Of the age that is stated, else of adults."""
    told = PersonFacts(Person(age_years=age), {})
    assert any(f"the mean {mean} is taken" in doubt for doubt in _doubts(told, ()))


@pytest.mark.parametrize("folder", ["sub-02", "sub-02/ses-1", "sub-02/ses-1/motion"])
def test_a_part_of_a_bids_data_set_sees_its_participants(folder: str, tmp_path: Path) -> None:
    """A row with an age alone says something; files above the data set, and above other folders, say nothing."""
    name = "sub-02_ses-1_task-a_motion.tsv"
    (tmp_path / "subject.json").write_text('{"massKg": 99}')
    (tmp_path / "ds").mkdir()
    (tmp_path / "ds" / "participants.tsv").write_text("participant_id\tage\nsub-01\t71\nsub-02\t24\n")
    file = tmp_path / "ds" / "sub-02" / "ses-1" / "motion" / name
    one = Surveyed("a", file, None, stated={"subject": "sub-02"})
    top = tmp_path / "ds" / folder
    told = told_of(top, (one,), Person())
    assert told.person == Person(age_years=24.0)
    assert (top / told.sources["age_years"]).resolve() == tmp_path / "ds" / "participants.tsv"


@pytest.mark.parametrize(
    ("one", "other", "people"),
    [
        ({"sex": "male"}, {"sex": "F"}, 2), ({"age_years": "24"}, {"age_years": "71"}, 2),
        ({"age_years": "24"}, {"age_years": "25"}, 1), ({"sex": "male"}, {"age_years": "71"}, 1),
        ({"mass_kg": "60", "sex": "male"}, {"mass_kg": "60.5", "sex": "female"}, 2),
    ],
)  # fmt: skip
def test_every_fact_tells_people_apart(one: dict, other: dict, people: int, tmp_path: Path) -> None:
    """Sexes and ages too; a birthday between two recordings makes nobody another, nor does what is left out."""
    both = [standing(tmp_path, "a", subject="S", **one), standing(tmp_path, "b", subject="S", **other)]
    found = people_in(both, tmp_path)
    assert len(found) == people and sum(map(len, found.values())) == 2


def test_people_of_a_bids_data_set_are_those_of_its_names(tmp_path: Path) -> None:
    """Though nobody states anything of them, or the same of all; two sessions are of one person."""
    names = ("sub-01_ses-1_task-a", "sub-01_ses-2_task-a", "sub-02_ses-1_task-a")
    every = [
        Surveyed(name, tmp_path / name[:6] / "motion" / f"{name}_motion.tsv", None, stated={"subject": name[:6]})
        for name in names
    ]
    for text in ("", "participant_id\tsex\tage\nsub-01\tM\t20\nsub-02\tM\t20\n"):
        (tmp_path / "participants.tsv").write_text(text)
        found = {name: [one.name for one in some] for name, some in people_in(every, tmp_path).items()}
        assert found == {"sub-01": list(names[:2]), "sub-02": [names[2]]}


def test_of_several_people_one_has_to_be_named(person: SimulatedSession, tmp_path: Path) -> None:
    """Masses tell them apart; the refusal names all, and a name chooses."""
    laid_out(person, tmp_path / "a", TWO, subject="Ann", mass_kg="60")
    laid_out(person, tmp_path / "b", TWO, subject="Bob", mass_kg="80")
    with pytest.raises(InputError, match="Ann .2 recordings. and Bob") as refused:
        propose(tmp_path)
    assert refused.value.code == "folder.people"
    proposal = propose(tmp_path, Person("Bob"))
    assert proposal.name == "Bob" and {use.of.file.parent.name for use in proposal.uses} == {"b"}
    with pytest.raises(InputError, match="nobody here is called so"):
        propose(tmp_path, Person("Cleo"))


def test_what_cannot_serve_is_left_out_with_the_reason(person: SimulatedSession, tmp_path: Path) -> None:
    """A damaged file, a wand and a recording without forces beside a sound session."""
    folder = laid_out(person, tmp_path / "all", TWO)
    (folder / "cut.c3d").write_bytes((folder / "arms.c3d").read_bytes()[:5000])
    arms = person.trial("arms").trial
    wand = replace(arms.markers, labels=("W1", "W2", "W3"), position=arms.markers.position[:, :3])
    write_c3d(folder / "wand.c3d", replace(arms, markers=wand, forces=None))
    write_c3d(folder / "bare.c3d", replace(arms, forces=None))
    proposal = propose(folder)
    found = {use.of.name: use for use in proposal.uses}
    assert found["cut"].role == "" and found["cut"].why.endswith("]")
    assert found["wand"].role == "" and "0 of its 3 markers" in found["wand"].why
    assert found["bare"].role == "fit" and not found["bare"].inertia and "geometry alone" in found["bare"].why
    text = config_text(proposal, tmp_path)
    (tmp_path / "new.yaml").write_text(text, encoding="utf-8")
    assert "cut" not in {trial.name for trial in load_config(tmp_path / "new.yaml").trials}
    assert "# left out: " in text


def test_a_folder_of_standing_alone_is_refused(person: SimulatedSession, tmp_path: Path) -> None:
    """Nothing moves, so nothing can be fitted; the refusal says what each recording shows."""
    write_c3d(tmp_path / "static.c3d", person.trials[0].trial)
    with pytest.raises(DataError, match="static: stands still"):
        propose(tmp_path)


def test_recordings_get_names_of_their_own(tmp_path: Path) -> None:
    """By files, where those are alike by folders, where those are too by the whole path; no two are the same."""
    files = [tmp_path / "trials" / name / "markers.trc" for name in ("run 2", "run 3")]
    assert names_of(files, tmp_path) == ["run_2", "run_3"]
    files = [tmp_path / day / "walk" / "markers.trc" for day in ("d1", "d2")]
    assert names_of(files, tmp_path) == ["d1_walk_markers", "d2_walk_markers"]
    assert names_of([tmp_path / "walk1_markers.trc", tmp_path / "static.trc"], tmp_path) == ["walk1", "static"]
    files = [tmp_path / day / f"walk{k}.c3d" for day in ("d1", "d2") for k in (1, 2)]
    assert names_of([*files, tmp_path / "d1" / "arms.c3d"], tmp_path) == [
        "d1_walk1", "d1_walk2", "d2_walk1", "d2_walk2", "arms",
    ]  # fmt: skip
    assert names_of([tmp_path / f"walk{sign}1.c3d" for sign in " _-"], tmp_path) == ["walk_1", "walk_1_2", "walk-1"]


NAMES = ("${X} a", "~w", "a\u2028b: c", "a # b", "a: {b", 'a "b"', "1e3", "null", "Prüfung 1", "a\x7fb")


@pytest.mark.parametrize("name", NAMES)
def test_a_config_loads_whatever_a_folder_is_called(person: SimulatedSession, name: str, tmp_path: Path) -> None:
    """Or is refused with the reason before anything is written."""
    folder = laid_out(person, tmp_path / name, TWO)
    proposal = propose(folder)
    if "${" in name:
        with pytest.raises(InputError, match="Rename"):
            write_config(proposal, tmp_path / "new.yaml")
        return
    (written,) = write_config(proposal, tmp_path / "new.yaml")
    assert {trial.file for trial in load_config(written).trials} == {folder / f"{one}.c3d" for one in TWO}


def test_a_folder_of_nothing_readable_says_why(tmp_path: Path) -> None:
    """And so do a file, an absent folder, and forces without markers."""
    (tmp_path / "a.c3d").write_bytes(b"nothing")
    for path, said in ((tmp_path, "no recording can be used"), (tmp_path / "a.c3d", "a file is no folder"),
                       (tmp_path / "b", "no such folder")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            propose(path)


def test_reversed_forces_are_mended_and_said(person: SimulatedSession, tmp_path: Path) -> None:
    """The one reading that agrees with the feet is written beside each trial, and is in doubt."""
    for name in TWO:
        trial = person.trial(name).trial
        assert trial.forces is not None
        forces = replace(trial.forces, wrench=-trial.forces.wrench)
        write_c3d(tmp_path / f"{name}.c3d", replace(trial, forces=forces))
    proposal = propose(tmp_path)
    assert {use.of.name: use.inertia for use in proposal.uses if use.role} == {"static": True, "arms": True}
    assert all("gain: -1" in use.mend for use in proposal.uses)
    assert sum("read as it agrees with the feet" in doubt for doubt in proposal.doubts) == 2


@pytest.mark.parametrize("name", marker_sets())
def test_a_set_is_recognised_by_its_labels(name: str, seed: int) -> None:
    """Also by four in five of them, spelt otherwise, under a prefix; or one that lists just as many is."""
    random = np.random.default_rng(seed)
    specs = load_marker_set(name).specs
    some = [label for label, one in specs.items() if one.segment == "pelvis" or random.random() < 0.8]
    spelt = [f"Anna:{label.upper().replace('_', ' ')}" for label in some]
    found = recognised(spelt)
    assert not found.unknown
    told = found.markers.match(spelt).assigned
    assert {label: told[given].segment for label, given in zip(some, spelt, strict=True)} == {
        label: specs[label].segment for label in some
    }


CONVENTIONS = {
    "pelvis": "left_asis RightPSIS SIAS_D EIAS_G ASIS_R PSIS_L Sacrum L_Iliac_Crest WaistLFront WaistBack R_IAS LASIS",
    "thigh_l": "Left_Thigh_1 LThighUpper L_Knee_Lat LLFE left_knee_lateral LGTRO LLEK L_GT L_ME LKneeOut KNEE_LAT_L",
    "thigh_r": "RThigh3 R_Knee_Med RMKN RKNEL KneeMed_R RLEPI RGT RME RThighFrontLow RKneeIn",
    "shank_l": "LShank1 L_Ankle_Lat LMMAL LTIBA LANK_MED left_ankle_medial LATI LLM L_HF L_TT LShinFrontHigh LAnkleOut",
    "shank_r": "RShankUpper RTIBTUB RSHIN RLATMAL RLM R_MM RAnkleIn",
    "foot_l": "LHEEL L1MT L5MT LBigToe L_MTP1 LMH5 LCALC L5thMet L_CA L_FM L_SM L_VM LForefootOut LToeTip LHeelBack",
    "foot_r": "RTOE RMH1 RP5MT R_5th_Met RMT5 RForefoot2",
    "upper_arm_l": "LUA LUARM L_Upper_Arm LELB_LAT LLEE LDELT LElbowOut LArm",
    "upper_arm_r": "RUA1 R_Elbow_Med RElbowLat RHME RMEE RElbowIn",
    "forearm_l": "LFARM L_Forearm1 LWRIST LWRU L_Wrist_Ulnar LRAD LLW LWristOut",
    "forearm_r": "RFA2 R_Radius RWRI RUST RFRM RMW RWristIn",
    "hand_l": "LHAND L_Finger LMC3 LHandOut LFIN",
    "thorax": "STER XYPH Xiphoid Manubrium Left_Shoulder R_Acromion LSCAP T8 SpineTop Chest RShoulderTop SJN T2 BBAC",
    "head": "TopHead LTEMP R_Ear FHEAD THEAD HeadL HeadFront",
}
"""Labels of the Human Body Model, of Qualisys' animation set, of Leardini's protocol and of laboratories' own."""


@pytest.mark.parametrize("segment", CONVENTIONS)
def test_words_tell_the_segment(segment: str) -> None:
    """In the conventions of several schools, spelt in several ways."""
    labels = CONVENTIONS[segment].split()
    told = {label: getattr(told_by_words(label), "segment", None) for label in labels}
    assert told == dict.fromkeys(labels, segment)


@pytest.mark.parametrize("name", marker_sets())
def test_words_contradict_no_set(name: str) -> None:
    """Where words tell a segment or a landmark of a built-in set, it is the set's."""
    for label, spec in load_marker_set(name).specs.items():
        told = told_by_words(label)
        assert told is None or told.segment == spec.segment, label
        assert told is None or None in (told.landmark, spec.landmark) or told.landmark == spec.landmark, label


@pytest.mark.parametrize(
    "label", ["LHJC", "midASIS", "CentreOfMass", "L_AJC_proj", "M001", "x", "", "LKneeAngles", "Cat"]
)
def test_words_say_nothing_of_what_is_no_marker(label: str) -> None:
    """Joint centres, angles, numbers and other words tell no segment."""
    assert told_by_words(label) is None


WORDS = {
    "ASI": "Asis", "PSI": "Psis", "FHD": "HeadFront", "BHD": "HeadBack", "SHO": "Acromion", "BAK": "Back",
    "UPA": "UpperArm", "ELB": "ElbowLat", "ELBM": "ElbowMed", "FRA": "Forearm", "WRA": "WristRadial",
    "WRB": "WristUlnar", "FIN": "Hand", "HA2": "Hand2", "HA5": "Hand5", "THI": "Thigh", "THAP": "Thigh2",
    "KNE": "KneeLat", "KNM": "KneeMed", "TIB": "Shank", "TIAP": "Shank2", "ANK": "AnkleLat", "ANM": "AnkleMed",
    "HEE": "Heel", "TOE": "ToeTip", "MT1": "Met1", "MT5": "Met5",
}  # fmt: skip
OTHER = {
    side + word: f"{name}_{said}" for side, name in (("L", "Left"), ("R", "Right")) for word, said in WORDS.items()
}
OTHER |= {"CLAV": "Manubrium", "STRN": "Xiphoid", "SACR": "Sacrum"}
"""The simulated labels as another laboratory would have them."""


def test_another_convention_begins_by_itself(person: SimulatedSession, tmp_path: Path) -> None:
    """Labels of no built-in set become a marker map beside the config, every marker on its segment."""
    config = tmp_path / "new.yaml"
    for name in TWO:
        trial = person.trial(name).trial
        (tmp_path / "data").mkdir(exist_ok=True)
        labels = tuple(OTHER.get(label, label) for label in trial.markers.labels)
        write_c3d(tmp_path / "data" / f"{name}.c3d", replace(trial, markers=replace(trial.markers, labels=labels)))
    done = CliRunner().invoke(app, ["new", str(tmp_path / "data"), "-o", str(config)])
    assert done.exit_code == 0, done.output
    setup = setup_of(load_config(config))
    segments = {label: spec.segment for label, spec in load_marker_set("simulated").specs.items()}
    told = {OTHER.get(label, label): segment for label, segment in segments.items()}
    assert {label: spec.segment for label, spec in setup.markers.specs.items()} == {
        label: segment for label, segment in told.items() if label in setup.markers.specs
    }
    assert len(setup.markers.specs) > 0.9 * len(told)


def test_random_names_are_placed(person: SimulatedSession, tmp_path: Path, seed: int) -> None:
    """Labels that say nothing become a marker map by places and motion, without stature; every line is right."""
    random, config = np.random.default_rng(seed), tmp_path / "new.yaml"
    segments = {label: spec.segment for label, spec in load_marker_set("simulated").specs.items()}
    own = [label for label, name in segments.items() if name != "abdomen"]  # which nobody marks
    names = dict(zip(own, (f"M{k:03d}" for k in random.choice(1000, len(own), replace=False)), strict=True))
    (tmp_path / "data").mkdir()
    for name in TWO:
        trial = person.trial(name).trial
        markers = trial.markers.select(tuple(label for label in trial.markers.labels if label in names))
        markers = replace(markers, labels=tuple(names[label] for label in markers.labels))
        write_c3d(tmp_path / "data" / f"{name}.c3d", replace(trial, markers=markers))
    done = CliRunner().invoke(app, ["new", str(tmp_path / "data"), "-o", str(config)])
    assert done.exit_code == 0, done.output
    assert "places and motion tell" in done.output
    setup = setup_of(load_config(config))
    told = setup.markers.specs
    assert setup.unlisted == ("assign" if len(told) < len(names) else "leave_out")
    wrong = {label: told[name].segment for label, name in names.items() if name in told}
    wrong = {label: segment for label, segment in wrong.items() if segment != segments[label]}
    assert len(wrong) <= 1, wrong
    assert len(told) > 0.6 * len(names)


def test_labels_of_no_set_are_refused(seed: int) -> None:
    """Random names are nobody's; the nearest set and what it lacks are said."""
    random = np.random.default_rng(seed)
    labels = [f"M{k:03d}" for k in random.choice(1000, 40, replace=False)]
    found = recognised(labels)
    assert not found.enough and "nothing tells where 40 labels are" in str(unrecognised(found, "folder"))


def test_too_few_labels_that_say_nothing_are_refused(person: SimulatedSession, tmp_path: Path) -> None:
    """Five of them show no body: the command stops and lists them."""
    for name in TWO:
        trial = person.trial(name).trial
        markers = replace(trial.markers.select(trial.markers.labels[:5]), labels=tuple(f"M{k}" for k in range(5)))
        write_c3d(tmp_path / f"{name}.c3d", replace(trial, markers=markers))
    with pytest.raises(ConfigError, match=r"nothing tells where 5 labels are.*M0.*\[markers\.unrecognised\]"):
        propose(tmp_path)


def test_recordings_without_forces_give_geometry_alone(person: SimulatedSession, tmp_path: Path) -> None:
    """Nothing of inertia is asked for, and one of a kind is held out all the same."""
    folder = tmp_path / "data"
    folder.mkdir()
    for item in (person.trial(name) for name in ALL):
        write_c3d(folder / f"{item.trial.name}.c3d", replace(item.trial, forces=None))
    proposal = propose(folder)
    assert roles(proposal)["squats_3"] == "heldout" and roles(proposal)["static"] == "static"
    (tmp_path / "new.yaml").write_text(config_text(proposal, tmp_path), encoding="utf-8")
    config = load_config(tmp_path / "new.yaml")
    assert not config.inertia.enabled and not any(one.inertia for one in config.trials if one.role != "static")
    assert "no forces: mass and inertia are not identified" in proposal.doubts


def test_run_takes_a_folder(person: SimulatedSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`torchid new` writes and never over another; `torchid run FOLDER` writes and runs; overrides reach it."""
    folder = laid_out(person, tmp_path / "data", TWO)
    monkeypatch.chdir(tmp_path)
    begun: list[Config] = []

    def experiment(config: Config, *_: object) -> SimpleNamespace:
        begun.append(config)
        return SimpleNamespace(quality=None)

    monkeypatch.setattr(run, "run_experiment", experiment)
    monkeypatch.setattr("torchid.report.glance.glance", lambda *_: ())
    assert CliRunner().invoke(app, ["new", str(folder), "-o", "a.yaml", "--mass", "70", "--age", "31"]).exit_code == 0
    assert load_config("a.yaml").subject.mass_kg == 70.0 and load_config("a.yaml").subject.age_years == 31.0
    assert "age_years: as given" in Path("a.yaml").read_text(encoding="utf-8")
    again = CliRunner().invoke(app, ["new", str(folder), "-o", "a.yaml"])
    assert again.exit_code == 2 and "there already" in again.stderr
    done = CliRunner().invoke(app, ["run", str(folder), "geometry.solver=adam", "--sex", "female"])
    assert done.exit_code == 0, done.output
    assert "standing  static" in done.stdout and (tmp_path / "data.yaml").is_file()
    assert begun[0].geometry.solver == "adam" and begun[0].subject.sex == "female"
    for words in (["run", "a.yaml", "--mass", "70"], ["run", str(folder), "--mass", "70"]):
        assert "a config says itself" in CliRunner().invoke(app, words).stderr
    other = laid_out(person, tmp_path / "other" / "data", TWO)
    assert "about other recordings" in CliRunner().invoke(app, ["run", str(other)]).stderr
    assert "must be" in CliRunner().invoke(app, ["new", str(folder), "-o", "b.yaml", "--mass", "2000"]).stderr
    assert not (tmp_path / "b.yaml").exists()
    assert "Make the folder" in CliRunner().invoke(app, ["new", str(folder), "-o", "none/b.yaml"]).stderr


def test_markers_are_recognised_where_a_config_leaves_them_open(person: SimulatedSession, tmp_path: Path) -> None:
    """`markers: auto`, or none, is the set by name."""
    folder = laid_out(person, tmp_path / "data", TWO)
    entry = f"trials: [{{name: arms, file: {json.dumps(str(folder / 'arms.c3d'))}}}]"
    (tmp_path / "a.yaml").write_text(f"subject: {{name: a}}\n{entry}\n")
    setup = setup_of(load_config(tmp_path / "a.yaml"))
    assert setup.markers.name == "simulated"
    assert [note.code for note in setup.notes] == ["markers.auto"]


@pytest.mark.parametrize("folder", FOLDERS)
def test_real_folders_begin_by_themselves(folder: str, tmp_path: Path) -> None:
    """Marker set and standing trial are those that somebody chose by hand."""
    if not (DATA / folder).is_dir():
        pytest.skip(f"{DATA / folder} is not here")
    proposal = propose(DATA / folder)
    markers, static = FOLDERS[folder]
    assert proposal.markers.name == markers
    assert [use.of.name for use in proposal.of("static")] == [static] * (static is not None)
    (tmp_path / "new.yaml").write_text(config_text(proposal, tmp_path), encoding="utf-8")
    assert load_config(tmp_path / "new.yaml").trials
