"""Tests of torchid.storage.tables: every form of a table holds what its CSV holds."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from pandas.testing import assert_frame_equal

from torchid.config import load_config
from torchid.cycles.cycles import Cycle
from torchid.errors import ConfigError
from torchid.run import run_experiment
from torchid.run.scalars import cycles_table
from torchid.run.sequence import run_key
from torchid.run.write import result_names
from torchid.session.joint_cycles import JointCycles
from torchid.storage import table_forms, tables
from torchid.storage.table_forms import PACKAGES, Form
from torchid.storage.tables import write_table

READERS = {"parquet": pd.read_parquet, "xlsx": pd.read_excel}
CONFIG = "{subject: {name: s}, markers: simulated, simulate: {fit: [squats]}, out: out}"


def table() -> pd.DataFrame:
    """Numbers with their digits, one that is not known, a column of none, and a text that a sheet would compute."""
    values = [0.1 + 0.2, np.nan, -1e-12, 75.0]
    return pd.DataFrame({"item": ["=1+1", "a,b", 'c"', "é"], "value": values, "sd": np.full(4, np.nan)})


@pytest.mark.parametrize("form", READERS)
def test_every_form_holds_the_same(tmp_path: Path, form: Form) -> None:
    """To the last digit, of which Excel has 15; what is not known is empty, and texts stay texts."""
    pytest.importorskip(PACKAGES[form])
    write_table(table(), "results", [form], tmp_path.joinpath)
    assert {path.name for path in tmp_path.iterdir()} == {"results.csv", f"results.{form}"}
    assert_frame_equal(pd.read_csv(tmp_path / "results.csv"), table(), check_exact=True)
    found = READERS[form](tmp_path / f"results.{form}")
    assert_frame_equal(found, table(), check_exact=form != "xlsx", rtol=1e-14, atol=0.0)


def test_a_sheet_that_is_full_goes_on_in_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No line is lost, and control characters do not keep a workbook from being written."""
    pytest.importorskip(PACKAGES["xlsx"])
    monkeypatch.setattr(tables, "SHEET", 3)
    write_table(table().replace("é", "\x07"), "cycles", ["xlsx"], tmp_path.joinpath)
    sheets = pd.read_excel(tmp_path / "cycles.xlsx", sheet_name=None)
    assert {name: len(part) for name, part in sheets.items()} == {"cycles": 3, "cycles 2": 1}
    assert sheets["cycles 2"]["value"].tolist() == [75.0]


@pytest.mark.parametrize("form", PACKAGES)
def test_a_form_without_its_package_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: Form
) -> None:
    """The error names the package and how it is installed; nothing is begun."""
    monkeypatch.setattr(table_forms, "find_spec", lambda name: None)
    (tmp_path / "c.yaml").write_text(CONFIG)
    with pytest.raises(ConfigError, match=rf"{PACKAGES[form]}.*torchid\[tables\]") as refused:
        run_experiment(load_config(tmp_path / "c.yaml", [f"tables=[{form}]"]))
    assert refused.value.code == "tables.package" and not (tmp_path / "out").exists()


def test_forms_of_tables_change_no_result(tmp_path: Path) -> None:
    """Stages that are done are taken up again; only the files are more, and claimed."""
    (tmp_path / "c.yaml").write_text(CONFIG)
    plain, more = (load_config(tmp_path / "c.yaml", own) for own in ([], ["tables=[xlsx]", "bids=true"]))
    assert run_key(plain) == run_key(more)
    assert set(result_names(["a"], more.tables)) - set(result_names(["a"])) == {"results.xlsx", "cycles.xlsx"}


def test_a_line_of_cycles_is_its_stride_s_at_its_percent_for_its_joint(seed: int) -> None:
    """The order of strides, percents and joints is that of the arrays."""
    random = torch.Generator().manual_seed(seed)
    angle, moment, power = torch.rand(3, 2, 101, 4, dtype=torch.float64, generator=random)
    cycles, start = (Cycle("a", 0, 100, "l"), Cycle("b", 7, 93, "r")), torch.tensor([0.0, 1.23456], dtype=torch.float64)
    joints = ("hip", "knee", "ankle", "toes")
    found = JointCycles(cycles, joints, torch.zeros(2, 1), start, angle, moment, power, 70.0)
    lines = cycles_table(found).set_index(["trial", "side", "start_s", "percent", "joint"])
    assert len(lines) == 2 * 101 * 4
    for k, cycle in enumerate(cycles):
        for percent in (0, 37, 100):
            for j, joint in enumerate(joints):
                line = lines.loc[(cycle.trial, cycle.side, round(float(start[k]), 4), percent, joint)]
                assert line.tolist() == pytest.approx(
                    [float(x[k, percent, j]) for x in (angle, moment, power)], rel=1e-6
                )
