"""A study of several subjects: what is tested over them, its files, its page, and what is refused or left out."""

import csv
import json
import re
import shutil
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch
import xarray
import yaml
from playwright.sync_api import sync_playwright
from scipy import stats
from test_evaluation import NUMBER, YEAR, shown_text
from typer.testing import CliRunner

from torchid.cli import app
from torchid.config import Config, InvalidConfig, Study, load_evaluation
from torchid.config.study import Member
from torchid.errors import ConfigError, DataError, InputError, TorchidError
from torchid.evaluation.compared import Gap
from torchid.evaluation.statistics.effects import hedges_paired
from torchid.evaluation.statistics.units import least_subjects, needed_for, subject_units
from torchid.evaluation.study.study import pool, subjects_of
from torchid.evaluation.study.subject import read_subject
from torchid.evaluation.study.write import FILES, evaluate_study
from torchid.storage.files import write_json
from torchid.storage.netcdf import write_netcdf

MEASURE, POINTS = "peak_torque_Nm", 21
JOINTS = ("hip_l_flexion", "knee_l_flexion", "ankle_l_flexion")


def folder(out: Path, name: str, changes: dict[str, dict[str, float | None]], **other: object) -> Path:
    """The files that a finished evaluation leaves; changes by condition and joint, its template's a tenth larger."""
    rng = np.random.default_rng(sum(name.encode()))
    conditions = ("without", *changes)
    values = {j: {"without": 40.0} | {c: 40.0 + (own[j] or 0.0) for c, own in changes.items() if j in own}
              for j in JOINTS if any(j in own for own in changes.values())}  # fmt: skip

    def answer(scale: float) -> dict:
        joints = {
            j: {c: {MEASURE: {"value": v * scale, "sd": 1.0, "low": v * scale - 2.0, "high": v * scale + 2.0}}
                for c, v in own.items()} for j, own in values.items()
        }  # fmt: skip
        joints["L5/S1"] = {
            c: {"peak_compression_N": {"value": 3300.0 + 200.0 * k, "sd": 1.0, "low": None, "high": None}}
            for k, c in enumerate(conditions)
        }
        rows = [
            {"condition": c, "where": j, "measure": MEASURE, "value": None if v is None else v * scale,
             "low": None if v is None else v * scale - 3.0, "high": None if v is None else v * scale + 3.0}
            for c, own in changes.items() for j, v in own.items()
        ]  # fmt: skip
        back = [{"condition": c, "where": "L5/S1", "measure": "peak_compression_N", "value": 200.0 * (k + 1),
                 "low": None, "high": None} for k, c in enumerate(changes)]  # fmt: skip
        return {"joints": joints, "differences": rows + back}

    worn = {c: {"device": None if c == "without" else "spring"} for c in conditions}
    write_json(out / "evaluation.json", {
        "subject": name, "reference": "without", "conditions": worn, "convention": "torchid", "per_mass_kg": None,
        "signs": "torchid", "template_is": "scaled template",
        **answer(1.0), "template": answer(1.1),
        "not_determinable": [{"what": "hands", "why": f"{name} holds 3 things"}],
    } | other)  # fmt: skip
    shape = np.sin(np.pi * np.linspace(0.0, 1.0, POINTS))[None, :, None]
    for c in conditions:
        own = np.array([v.get(c, np.nan) for v in values.values()])
        demand = shape * own + 0.01 * rng.normal(size=(3, POINTS, len(own)))
        device = 0.25 * demand * (c != "without")
        by = ("cycle", "percent", "course")
        data = {n: (by, x) for n, x in (("human", demand - device), ("demand", demand), ("device", device),
                                        ("human_template", 1.1 * demand))}  # fmt: skip
        coords = {"course": [f"{j} torque_Nm" for j in values], "percent": np.linspace(0.0, 100.0, POINTS),
                  "trial": ("cycle", ["a", "a", "b"]), "side": ("cycle", ["", "", ""]),
                  "duration": ("cycle", [1.0, 1.2, 1.1])}  # fmt: skip
        write_netcdf(out / f"cycles_{c}.nc", [xarray.Dataset(data, coords)])
    return out


def study_of(tmp_path: Path, subjects: dict[str, dict[str, dict[str, float | None]]], **options: object) -> Study:
    """A study over folders that are written first."""
    folders = []
    for name, changes in subjects.items():
        (tmp_path / name).mkdir(exist_ok=True)
        folders.append({"out": str(folder(tmp_path / name, name, changes))})
    path = tmp_path / "study.yaml"
    path.write_text(yaml.safe_dump({"name": "springs", "subjects": folders, "out": "study", **options}))
    found = load_evaluation(path)
    assert isinstance(found, Study)
    return found


def drawn(seed: int, count: int = 8) -> dict[str, dict[str, dict[str, float | None]]]:
    """Subjects whose hips are lower, whose knees change as it comes, two of whom have no ankle."""
    rng = np.random.default_rng(seed)
    return {
        f"S{k}": {"spring": {
            JOINTS[0]: float(rng.normal(-8.0, 1.0)), JOINTS[1]: float(rng.choice([-1, 1]) * (0.5 + rng.random())),
            **({} if k < 2 else {JOINTS[2]: float(-3.0 - rng.random())}),
        }} for k in range(count)
    }  # fmt: skip


def test_a_change_that_all_subjects_share_is_found(tmp_path: Path, seed: int) -> None:
    """With both bodies, over the whole course too; a measure that two subjects lack is tested over the others."""
    study = study_of(tmp_path, drawn(seed))
    found = pool(study, subjects_of(study, lambda stage, fraction: None)[0])
    (one,) = found.comparisons
    assert [c.where for c in one.columns[:3]] == [JOINTS[0], JOINTS[1], "L5/S1"] and one.least_p == 2 / 256
    own = one
    assert 0 in own.found(0.05) and float(own.difference.high[0]) < 0.0 and own.agreeing[0] == (8, 8)
    ankle = [c.where for c in one.columns].index(JOINTS[2])
    assert own.agreeing[ankle] == (6, 6) and float(own.tested.p[ankle]) == 2 / 64
    plain = found.template[0].difference.value
    torch.testing.assert_close(plain[[0, ankle]], 1.1 * own.difference.value[[0, ankle]])
    hip = one.tested.points[:, [c.where for c in one.courses].index(JOINTS[0])]
    assert float(hip[POINTS // 2]) <= 0.05
    assert any("S0 and S1" in gap.why and JOINTS[2] in gap.what for gap in found.gaps)


@pytest.mark.slow
def test_signs_of_subjects_are_wrong_as_rarely_as_they_say(tmp_path: Path, seed: int) -> None:
    """Measures and courses of six subjects without an effect: a finding in at most 5 % of 200, within chance."""
    rng, wrong = np.random.default_rng(seed), 0
    study = study_of(tmp_path, drawn(seed, 6))
    subjects, _ = subjects_of(study, lambda stage, fraction: None)
    for k in range(200):
        for one in subjects:
            common = rng.normal()
            for key, own in one.differences.items():
                one.differences[key] = own.__class__(common + rng.normal(), own.low, own.high)
            for courses in one.courses.values():
                size = torch.as_tensor(common + rng.normal(size=(1, len(courses.columns))))
                courses.mean["human"] = size + torch.as_tensor(0.3 * rng.normal(size=(POINTS, len(courses.columns))))
        again = pool(study.model_copy(update={"seed": k}), subjects)
        wrong += bool(again.comparisons[0].found(0.05) or again.comparisons[0].found_courses(0.05))
    assert wrong <= stats.binom.ppf(1 - 1e-5, 200, 0.05)


def test_too_few_subjects_find_nothing_and_are_told_how_many_do(tmp_path: Path, seed: int) -> None:
    """Five cannot reach 5 %, and seven are needed for two conditions; the differences are given all the same."""
    assert [least_subjects(x) for x in (0.05, 0.025, 0.0625)] == [6, 7, 5]
    study = study_of(tmp_path, drawn(seed, 5))
    found = pool(study, subjects_of(study, lambda stage, fraction: None)[0])
    own = found.comparisons[0]
    assert not own.found(0.9999) and bool(own.difference.value.isfinite().all())
    assert any("6 subjects are the least" in gap.why for gap in found.gaps)


@pytest.mark.slow
def test_adjusted_p_values_count_the_conditions(tmp_path: Path, seed: int) -> None:
    """Two conditions double them."""
    both = {name: own | {"motor": {j: 2.0 + 0.1 * k for j in JOINTS[:2]}}
            for k, (name, own) in enumerate(drawn(seed).items())}  # fmt: skip
    study = study_of(tmp_path, both)
    subjects, _ = subjects_of(study, lambda stage, fraction: None)
    two = pool(study, subjects).comparisons
    alone = study_of(tmp_path, drawn(seed))
    one = pool(alone, subjects_of(alone, lambda stage, fraction: None)[0]).comparisons
    doubled = (2.0 * one[0].tested.adjusted).clamp(max=1.0)
    torch.testing.assert_close(two[0].tested.adjusted, doubled)


def test_who_lacks_a_condition_is_left_out_by_name(tmp_path: Path, seed: int) -> None:
    """Of that comparison alone; a condition that one subject alone has is not compared, and that is said."""
    own = drawn(seed, 7)
    for name in ("S1", "S2", "S3", "S4", "S5", "S6"):
        own[name]["motor"] = {JOINTS[0]: -5.0 + float(name[1])}
    own["S6"]["crutch"] = {JOINTS[0]: 1.0}
    study = study_of(tmp_path, own)
    found = pool(study, subjects_of(study, lambda stage, fraction: None)[0])
    assert {one.condition: len(one.units.second) for one in found.comparisons} == {"spring": 7, "motor": 6}
    said = [f"{gap.what}: {gap.why}" for gap in found.gaps]
    assert any(text.startswith("motor of S0: left out") for text in said)
    assert any(text.startswith("crutch: not compared: S6 alone") for text in said)


def test_files_hold_the_same_numbers(tmp_path: Path, seed: int) -> None:
    """Every number of the page is in the CSV as it is shown; JSON and netCDF hold what the subjects' files say."""
    study = study_of(tmp_path, drawn(seed))
    found = evaluate_study(study)
    assert {path.name for path in study.out.iterdir() if path.is_file()} == set(FILES)
    rows = list(csv.DictReader(StringIO((study.out / "subjects.csv").read_text())))
    told = {number for row in rows for number in NUMBER.findall(row["shown"])}
    page = (study.out / "subjects.html").read_text()
    body = YEAR.sub(" ", re.sub(r"\bS\d\b", " ", shown_text(page)).partition("Summary")[2])
    missing = [number for number in NUMBER.findall(body) if number not in told]
    assert not missing, missing
    assert len(NUMBER.findall(body)) > 100 and "<script" not in page
    held = json.loads((study.out / "subjects.json").read_text())
    hip = next(row for row in held["differences"] if row["where"] == JOINTS[0])
    each = {one.name: one.differences["identified", "spring", JOINTS[0], MEASURE].value for one in found.subjects}
    assert hip["each"] == pytest.approx(each) and hip["found"] and hip["agree"] == 8
    assert hip["value"] == pytest.approx(np.mean(list(each.values())))
    assert held["device"]["spring"][JOINTS[0]]["S3"] == pytest.approx(0.25, abs=0.01)
    data = xarray.open_dataset(study.out / "subjects.nc", engine="h5netcdf")
    assert dict(data.sizes) == {"subject": 8, "condition": 2, "percent": POINTS, "course": 3, "column": 4}
    one = data.measure.sel(subject="S4", condition="spring", column=f"{JOINTS[0]} {MEASURE}")
    assert float(one) == pytest.approx(40.0 + each["S4"])


def test_the_effect_size_of_pairs_is_cohens_with_an_exact_interval(seed: int) -> None:
    """Hedges' correction of mean over standard deviation; bounds at which the observed t has a chance of 2.5 %."""
    rng = np.random.default_rng(seed)
    values = rng.normal(1.0, 1.0, size=(7, 3))
    values[2, 1] = np.nan
    found = hedges_paired(torch.as_tensor(values))
    for k in range(3):
        own = values[np.isfinite(values[:, k]), k]
        n, t = len(own), stats.ttest_1samp(own, 0.0).statistic
        scale = (1.0 - 3.0 / (4.0 * (n - 1) - 1.0)) / np.sqrt(n)
        assert float(found.value[k]) == pytest.approx(scale * t)
        for bound, chance in ((found.low[k], 0.975), (found.high[k], 0.025)):
            assert stats.nct.cdf(t, n - 1, float(bound) / scale) == pytest.approx(chance, abs=2e-4)
    assert bool(torch.isnan(hedges_paired(torch.as_tensor(values[:2])).value).all())


def test_a_folder_without_an_evaluation_is_refused(tmp_path: Path) -> None:
    """Missing, damaged or another file."""
    for content in (None, "{", json.dumps({"subject": "a"})):
        if content is not None:
            (tmp_path / "evaluation.json").write_text(content)
        with pytest.raises(InputError) as caught:
            read_subject(tmp_path)
        assert caught.value.code == "study.subject" and caught.value.remedy


@pytest.mark.parametrize(
    ("document", "code"),
    [
        ({"subjects": [{"out": "a"}]}, "config.invalid_value"),
        ({"subjects": [{"out": "a"}, {"out": "b", "config": "c.yaml"}]}, "study.member"),
        ({"subjects": [{"out": "a"}, {"out": "b", "set": ["seed=1"]}]}, "study.member"),
        ({"subjects": [{"out": "a"}, {"config": "absent.yaml"}]}, "config.missing_file"),
        ({"subjects": [{"out": "a"}, {"out": "b"}], "levle": 0.1}, "config.unknown_key"),
    ],
)
def test_a_study_that_makes_no_sense_is_refused(tmp_path: Path, document: dict, code: str) -> None:
    """With a code of its own, the place and what to do."""
    path = tmp_path / "study.yaml"
    path.write_text(yaml.safe_dump({"name": "a", **document}))
    with pytest.raises(InvalidConfig) as caught:
        load_evaluation(path)
    assert caught.value.code == code and caught.value.remedy


def test_subjects_that_cannot_be_put_together_are_refused(tmp_path: Path, seed: int) -> None:
    """The same folder or name twice, different choices, no condition in common."""
    own = drawn(seed, 3)
    study = study_of(tmp_path, own)
    member = study.subjects[0]
    with pytest.raises(ConfigError) as caught:
        subjects_of(study.model_copy(update={"subjects": (member, member)}), lambda stage, fraction: None)
    assert caught.value.code == "study.twice"
    folder(tmp_path / "S1", "S0", own["S1"])
    with pytest.raises(ConfigError) as caught:
        subjects_of(study, lambda stage, fraction: None)
    assert caught.value.code == "study.twice" and "S0" in caught.value.found
    for other in ({"signs": "isb"}, {"per_mass_kg": 70.0}):
        folder(tmp_path / "S1", "S1", own["S1"], **other)
        with pytest.raises(ConfigError) as caught:
            pool(study, subjects_of(study, lambda stage, fraction: None)[0])
        assert caught.value.code == "study.differs" and "S1" in caught.value.found
    alone = {name: {f"worn{k}": changes["spring"]} for k, (name, changes) in enumerate(own.items())}
    study = study_of(tmp_path, alone)
    with pytest.raises(DataError) as caught:
        pool(study, subjects_of(study, lambda stage, fraction: None)[0])
    assert caught.value.code == "study.nothing"


def test_configs_of_subjects_are_evaluated_first(tmp_path: Path, seed: int) -> None:
    """Each with its own keys; one whose data support nothing is left out by name, with the reason."""
    (tmp_path / "a.c3d").write_text("")
    document = {"subject": {"name": "a"}, "markers": "opencap", "trials": [{"name": "one", "file": "a.c3d"}]}
    (tmp_path / "one.yaml").write_text(yaml.safe_dump(document))
    subjects = [{"config": "one.yaml", "set": [f"subject.name=S{k}", f"out=S{k}"]} for k in range(3)]
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({"name": "a", "subjects": subjects, "out": "study"}))
    study = load_evaluation(tmp_path / "study.yaml")
    changes, stages = drawn(seed, 3), []

    def make(config: Config, progress: object) -> None:
        if config.subject.name == "S1":
            raise DataError("evaluate.no_cycles", "no cycle was found", remedy="Look")
        config.out.mkdir()
        folder(config.out, config.subject.name, changes[config.subject.name])
        progress("geometry", 0.5)

    assert isinstance(study, Study)
    found, refused = subjects_of(study, lambda stage, fraction: stages.append(stage), make)
    assert [one.name for one in found] == ["S0", "S2"] and stages == ["S0: geometry", "S2: geometry"]
    assert [gap.what for gap in refused] == ["subject S1"] and "no cycle was found" in refused[0].why
    assert pool(study, found, refused).gaps[0] is refused[0]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            InputError("c3d.truncated", "the file ends early", source="/a/b.c3d", remedy="Copy it"),
            "b.c3d: the file ends",
        ),
        (ValueError("no\nsuch thing"), "a defect of torchid: ValueError: no such thing"),
        (None, "study.subject"),
    ],
)
def test_one_bad_subject_is_left_out_and_the_others_go_on(tmp_path: Path, seed: int, error, said: str, caplog) -> None:
    """A file of it is damaged, a defect shows in it, or its evaluation leaves nothing: page and JSON say which."""
    (tmp_path / "a.c3d").write_text("")
    document = {"subject": {"name": "a"}, "markers": "opencap", "trials": [{"name": "one", "file": "a.c3d"}]}
    (tmp_path / "one.yaml").write_text(yaml.safe_dump(document))
    subjects = [{"config": "one.yaml", "set": [f"subject.name=S{k}", f"out=S{k}"]} for k in range(4)]
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({"name": "a", "subjects": subjects, "out": "study"}))
    study, changes = load_evaluation(tmp_path / "study.yaml"), drawn(seed, 4)
    assert isinstance(study, Study)

    def make(config: Config, progress: object) -> None:
        if config.subject.name == "S0":
            if error is not None:
                raise error
            return
        config.out.mkdir()
        folder(config.out, config.subject.name, changes[config.subject.name])

    found = evaluate_study(study, make=make)
    assert [one.name for one in found.subjects] == ["S1", "S2", "S3"]
    (left,) = [gap for gap in found.gaps if gap.what == "subject S0"]
    assert said in left.why and left.why in caplog.text
    table = json.loads((study.out / "subjects.json").read_text())
    assert {"what": left.what, "why": left.why} in table["not_determinable"]
    assert "subject S0" in shown_text((study.out / "subjects.html").read_text())


def test_why_too_few_subjects_are_left_is_said(tmp_path: Path, seed: int) -> None:
    """With the reason that left the others out, however many did."""
    study = study_of(tmp_path, drawn(seed, 2))
    found, _ = subjects_of(study, lambda stage, fraction: None)
    refused = [Gap(f"subject X{k}", f"left out: no cycle was found under condition {k}") for k in range(3)]
    for left in ((), found[:1]):
        with pytest.raises(DataError) as caught:
            pool(study, left, refused)
        assert caught.value.code == "study.nothing" and "left subjects out" in (caught.value.remedy or "")
        assert all(gap.what in caught.value.found and gap.why in caught.value.found for gap in refused)


def test_permutations_too_few_for_the_level_test_nothing(tmp_path: Path, seed: int) -> None:
    """Signs that are drawn cannot reach a level below one of their number; that is no verdict, and names the key."""
    assert [needed_for(subject_units(9), 1.0, 99, x).permutations for x in (0.05, 0.01, 0.05 / 6)] == [20, 100, 120]
    study = study_of(tmp_path, drawn(seed), permutations=99, level=0.01)
    found = evaluate_study(study)
    (one,) = found.comparisons
    assert not one.testable and one.needed.least == "permutations: 100" and one.least_p == 1 / 99
    assert any("permutations: 100 are the least" in gap.why for gap in found.gaps)
    page = shown_text((study.out / "subjects.html").read_text())
    assert "permutations: 100 are the least" in page and "family-wise" not in page
    again = pool(study.model_copy(update={"permutations": 100}), found.subjects).comparisons[0]
    assert again.testable and not again.needed.said


def test_what_the_device_takes_is_weighed_by_time(tmp_path: Path, seed: int) -> None:
    """A cycle of four seconds counts as four of one."""
    out = folder(tmp_path, "S0", drawn(seed, 1)["S0"])
    path = out / "cycles_spring.nc"
    data = xarray.load_dataset(path, engine="h5netcdf")
    demand, parts, lasting = data.demand.values, np.array([0.8, 0.1, 0.4]), np.array([1.0, 4.0, 2.0])
    data["human"] = data.demand * (1.0 - xarray.DataArray(parts, dims="cycle"))
    path.unlink()
    write_netcdf(path, [data.assign_coords(duration=("cycle", lasting))])
    load = np.trapezoid(np.abs(demand[..., 0]), axis=1) * lasting
    taken = read_subject(out).courses["spring"].taken
    assert taken[JOINTS[0]] == pytest.approx((load * parts).sum() / load.sum())


def test_who_has_no_compression_is_not_below_its_limit(tmp_path: Path, seed: int) -> None:
    """Of eight subjects two have none: the page counts six."""
    study = study_of(tmp_path, drawn(seed))
    for name in ("S2", "S5"):
        path = tmp_path / name / "evaluation.json"
        table = json.loads(path.read_text())
        for answer in (table, table["template"]):
            del answer["joints"]["L5/S1"]
            answer["differences"] = [row for row in answer["differences"] if row["where"] != "L5/S1"]
        write_json(path, table)
    evaluate_study(study)
    page = shown_text((study.out / "subjects.html").read_text())
    assert "above the limit in 0 of 6 subjects" in page and "above the limit in 6 of 6 subjects" in page


@pytest.mark.parametrize("fault", ["missing", "damaged", "same name", "foreign"])
def test_what_is_wrong_with_a_study_is_said_before_any_evaluation(tmp_path: Path, seed: int, fault: str) -> None:
    """A folder, a name or a file that is in the way, listed behind a config that would take hours."""
    study, made = study_of(tmp_path, drawn(seed, 2)), []
    (tmp_path / "a.c3d").write_text("")
    name = "S1" if fault == "same name" else "S9"
    document = {"subject": {"name": name}, "markers": "opencap", "trials": [{"name": "one", "file": "a.c3d"}],
                "out": "S9"}  # fmt: skip
    (tmp_path / "one.yaml").write_text(yaml.safe_dump(document))
    study = study.model_copy(update={"subjects": (Member(config=tmp_path / "one.yaml"), *study.subjects)})
    if fault == "missing":
        (tmp_path / "S1" / "evaluation.json").unlink()
    if fault == "damaged":
        (tmp_path / "S1" / "cycles_spring.nc").write_text("no")
    if fault == "foreign":
        study.out.mkdir()
        (study.out / "subjects.html").write_text("mine")
    code = {"same name": "study.twice", "foreign": "results.foreign"}.get(fault, "study.subject")
    with pytest.raises(TorchidError) as caught:
        evaluate_study(study, make=lambda config, progress: made.append(config))
    assert caught.value.code == code and not made


@pytest.mark.slow
@pytest.mark.parametrize(("count", "conditions"), [(6, 1), (14, 1), (9, 2)])
def test_the_summary_fills_one_printed_page(tmp_path: Path, seed: int, count: int, conditions: int) -> None:
    """On A4 between the margins of the style sheet, in a browser that complains of nothing."""
    if shutil.which("chromium") is None:
        pytest.skip("no chromium on this machine")
    own = drawn(seed, count)
    if conditions == 2:
        own = {name: changes | {"motor": dict(changes["spring"])} for name, changes in own.items()}
    study = study_of(tmp_path, own)
    done = CliRunner().invoke(app, ["evaluate", str(tmp_path / "study.yaml")])
    assert done.exit_code == 0, done.output
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        view, complaints = browser.new_page(viewport={"width": 695, "height": 1017}), []
        view.on("console", lambda message: complaints.append(message.text))
        view.goto((study.out / "subjects.html").as_uri())
        view.emulate_media(media="print")
        bottom, wide = view.evaluate(
            "[document.querySelector('#summary').getBoundingClientRect().bottom, document.body.scrollWidth]"
        )
        browser.close()
    assert bottom <= 1017 and wide <= 700 and not complaints
