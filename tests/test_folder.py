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
from torchid.folder.people import Person, stature_of, told_of
from torchid.folder.proposal import Proposal, propose
from torchid.folder.survey import STATED, names_of, survey
from torchid.io.c3d_write import write_c3d
from torchid.model.label_words import told_by_words
from torchid.model.marker_set import load_marker_set, marker_sets
from torchid.model.recognition import recognise
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
    assert told.contradictions == (
        "mass_kg is 71.5 (arms.c3d) and 80 (_subject.json)", "height_m is 1.7 (as given) and 1.8 (_subject.json)",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "text", "known"),
    [
        ("sessionMetadata.yaml", "mass_kg: 62.6\nheight_m: 1.68\ngender_mf: x\n", (62.6, 1.68, None)),
        ("Anna.mp", "$Bodymass = 58.2\n$Height = 1643\n", (58.2, 1.643, None)),
        ("participants.tsv", "participant_id\tsex\tweight\theight\nsub-01\tM\t81\t183\n", (81.0, 1.83, "male")),
        ("x_Setup_Scale.xml", "<OpenSimDocument><ScaleTool><mass> 72.6 </mass><height> 1803.4 </height></ScaleTool>"
         "</OpenSimDocument>", (72.6, 1.8034, None)),
        ("subject.json", "{broken", (None, None, None)),
        ("reference.json", '{"massKg": 62.88}', (None, None, None)),
        ("participants.tsv", "participant_id\tweight\nsub-01\t81\nsub-02\t60\n", (None, None, None)),
    ],
)  # fmt: skip
def test_facts_are_read_from_files_of_several_programs(name: str, text: str, known: tuple, tmp_path: Path) -> None:
    """Each in its units; files of other contents, of several people or damaged ones say nothing."""
    (tmp_path / name).write_text(text)
    person = told_of(tmp_path, (), Person()).person
    assert (person.mass_kg, person.sex) == (known[0], known[2])
    assert person.height_m == (known[1] if known[1] is None else pytest.approx(known[1]))


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
    assert found["cut"].role == "" and str(folder / "cut.c3d") in found["cut"].why
    assert found["wand"].role == "" and "0 of its 3 markers" in found["wand"].why
    assert found["bare"].role == "fit" and not found["bare"].inertia and "geometry alone" in found["bare"].why
    text = config_text(proposal, tmp_path)
    (tmp_path / "new.yaml").write_text(text, encoding="utf-8")
    assert "cut" not in {trial.name for trial in load_config(tmp_path / "new.yaml").trials}
    assert "# left out, " in text


def test_a_folder_of_standing_alone_is_refused(person: SimulatedSession, tmp_path: Path) -> None:
    """Nothing moves, so nothing can be fitted; the refusal says what each recording shows."""
    write_c3d(tmp_path / "static.c3d", person.trials[0].trial)
    with pytest.raises(DataError, match="static: stands still"):
        propose(tmp_path)


def test_recordings_get_names_of_their_own(tmp_path: Path) -> None:
    """By files, where those are alike by folders, where those are too by the whole path."""
    files = [tmp_path / "trials" / name / "markers.trc" for name in ("run 2", "run 3")]
    assert names_of(files, tmp_path) == ["run_2", "run_3"]
    files = [tmp_path / day / "walk" / "markers.trc" for day in ("d1", "d2")]
    assert names_of(files, tmp_path) == ["d1_walk_markers.trc", "d2_walk_markers.trc"]
    assert names_of([tmp_path / "walk1_markers.trc", tmp_path / "static.trc"], tmp_path) == ["walk1", "static"]


@pytest.mark.parametrize("name", marker_sets())
def test_a_set_is_recognised_by_its_labels(name: str, seed: int) -> None:
    """Also by four in five of them, spelt otherwise, under a prefix; or one that lists just as many is."""
    random = np.random.default_rng(seed)
    specs = load_marker_set(name).specs
    some = [label for label, one in specs.items() if one.segment == "pelvis" or random.random() < 0.8]
    spelt = [f"Anna:{label.upper().replace('_', ' ')}" for label in some]
    found = recognise(spelt)
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


def test_labels_of_no_set_are_refused(seed: int) -> None:
    """Random names are nobody's; the nearest set and what it lacks are said."""
    random = np.random.default_rng(seed)
    labels = [f"M{k:03d}" for k in random.choice(1000, 40, replace=False)]
    with pytest.raises(ConfigError, match="nothing tells where 40 labels are"):
        recognise(labels, "folder")


def test_run_takes_a_folder(person: SimulatedSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`torchid new` writes and never over another; `torchid run FOLDER` writes and runs; overrides reach it."""
    folder = laid_out(person, tmp_path / "data", TWO)
    monkeypatch.chdir(tmp_path)
    begun: list[Config] = []

    def experiment(config: Config, *_: object) -> SimpleNamespace:
        begun.append(config)
        return SimpleNamespace(quality=None)

    monkeypatch.setattr(run, "run_experiment", experiment)
    assert CliRunner().invoke(app, ["new", str(folder), "-o", "a.yaml", "--mass", "70"]).exit_code == 0
    assert load_config("a.yaml").subject.mass_kg == 70.0
    again = CliRunner().invoke(app, ["new", str(folder), "-o", "a.yaml"])
    assert again.exit_code == 2 and "there already" in again.stderr
    done = CliRunner().invoke(app, ["run", str(folder), "geometry.solver=adam", "--sex", "female"])
    assert done.exit_code == 0, done.output
    assert "standing  static" in done.stdout and (tmp_path / "data.yaml").is_file()
    assert begun[0].geometry.solver == "adam" and begun[0].subject.sex == "female"
    assert CliRunner().invoke(app, ["run", "a.yaml", "--mass", "70"]).exit_code == 2


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
