"""Conditions compared from a small session: shares, files, the page, and what is refused."""

import csv
import json
import re
import runpy
import shutil
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
import small_session as small
import torch
import xarray
import yaml
from playwright.sync_api import sync_playwright
from typer.testing import CliRunner
from whole_runs import write_tables_alone

from torchid.cli import app
from torchid.config import InvalidConfig, dump_config, load_config
from torchid.config.conditions import Condition, EvaluateOptions, GivenCycle
from torchid.contact.options import ContactOptions, OtherContact
from torchid.conventions import GRAVITY
from torchid.devices import Device, SheetFinding, load_device
from torchid.devices.device import SheetValue
from torchid.dynamics.equations_of_motion import body_rows, body_wrenches, dynamic_state
from torchid.errors import ConfigError, DataError, InputError
from torchid.evaluation.evaluate import evaluate, gather, judge
from torchid.evaluation.evaluation import AppliedCorrection, Evaluation
from torchid.evaluation.foreseen import foreseen
from torchid.evaluation.gaps import find_gaps, unweighed
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import all_numbers
from torchid.evaluation.report.page import render_evaluation
from torchid.evaluation.statistics.units import needed_for
from torchid.evaluation.torque_shares.back import lever_arms, low_back, trunk_of
from torchid.evaluation.torque_shares.contacts import feet_of, refuse_twice
from torchid.evaluation.torque_shares.draws import device_deviations
from torchid.evaluation.torque_shares.wearing import Worn, _usable, acting, worn_devices
from torchid.evaluation.trials import condition_trials
from torchid.evaluation.write import write_evaluation
from torchid.storage.results import OutputFolder
from torchid.torque.inverse import joint_torques

SHEET = """
name: hip spring
sources: [made up for a test]
parts:
  - {segment: thigh_l, mass_kg: {value: 1.0, sd: 0.1}, com_m: [0.0, 0.05, -0.2]}
elements:
  - {type: spring, name: hip_l, between: [pelvis, thigh_l], coordinate: hip_l_flexion, stiffness_Nm_rad: 40.0}
  - {type: spring, name: hip_r, between: [pelvis, thigh_r], coordinate: hip_r_flexion, stiffness_Nm_rad: unknown}
"""
NUMBER = re.compile(r"(?<![\w.])[−-]?\d+(?:\.\d+)?(?![\w.]*[A-Za-z])")
"""Numbers that stand for themselves: none inside names such as L5/S1."""
YEAR = re.compile(r"\(?[A-Z][\w&;' .-]*? (?:et al\. )?(?:19|20)\d\d\)?")
CYCLES = tuple(GivenCycle(trial, t, t + 0.6) for trial in ("squats", "trunk") for t in (0.6, 1.3, 2.0, 2.7))


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Device:
    """A spring over one hip that is known, and over the other one that is not."""
    path = tmp_path_factory.mktemp("device") / "exo.yaml"
    path.write_text(SHEET)
    return load_device(path)


def config_of(draws: int = 20, **options: object):
    """The small session's config, two of its trials under a condition each."""
    config = small.outcome().config
    under = {"squats": "without", "trunk": "on"}
    trials = tuple(trial.model_copy(update={"condition": under.get(trial.name)}) for trial in config.trials)
    conditions = {"without": Condition(reference=True), "on": Condition(device="exo")}
    asked = EvaluateOptions(cycles=CYCLES, draws=draws, permutations=199, units="blocks", **options)
    return config.model_copy(update={"trials": trials, "conditions": conditions, "evaluate": asked})


@pytest.fixture(scope="module")
def found(device: Device, tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """An evaluation whose second condition wears the device."""
    config, outcome = config_of(), small.outcome()
    with OutputFolder(tmp_path_factory.mktemp("evaluation") / "out") as folder:
        trials = condition_trials(config, outcome, folder, lambda stage, fraction: None)
        return judge(config, outcome, gather(config, outcome, trials, {"without": None, "on": device}))


def test_human_and_device_share_what_is_demanded(found: Evaluation) -> None:
    """In every cycle; the device takes nothing where none is worn, and k q about the hip where one is."""
    rows, names = found.identified.rows, found.layout.names
    torch.testing.assert_close(rows.human + rows.device, rows.demand, equal_nan=True)
    worn = torch.tensor([name == "on" for name in found.conditions])
    assert float(rows.device[~worn].abs().max()) == 0.0
    hip = names.index("hip_l_flexion")
    torch.testing.assert_close(rows.device[worn][..., hip], -40.0 * rows.angle[worn][..., hip])


def test_an_element_that_nobody_knows_is_left_to_the_human_and_said(found: Evaluation) -> None:
    """Its share is not invented."""
    worn = torch.tensor([name == "on" for name in found.conditions])
    hip = found.layout.names.index("hip_r_flexion")
    assert float(found.identified.rows.device[worn][..., hip].abs().max()) == 0.0
    assert found.worn["on"].left_out == ("hip_r",)
    said = [f"{gap.what}: {gap.why}" for gap in found.gaps]
    assert any("hip_r" in one and "counted as the human's" in one for one in said)
    assert any("hip_r.stiffness" in one for one in said)


def test_what_is_unsure_of_a_device_is_unsure_of_the_human(found: Evaluation) -> None:
    """A stiffer spring leaves the human less, a heavier part asks for more; masses scatter as the plates let them."""
    worn, trial = found.worn["on"], next(t for t in found.trials if t.condition == "on")
    assert worn.parts is not None and worn.parts_draws is not None and len(worn.draws) == 20
    scatter = worn.parts_draws[:, :, 0].sum(1).std()
    assert 0.05 < float(scatter) < 0.5
    fit, motion = found.outcome.fit, trial.followed.motion
    tree, share = fit.model.tree, acting(worn, fit.model.tree, fit.geometry, motion, {})
    (spring,) = worn.device.elements
    stiffer = replace(worn.device, elements=(spring.with_numbers({"stiffness": SheetValue(44.0)}),))
    heavier = worn.parts.clone()
    heavier[tree.index("thigh_l"), 0] += 1.0
    drawn = replace(worn, draws=(stiffer, worn.device), parts_draws=torch.stack([worn.parts, heavier]))
    first, second = device_deviations(drawn, tree, fit.geometry, motion, {})
    torch.testing.assert_close(first, -0.1 * share.torque, rtol=1e-9, atol=1e-9)
    needed = joint_torques(tree, fit.geometry, heavier - worn.parts, motion, ())
    torch.testing.assert_close(second, needed, rtol=1e-9, atol=1e-9)
    assert float(second[:, 2].mean()) == pytest.approx(GRAVITY, rel=0.2)


def test_a_device_that_plates_contradict_is_said(found: Evaluation) -> None:
    """Two kilograms that nobody carried are missed by the plates."""
    parts = torch.zeros_like(found.outcome.phi)
    parts[0, 0] = 2.0
    wrong = replace(found, worn=found.worn | {"on": replace(found.worn["on"], parts=parts)})
    right = replace(found, worn=found.worn | {"on": replace(found.worn["on"], parts=0.0 * parts)})
    assert unweighed(wrong, "on") == pytest.approx(unweighed(right, "on") - 2.0, abs=0.05)
    assert any("plates bear" in gap.why for gap in find_gaps(wrong))
    assert not any("plates bear" in gap.why for gap in find_gaps(right))


@pytest.mark.parametrize("lift_n", [0.0, 30.0])
def test_contacts_bear_the_device_and_not_what_its_supports_give(tmp_path: Path, lift_n: float) -> None:
    """Feet without plates bear a part's weight as well, less what a rope from above lifts of it."""
    path = tmp_path / "exo.yaml"
    part = {"segment": "pelvis", "mass_kg": 4.0, "com_m": [0, 0, 0.1], "inertia_kgm2": [0.01, 0.01, 0.01]}
    lift = {"type": "ground", "name": "lift", "between": ["pelvis", "world"], "from_m": [0, 0, 0.1],
            "to_m": [0, 0, 50], "rail": [1, 0, 0], "force_N": lift_n}  # fmt: skip
    path.write_text(yaml.safe_dump({"name": "weight", "parts": [part], "elements": [lift]}))
    config, outcome = config_of(), small.outcome()
    config = config.model_copy(update={"contact": ContactOptions(torques="predicted")})
    with OutputFolder(tmp_path / "out") as folder:
        (trial,) = (t for t in condition_trials(config, outcome, folder, lambda *_: None) if t.condition == "on")
    bare = replace(trial.followed, contact=None, wrench=None)
    blind = replace(trial, followed=bare, recording=replace(trial.recording, forces=None))
    down = []
    for worn in (Worn(None), Worn(load_device(path))):
        feet = feet_of(config, [blind], outcome.fit, outcome.phi, False, {"on": worn}, {trial.name: {}})[trial.name]
        assert feet is not None
        down.append(feet.wrench[30:-30, :, 2].sum(1).mean())
    assert float(down[1] - down[0]) == pytest.approx(4.0 * GRAVITY - lift_n, abs=3.0)


def test_without_draws_the_findings_are_the_same(found: Evaluation, device: Device, tmp_path: Path) -> None:
    """Bands take most of the time and decide nothing; the page does not claim any."""
    config, outcome = config_of(draws=0), small.outcome()
    with OutputFolder(tmp_path / "out") as folder:
        trials = condition_trials(config, outcome, folder, lambda stage, fraction: None)
        plain = judge(config, outcome, gather(config, outcome, trials, {"without": None, "on": device}))
    one, other = (each.identified.comparisons[0].tested.adjusted for each in (plain, found))
    torch.testing.assert_close(one, other, equal_nan=True, rtol=0, atol=0)
    page = render_evaluation(plain, Ledger(all_numbers(plain)))
    assert plain.identified.rows.draws is None and "none was drawn" in page
    assert "no draws were asked for" in page and "bodies that the recordings allow" not in page


def test_blocks_are_said_to_take_something_for_granted(found: Evaluation) -> None:
    """One trial per condition cannot tell what trials have in common."""
    assert any("takes for granted" in gap.why for gap in found.gaps)


def test_the_page_begins_with_whether_it_helps(found: Evaluation) -> None:
    """One sentence; where trials are too few it says what is needed, claims no error rate and shows no effect size."""
    page = shown_text(render_evaluation(found, Ledger(all_numbers(found))))
    first = page.partition("Summary")[2].partition("Condition")[0]
    assert "Does \u201con\u201d help?" in first
    few = tuple(replace(one, needed=needed_for(one.units, 0.2, 199, 0.05)) for one in found.comparisons)
    few_found = replace(found, identified=replace(found.identified, comparisons=few))
    page = shown_text(render_evaluation(few_found, Ledger(all_numbers(few_found))))
    first = page.partition("Summary")[2].partition("Condition")[0]
    assert "Not testable" in first and "are the least that can" in first and "family-wise" not in first


def test_what_the_diagnosis_corrected_is_listed(found: Evaluation, tmp_path: Path) -> None:
    """On the first page by name, behind it in full, and in the JSON."""
    gain = AppliedCorrection(
        "Gain of plate 1", "Plate 1 reads 0.936 times the force.", "plate_gain", ("1",), 0.97, ("squats",)
    )
    rests = replace(found, corrections=(gain,))
    with OutputFolder(tmp_path / "out") as folder:
        write_evaluation(rests, folder)
    text = shown_text((tmp_path / "out" / "evaluation.html").read_text())
    assert "Rests on 1 correction by the diagnosis: Gain of plate 1." in text
    assert "Plate 1 reads 0.936 times the force. Probability 97 %." in text
    held = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert held["corrections"][0]["what"] == gain.what and held["corrections"][0]["where"] == ["1"]


@pytest.mark.parametrize(("trials", "conditions", "said"), [(3, 1, "4 trials"), (4, 1, ""), (4, 2, "5 trials")])
def test_trials_too_few_for_any_finding_are_said_by_check(
    tmp_path: Path, trials: int, conditions: int, said: str
) -> None:  # fmt: skip
    """Before anything is computed; two conditions share the level."""
    names = ["without", *(f"on{k}" for k in range(conditions))]
    listed = [{"name": f"{n}{k}", "file": "a.c3d", "condition": n} for n in names for k in range(trials)]
    under = {name: {"reference": name == "without"} for name in names}
    notes = list(foreseen(load_config(written(tmp_path, trials=listed, conditions=under))))
    assert len(notes) == (conditions if said else 0)
    assert all(said in one.message and one.code == "evaluate.untestable" for one in notes)


def shown_text(page: str) -> str:
    """What a reader reads, without drawings, styles and entities."""
    body = re.sub(r"<(svg|style|head)\b.*?</\1>", " ", page, flags=re.DOTALL)
    return re.sub(r"<[^>]+>", " ", body).replace("\N{NO-BREAK SPACE}", " ").replace("&#39;", "'").replace("&amp;", "&")


def test_every_number_of_the_page_is_in_the_csv(found: Evaluation, tmp_path: Path) -> None:
    """As it is shown, and its value beside it; none is in the CSV alone under a wrong text."""
    with OutputFolder(tmp_path / "out") as folder:
        write_evaluation(found, folder)
    rows = list(csv.DictReader(StringIO((tmp_path / "out" / "evaluation.csv").read_text())))
    told = {number for row in rows for number in NUMBER.findall(row["shown"])}
    text = shown_text((tmp_path / "out" / "evaluation.html").read_text())
    body = YEAR.sub(" ", text.partition("Summary")[2])
    missing = [number for number in NUMBER.findall(body) if number not in told]
    assert not missing, missing
    assert len(NUMBER.findall(body)) > 300
    for row in rows:
        if row["value"] and row["shown"] and row["statistic"] not in ("text",):
            values = [float(one.replace("−", "-")) for one in row["shown"].split("; ")]
            assert any(abs(abs(v) - f * abs(float(row["value"]))) <= 0.51 for v in values for f in (1.0, 100.0)), row


def test_a_number_that_nobody_recorded_would_be_noticed(found: Evaluation) -> None:
    """The report cannot show what the ledger does not have."""
    ledger = Ledger(all_numbers(found))
    with pytest.raises(KeyError):
        ledger.show(Key("measure", "invented"))


def test_a_foot_without_a_cycle_is_said(found: Evaluation) -> None:
    """Once for all its coordinates, of the condition that lacks it."""
    cycles = tuple(replace(cycle, side="l") if found.conditions[k] == "on" else cycle for k, cycle in
                   enumerate(found.cycles))  # fmt: skip
    said = [gap for gap in find_gaps(replace(found, cycles=cycles)) if "no cycle of that foot" in gap.why]
    assert len(said) == 1 and "hip_r_flexion" in said[0].what and said[0].what.endswith("in on")


def test_a_sheet_that_recordings_contradict_is_said_first(found: Evaluation, tmp_path: Path) -> None:
    """On the first page, in the list of gaps, and in the JSON; what is right, or cannot be tested, is none."""
    weak = SheetFinding("stiffness", "hip_l.stiffness_Nm_rad", True, 200.0, 141.0, 3.0, -11.0)
    place = SheetFinding("carried_elsewhere", "box", True, "thigh_l", "pelvis", z=40.0)
    rest = SheetFinding("unexplained", "hip_l", True, 0.0, 0.23, why="friction")
    right, blind = replace(weak, wrong=False), SheetFinding("rest", "hip_l.rest_rad", False, 0.1, None, why="no sensor")
    worn = replace(found.worn["on"], findings=(weak, right, place, rest, blind))
    wrong = replace(found, worn=found.worn | {"on": worn})
    wrong = replace(wrong, gaps=find_gaps(wrong))
    said = [f"{gap.what}: {gap.why}" for gap in wrong.gaps[:3]]
    assert "the sheet says 200, the recordings 141 (sd 3)" in said[0] and "identified" in said[0]
    assert "the sheet says thigh_l, the recordings pelvis" in said[1] and said[2].startswith("23% of what hip_l")
    assert len(wrong.gaps) == len(found.gaps) + 3 - sum(one.wrong for one in found.worn["on"].findings)
    with OutputFolder(tmp_path / "out") as folder:
        write_evaluation(wrong, folder)
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "the sheet says 200" in page.partition('id="summary"')[2].partition('id="differences"')[0]
    held = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert [one["wrong"] for one in held["sheet"]["on"]] == [True, False, True, True, False]


def test_what_a_contradicted_sheet_is_used_for_is_said(found: Evaluation) -> None:
    """A sensor's reading is the share whatever the sheet says; places and slides are no number to leave open."""
    findings = (
        SheetFinding("stiffness", "hip_l.stiffness_Nm_rad", True, 200.0, 141.0, 3.0, -11.0),
        SheetFinding("stiffness", "hip_r.stiffness_Nm_rad", True, 200.0, 141.0, 3.0, -11.0),
        SheetFinding("strap_slides", "hip_l.rest_rad in trunk", True, 0.1, 0.2, 0.01, 9.0),
        SheetFinding("carried_elsewhere", "box", True, "thigh_l", "pelvis", z=40.0),
        SheetFinding("unexplained", "hip_l", True, 0.0, 0.23, why="friction"),
    )
    worn = replace(found.worn["on"], findings=findings, read=("hip_l",))
    said = [gap.why for gap in find_gaps(replace(found, worn=found.worn | {"on": worn}))[:5]]
    assert "share is what its sensor read" in said[0] and "sheet's number" not in said[0]
    assert "computed with the sheet's number" in said[1] and "`unknown` in its place" in said[1]
    assert "condition with a sheet of its own" in said[2] and "unknown" not in said[2]
    assert "write that segment" in said[3] and "part on thigh_l" in said[3]
    assert "fitted anew" in said[4] and "law of its sheet" not in said[4]


def test_a_sensor_that_lost_a_frame_stands_for_no_number(found: Evaluation, device: Device) -> None:
    """The gap says that it needs all frames; one that reads zero throughout reads nothing."""
    (hip,) = (one for one in device.elements if one.name == "hip_r")
    sensed = replace(device, elements=(replace(hip, sensor=replace(hip.sensor, force="read")),))
    whole = torch.ones(5, dtype=torch.float64)
    lost = torch.where(torch.arange(5) == 2, torch.nan, whole)
    for values, kept, read in ((whole, 1, ("hip_r",)), (lost, 0, ()), (0.0 * whole, 0, ())):
        worn = _usable(sensed, {"trunk": {"read": values}})
        assert worn.device is not None and len(worn.device.elements) == kept and worn.read == read
        assert worn.left_out == (() if kept else ("hip_r",))
    gaps = find_gaps(replace(found, worn=found.worn | {"on": worn}))
    assert any("reads in all of its frames" in gap.why and "hip_r" in gap.what for gap in gaps)


def test_files_hold_what_the_contract_says(found: Evaluation, tmp_path: Path) -> None:
    """Keys of evaluation.json, and courses of every cycle with both bodies."""
    with OutputFolder(tmp_path / "out") as folder:
        write_evaluation(found, folder)
    held = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    peak = held["joints"]["hip_l_flexion"]["on"]["peak_torque_Nm"]
    assert set(peak) >= {"value", "sd", "low", "high"} and peak["value"] > 0.0
    assert {"differences", "device", "template", "not_determinable", "test"} <= set(held)
    assert set(held["differences"][0]) >= {"condition", "where", "measure", "low", "high", "p", "p_adjusted", "found"}
    assert set(held["template"]) == {"joints", "differences"}
    data = xarray.open_dataset(tmp_path / "out" / "cycles_on.nc", engine="h5netcdf")
    assert dict(data.sizes) | {"percent": 101, "cycle": 4} == dict(data.sizes)
    human = data.demand.values - data.device.values
    torch.testing.assert_close(torch.as_tensor(data.human.values), torch.as_tensor(human), equal_nan=True)
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert not re.search(r'(?:src|href)="(?!#)|url\((?!#)', page) and "<script" not in page


def test_per_mass_and_other_conventions(device: Device, tmp_path: Path) -> None:
    """Torques are divided by the mass, names and signs are OpenSim's, p-values stay."""
    asked = config_of(0, per_mass=True, convention="opensim", joints=("hip_flexion", "lower_spine_flexion", "tail"))
    plain = config_of(0, joints=("hip_flexion", "lower_spine_flexion"))
    outcome, results = small.outcome(), []
    with OutputFolder(tmp_path / "out") as folder:
        for config in (plain, asked):
            trials = condition_trials(config, outcome, folder, lambda stage, fraction: None)
            results.append(judge(config, outcome, gather(config, outcome, trials, {"without": None, "on": device})))
    first, second = results
    assert second.layout.names == ("hip_flexion_l", "hip_flexion_r", "lumbar_extension")
    mass = second.per_mass_kg
    assert mass == pytest.approx(float(outcome.phi[:, 0].sum()))
    a, b = (one.identified.rows.human[..., :3] for one in (first, second))
    torch.testing.assert_close(a[..., 2], -mass * b[..., 2], equal_nan=True)
    torch.testing.assert_close(a[..., 0], mass * b[..., 0], equal_nan=True)
    assert any(gap.what == "tail" for gap in second.gaps)


def test_the_moment_at_l5_s1_is_that_of_what_it_carries() -> None:
    """Sum over trunk, head and arms of their inertial and gravity wrenches about the joint, in the pelvis' axes."""
    outcome = small.outcome()
    tree, geometry, phi = outcome.fit.model.tree, outcome.fit.geometry, outcome.phi
    motion = outcome.followed["trunk"].motion
    back = low_back(tree, geometry, phi, motion)
    assert back is not None and trunk_of(tree) == "abdomen"
    state = dynamic_state(tree, geometry, *(x.T.contiguous() for x in (motion.q, motion.v, motion.a)))
    own = [state.plan.position[k] for k in tree.subtree(tree.index("abdomen"))]
    total = body_wrenches(state.plan, body_rows(state), phi)[own].sum(0)
    joint = state.at.p[state.plan.position[tree.index("abdomen")]] - state.at.p[0]
    M_W = total[3:] - torch.linalg.cross(joint, total[:3], dim=0)
    M_P = torch.einsum("crf,rf->fc", state.at.R[0], M_W)
    found = back.moment(outcome.torque["trunk"])
    torch.testing.assert_close(found, torch.stack([-M_P[:, 1], M_P[:, 0], M_P[:, 2]], 1), rtol=1e-6, atol=1e-6)
    lever = torch.tensor(0.06, dtype=torch.float64)
    press = back.compression(outcome.torque["trunk"], lever)
    torch.testing.assert_close(press, found[:, 0].abs() / 0.06 + back.force)
    arms = lever_arms((0.05, 0.075), 1000, phi, 0)
    assert 0.05 <= float(arms.min()) and float(arms.max()) <= 0.075


BODY = {"subject": {"name": "a"}, "markers": "opencap", "out": "out"}


def written(folder: Path, **changes: object) -> Path:
    """A config with two trials and two conditions, some keys replaced."""
    (folder / "a.c3d").write_text("")
    trials = [{"name": n, "file": "a.c3d", "condition": c} for n, c in (("one", "without"), ("two", "on"))]
    document = {**BODY, "trials": trials, "conditions": {"without": {"reference": True}, "on": {}}, **changes}
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.mark.parametrize(
    ("override", "code"),
    [
        ("trials.1.condition=onn", "config.unknown_condition"),
        ("conditions.without.reference=false", "config.no_reference"),
        ("conditions.on.reference=true", "config.no_reference"),
        ("trials.1.condition=without", "config.empty_condition"),
        ("conditions.on.device=exo.yaml", "config.missing_file"),
        ("trials.1.channels=motor.csv", "config.missing_file"),
        ("conditions.on.devise=exo", "config.unknown_key"),
        ("evaluate.cycles=[{trial: one, t0: 2.0, t1: 1.0}]", "evaluate.cycle"),
        ("evaluate.lever_arm_m=[0.07, 0.05]", "evaluate.lever_arm"),
        ("evaluate.shortest_s=20.0", "evaluate.duration"),
        ("evaluate.draws=3", "evaluate.draws"),
        ("evaluate.measures=[peek_torque_Nm]", "config.unknown_value"),
    ],
)
def test_a_config_that_compares_nothing_sensible_is_refused(tmp_path: Path, override: str, code: str) -> None:
    """With a code of its own, the place and what to do."""
    with pytest.raises(InvalidConfig) as caught:
        load_config(written(tmp_path), [override])
    assert caught.value.code == code and caught.value.remedy


def test_worn_trials_tell_nothing_of_the_body(tmp_path: Path) -> None:
    """Those with a device are left out of the run, those of other conditions stay."""
    (tmp_path / "exo.yaml").write_text(SHEET)
    config = load_config(written(tmp_path), ["conditions.on.device=exo.yaml"])
    assert [trial.name for trial in config.body.trials] == ["one"]
    assert [trial.name for trial in load_config(written(tmp_path)).body.trials] == ["one", "two"]
    assert config.body.conditions == {} and config.body.trials[0].condition is None


def test_the_bodys_config_can_be_read_again_where_a_worn_trial_has_a_contact(tmp_path: Path) -> None:
    """Intervals of trials with a device go with them; a contact that has no others never bears."""
    (tmp_path / "exo.yaml").write_text(SHEET)
    rail = {"segment": "hand_r", "when": {"two": [[0.1, 0.2]]}}
    both = {"segment": "hand_l", "when": {"one": [[0.3, 0.4]], "two": [[0.1, 0.2]]}}
    path = written(tmp_path, contact={"others": {"rail": rail, "both": both}})
    config = load_config(path, ["conditions.on.device=exo.yaml"])
    path.write_text(dump_config(config.body))
    again = load_config(path)
    assert again == config.body
    assert [again.contact.others[name].when for name in ("rail", "both")] == [{}, {"one": ((0.3, 0.4),)}]
    assert config.contact.others["rail"].when == {"two": ((0.1, 0.2),)}


def test_a_torque_that_a_declared_contact_hides_is_said_to_be_its_own(found: Evaluation) -> None:
    """Feet are not blamed alone for a hand that nothing measured, and L5/S1 is said to count it."""
    rail = ContactOptions(others={"rail": OtherContact("hand_r", "always")})
    sample = found.identified.sample
    lost = replace(sample, values=torch.full_like(sample.values, torch.nan))
    held = replace(found, identified=replace(found.identified, sample=lost))
    why = [gap.why for gap in find_gaps(held) if gap.what.startswith("torque of ")]
    assert why and all("a foot stood beside" in one and "rail" not in one for one in why)
    held = replace(held, config=found.config.model_copy(update={"contact": rail}))
    why = [gap.why for gap in find_gaps(held) if gap.what.startswith("torque of ")]
    assert why and all("no plate measured rail" in one for one in why)
    assert any("declared contacts" in gap.why for gap in find_gaps(held) if "L5/S1" in gap.what)


def test_nothing_to_compare_is_refused(tmp_path: Path) -> None:
    """One condition, or none, is no comparison."""
    config = load_config(written(tmp_path, conditions={}, trials=[{"name": "one", "file": "a.c3d"}]))
    with pytest.raises(ConfigError) as caught:
        evaluate(config)
    assert caught.value.code == "evaluate.no_conditions"


@pytest.mark.parametrize(
    ("contact", "refused"),
    [
        (OtherContact("hand_l", plate=3), True),
        (OtherContact("hand_l", plate=3, when={"two": ((0.0, 1.0),)}), True),
        (OtherContact("hand_l", plate=3, when={"one": ((0.0, 1.0),)}), False),
        (OtherContact("hand_l", when="always"), False),
        (OtherContact("hand_r", plate=3), False),
    ],
)
def test_one_rail_is_no_two_supports(tmp_path: Path, contact: OtherContact, refused: bool) -> None:
    """A hand whose handle is the device's is measured by no plate under the same condition."""
    hand = {"type": "ground", "name": "walker", "between": ["hand_l", "world"], "from_m": [0, 0, -0.05],
            "channels": ["x", "y", "z"]}  # fmt: skip
    (tmp_path / "exo.yaml").write_text(yaml.safe_dump({"name": "walker", "elements": [hand]}))
    config = load_config(written(tmp_path), ["conditions.on.device=exo.yaml"])
    config = config.model_copy(update={"contact": ContactOptions(others={"rail": contact})})
    devices = worn_devices(config)
    if not refused:
        refuse_twice(config, devices)
        return
    with pytest.raises(ConfigError) as caught:
        evaluate(config)
    assert caught.value.code == "evaluate.support" and "walker" in caught.value.found


def test_conditions_without_cycles_channels_or_motion_are_refused(device: Device, tmp_path: Path) -> None:
    """Each with its code, before any test is made."""
    outcome, devices = small.outcome(), {"without": None, "on": device}
    config = config_of()
    with OutputFolder(tmp_path / "out") as folder:
        trials = condition_trials(config, outcome, folder, lambda stage, fraction: None)
    empty = config.model_copy(update={"evaluate": replace(config.evaluate, cycles=CYCLES[:4])})
    with pytest.raises(DataError) as caught:
        gather(empty, outcome, trials, devices)
    assert caught.value.code == "evaluate.no_cycles"
    (tmp_path / "motor.csv").write_text("time,torque\n0,1\n1,2\n")
    on = replace(config.conditions["on"], channels={"motor": "current"})
    files = tuple(trial.model_copy(update={"channels": tmp_path / "motor.csv"}) for trial in config.trials)
    lacking = config.model_copy(update={"trials": files, "conditions": {**config.conditions, "on": on}})
    with pytest.raises(InputError) as caught:
        gather(lacking, outcome, trials, devices)
    assert caught.value.code == "evaluate.channel"
    still = tuple(replace(t, recording=replace(t.recording, role="static")) for t in trials)
    with pytest.raises(InputError) as caught:
        gather(config, outcome, still, devices)
    assert caught.value.code == "evaluate.static"


@pytest.mark.slow
def test_the_summary_fills_one_printed_page(found: Evaluation, tmp_path: Path) -> None:
    """On A4 between the margins of the style sheet, in a browser that complains of nothing."""
    if shutil.which("chromium") is None:
        pytest.skip("no chromium on this machine")
    page = tmp_path / "evaluation.html"
    page.write_text(render_evaluation(found, Ledger(all_numbers(found))))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        view, complaints = browser.new_page(viewport={"width": 695, "height": 1017}), []
        view.on("console", lambda message: complaints.append(message.text))
        view.goto(page.as_uri())
        view.emulate_media(media="print")
        bottom, wide = view.evaluate(
            "[document.querySelector('#summary').getBoundingClientRect().bottom, document.body.scrollWidth]"
        )
        browser.close()
    assert bottom <= 1017 and wide <= 700 and not complaints


@pytest.mark.slow
def test_a_hidden_device_is_found_from_files(
    tmp_path: Path, seed: int, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """`torchid evaluate` on a simulated session: a spring at a joint drawn by lot lowers that joint's load."""
    generator = torch.Generator().manual_seed(seed)
    joint = ("hip", "knee")[int(torch.randint(2, (1,), generator=generator))]
    above, below = {"hip": ("pelvis", "thigh"), "knee": ("thigh", "shank")}[joint]
    springs = [
        {"type": "spring", "name": s, "between": [above if above == "pelvis" else f"{above}_{s}", f"{below}_{s}"],
         "coordinate": f"{joint}_{s}_flexion", "stiffness_Nm_rad": 30.0} for s in "lr"
    ]  # fmt: skip
    (tmp_path / "exo.yaml").write_text(yaml.safe_dump({"name": "springs", "elements": springs}))
    document = {
        "subject": {"name": "S"}, "markers": "simulated", "seed": seed % 1000, "out": str(tmp_path / "out"),
        "simulate": {"fit": ["arms", "trunk"], "heldout": [], "conditions": ["squats"] * 4, "duration_s": 4.0},
        "conditions": {"without": {"reference": True}, "on": {"device": "exo.yaml"}},
        "evaluate": {"cycles": {"coordinate": "pelvis_z"}, "joints": [f"{joint}_flexion"], "draws": 20},
        "geometry": {"max_frames": 200}, "diagnosis": {"enabled": False},
    }  # fmt: skip
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(document))
    done = CliRunner().invoke(app, ["evaluate", str(tmp_path / "config.yaml")])
    assert done.exit_code == 0, done.output
    held = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    rows = [r for r in held["differences"] if r["measure"] == "cumulative_load_Nms"]
    assert len(rows) == 2 and all(r["value"] < 0.0 for r in rows)
    assert any(r["found"] for r in held["differences"] if r["where"].startswith(joint)), rows
    for name in ("evaluation.csv", "evaluation.html", "cycles_without.nc", "cycles_on.nc", "report.html"):
        assert (tmp_path / "out" / name).is_file()
    script = runpy.run_path(str(Path(__file__).resolve().parents[1] / "scripts" / "evaluate_device.py"))
    with pytest.MonkeyPatch.context() as patch:  # files are there, and bands are
        write_tables_alone(patch)
        given = ["--config", str(tmp_path / "config.yaml"), "--joint", f"{joint}_l_flexion"]
        script["main"]([*given, "evaluate.draws=0"])
    assert "adjusted" in capsys.readouterr().out
