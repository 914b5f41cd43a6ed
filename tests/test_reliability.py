"""The table of goals: what the source shows, and records of long measurements."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from reliability_table import record as records
from reliability_table.goals import GOALS, Measuring, g5
from reliability_table.source import unsafe, without_remedy


def test_calls_that_run_foreign_code_are_found(tmp_path: Path) -> None:
    """Unpickling, shells and whole torch files are; plain numbers and weights are not."""
    (tmp_path / "a.py").write_text(
        "pickle.load(f)\nnp.load(f, allow_pickle=True)\nsubprocess.run(x, shell=True)\ntorch.load(f)\n"
        "np.load(f, allow_pickle=False)\ntorch.load(f, weights_only=True)\nyaml.safe_load(f)\n"
    )
    assert [int(one.split(":")[1].split()[0]) for one in unsafe(tmp_path)] == [1, 2, 3, 4]


def test_errors_without_a_remedy_are_found(tmp_path: Path) -> None:
    """With its place; other calls are not counted."""
    (tmp_path / "a.py").write_text('InputError("a.b", "c", remedy="d")\nInputError("a.b", "c")\nother("a.b", "c")\n')
    assert without_remedy(tmp_path) == (["a.py:2"], 2)


def test_records_are_kept_and_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row is written with its date, read back, and the next of the same name takes its place."""
    monkeypatch.setattr(records, "RECORDS", tmp_path / "records.json")
    assert records.recorded() == {}
    records.record("G8", "0 corrupt of 50", True, "scripts/faults")
    records.record("G20", "2.1 GiB", None, "scripts/hour")
    records.record("G8", "1 corrupt of 50", False, "scripts/faults")
    found = records.recorded()
    assert set(found) == {"G8", "G20"} and found["G8"].text == "1 corrupt of 50" and found["G8"].date


def test_the_quick_goals_measure() -> None:
    """The grid of rates and ratios, as an example, is right; every goal has its words."""
    assert g5(Measuring(0, 10)).reached
    assert all(words and how for words, how in GOALS.values())
