"""Groups of a cohort: what was hidden in how one of them walks is found, and nothing else."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from draws import seed_of
from rates import at_least
from typer.testing import CliRunner

from torchid.cli import app
from torchid.config import GroupQuestion, load_evaluation
from torchid.cycles.measures import STRIDE, unit_of
from torchid.errors import ConfigError, InputError
from torchid.evaluation.groups.groups import GroupComparison, compare_groups
from torchid.evaluation.groups.write import evaluate_groups
from torchid.session.joint_cycles import JOINTS

POINTS, STRIDES, DRAWS = 11, 2, 16
GROUPS = {"control": 9, "patient": 8}
PERCENT = np.linspace(0, 100, POINTS).round().astype(int)


def person(folder: Path, name: str, draw: np.random.Generator, joint: str = "", by: float = 0.0) -> None:
    """A person's tables; moments of one joint are larger by some standard deviations between people."""
    (folder / name).mkdir()
    wave = np.sin(np.linspace(0.0, 2.0 * np.pi, POINTS))
    own = {one: (draw.normal(20.0, 3.0), draw.normal(1.0, 0.1) + 0.1 * by * (one == joint)) for one in JOINTS}
    lines = [
        (f"walk{k}", "lr"[k % 2], float(k), p, one, own[one][0] * w, 60.0 * own[one][1] * w, 0.0)
        for k in range(STRIDES) for p, w in zip(PERCENT, wave, strict=True) for one in JOINTS
    ]  # fmt: skip
    head = ["trial", "side", "start_s", "percent", "joint", "angle_deg", "moment_Nm", "power_W"]
    pd.DataFrame(lines, columns=head).to_csv(folder / name / "cycles.csv", index=False)
    walked = [
        ("stride", f"walk{k}", one, draw.normal(1.0, 0.05), unit_of(one)) for k in range(STRIDES) for one in STRIDE
    ]
    pd.DataFrame(walked, columns=["group", "item", "quantity", "value", "unit"]).to_csv(
        folder / name / "results.csv", index=False
    )


def cohort(folder: Path, draw: np.random.Generator, joint: str = "", by: float = 0.0) -> Path:
    """A finished cohort of two groups of people of 60 kg."""
    folder.mkdir()
    rows = []
    for group, count in GROUPS.items():
        for k in range(count):
            rows.append((f"{group}{k}", group, "done", 60.0))
            person(folder, f"{group}{k}", draw, joint, by if group == "patient" else 0.0)
    pd.DataFrame(rows, columns=["subject", "group", "status", "mass_kg"]).to_csv(folder / "cohort.csv", index=False)
    return folder


def asked(folder: Path) -> GroupComparison:
    return compare_groups(GroupQuestion(cohort=folder, permutations=199))


def named(found: GroupComparison) -> set[str]:
    """Where measures or courses differ."""
    (one,) = found.comparisons
    return {c.where for k, c in enumerate(one.columns) if k in one.found(0.05)} | {
        c.where for j, c in enumerate(one.courses) if j in one.found_courses(0.05)
    }


def test_what_was_hidden_in_one_joint_is_found_there(tmp_path: Path) -> None:
    draw, right = np.random.default_rng(seed_of("groups")), 0
    for k in range(DRAWS):
        joint = str(draw.choice(JOINTS))
        right += joint in named(asked(cohort(tmp_path / str(k), draw, joint, 4.0)))
    assert right >= at_least(0.95, DRAWS)


def test_nothing_is_found_where_groups_walk_alike(tmp_path: Path) -> None:
    draw = np.random.default_rng(seed_of("alike"))
    silent = sum(not named(asked(cohort(tmp_path / str(k), draw))) for k in range(DRAWS))
    assert silent >= at_least(0.95, DRAWS)


def test_page_and_table_say_it(tmp_path: Path) -> None:
    folder = cohort(tmp_path / "some", np.random.default_rng(seed_of("page")), "hip_flexion", 6.0)
    found = CliRunner().invoke(app, ["evaluate", str(folder), "reference=control", "permutations=199"])
    assert found.exit_code == 0 and "groups.html" in found.output
    page = (folder / "groups.html").read_text()
    assert "hip flexion" in page and "differ significantly" in page and "<svg" in page
    table = pd.read_csv(folder / "groups.csv")
    (peak,) = table[(table["where"] == "hip_flexion") & (table["measure"] == "max_torque_Nm")].to_dict(orient="records")
    assert peak["p_adjusted"] < 0.05 and peak["difference"] == pytest.approx(0.6, abs=0.3) and peak["unit"] == "N m/kg"


def test_who_has_no_part_in_it_is_said(tmp_path: Path) -> None:
    folder = cohort(tmp_path / "some", np.random.default_rng(seed_of("left out")))
    table = pd.read_csv(folder / "cohort.csv")
    table.loc[0, "group"], table.loc[1, "status"] = np.nan, "set aside"
    table.to_csv(folder / "cohort.csv", index=False)
    (folder / "control2" / "cycles.csv").unlink()
    found = evaluate_groups(GroupQuestion(cohort=folder, permutations=199))
    assert {gap.what for gap in found.gaps} == {"control0", "control1", "control2"}
    assert len(found.walking.people) == sum(GROUPS.values()) - 3


def test_too_few_people_are_not_tested(tmp_path: Path) -> None:
    folder = cohort(tmp_path / "some", np.random.default_rng(seed_of("few")))
    table = pd.read_csv(folder / "cohort.csv")
    table[table["subject"].isin(["control0", "control1", "patient0", "patient1"])].to_csv(
        folder / "cohort.csv", index=False
    )
    found = evaluate_groups(GroupQuestion(cohort=folder))
    assert not found.comparisons[0].testable and "people of each group" in found.gaps[-1].why
    assert "not testable" in (folder / "groups.html").read_text()


def test_questions_that_cannot_be_asked_are_refused(tmp_path: Path) -> None:
    folder = cohort(tmp_path / "some", np.random.default_rng(seed_of("refused")))
    with pytest.raises(ConfigError, match="nobody is in this group"):
        compare_groups(GroupQuestion(cohort=folder, reference="controls"))
    table = pd.read_csv(folder / "cohort.csv")
    table.assign(group="all").to_csv(folder / "cohort.csv", index=False)
    with pytest.raises(ConfigError, match="everybody is in one group"):
        compare_groups(GroupQuestion(cohort=folder))
    table.assign(group="").to_csv(folder / "cohort.csv", index=False)
    with pytest.raises(InputError, match="nobody in this cohort"):
        compare_groups(GroupQuestion(cohort=folder))
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="no finished cohort"):
        evaluate_groups(GroupQuestion(cohort=tmp_path / "none"))
    assert not list((tmp_path / "none").iterdir()), "a folder of recordings stays as it was"
    table.assign(group=["001" if own == "control" else "002" for own in table["group"]]).to_csv(
        folder / "cohort.csv", index=False
    )
    asked = load_evaluation(folder, ["reference=002"])
    assert isinstance(asked, GroupQuestion) and compare_groups(asked).reference == "002"
    with pytest.raises(ConfigError):
        load_evaluation(folder, ["refrence=control"])


def test_names_that_pandas_takes_for_nothing_are_names(tmp_path: Path) -> None:
    folder = cohort(tmp_path / "some", np.random.default_rng(seed_of("names")))
    table = pd.read_csv(folder / "cohort.csv").replace({"group": {"control": "None"}, "subject": {"control0": "NA"}})
    table.to_csv(folder / "cohort.csv", index=False)
    (folder / "control0").rename(folder / "NA")
    found = asked(folder)
    assert found.walking.people[0] == "NA" and found.reference == "None" and not found.walking.left_out


def test_broken_tables_are_told_with_their_place(tmp_path: Path) -> None:
    folder = cohort(tmp_path / "some", np.random.default_rng(seed_of("broken")))
    strides = folder / "control0" / "cycles.csv"
    whole = strides.read_text()
    lines = whole.splitlines(keepends=True)
    for broken in ("".join(lines[:-3]), lines[0], whole.replace("moment_Nm", "moment"), ""):
        strides.write_text(broken)
        with pytest.raises(InputError, match=r"control0: .*cannot be read.*Remove the folder"):
            asked(folder)
    strides.write_text(whole)
    pd.read_csv(folder / "cohort.csv").drop(columns="group").to_csv(folder / "cohort.csv", index=False)
    with pytest.raises(InputError, match=r"cohort.csv: .*cannot be read.*Remove it"):
        asked(folder)


def test_a_person_without_a_mass_has_no_moments_and_it_is_said(tmp_path: Path) -> None:
    folder = cohort(tmp_path / "some", np.random.default_rng(seed_of("mass")))
    table = pd.read_csv(folder / "cohort.csv")
    table.loc[0, "mass_kg"] = np.nan
    table.to_csv(folder / "cohort.csv", index=False)
    found = asked(folder)
    assert [gap.what for gap in found.gaps] == ["moments of control0"] and "control0" in found.walking.people
