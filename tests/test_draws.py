"""Seeds that nobody chose, the ledger of those that failed once, and how many of some draws must succeed."""

import os
import re
import subprocess
import sys
from pathlib import Path

import draws
import pytest
from draws import Failure, enter, ledger, pinned, seed_of
from rates import FALSE_ALARM, at_least, draws_for
from scipy.stats import binom

PROJECT = Path(__file__).resolve().parents[1]


def test_seeds_hang_on_the_name_and_the_version_alone(monkeypatch):
    """The same in every run, another for every name and version; a given one is everybody's."""
    monkeypatch.setattr(draws, "GIVEN", None)
    own = {seed_of(f"test_{k}") for k in range(1000)}
    assert len(own) == 1000 and own == {seed_of(f"test_{k}") for k in range(1000)} and max(own) < 2**32
    monkeypatch.setattr(draws, "VERSION", draws.VERSION + 1)
    assert not own & {seed_of(f"test_{k}") for k in range(1000)}
    monkeypatch.setattr(draws, "GIVEN", "7")
    assert seed_of("this") == seed_of("that") == 7


def test_a_failure_is_entered_once(tmp_path):
    path = tmp_path / "draws.jsonl"
    for _ in range(2):
        enter("tests/test_a.py::test_b[x-1]", 5, "assert 1\n  == 2", path)
    (found,) = ledger(path)
    assert (found.test, found.of, found.seed, found.said) == (
        "tests/test_a.py::test_b[x-1]", "tests/test_a.py::test_b", 5, "assert 1 == 2",
    )  # fmt: skip
    assert (found.state, found.cause) == ("open", "")


@pytest.mark.parametrize("failure", ledger(), ids=lambda one: f"{one.of.rpartition('::')[2]}-{one.seed}")
def test_what_failed_once_has_its_cause_mended_or_written_down(failure: Failure):
    """And its test is still there."""
    assert failure.state in ("mended", "explained") and failure.cause, "an open failure: mend or explain its cause"
    assert _definition(failure), "its test has another name now"


def _definition(failure: Failure) -> str:
    """Head of a test as it stands in its file, up to its arguments' end."""
    file, _, name = failure.of.partition("::")
    found = re.search(rf"^def {name}\([^)]*\)", (PROJECT / file).read_text(), re.MULTILINE)
    return found.group() if found else ""


def _alone() -> dict[int, list[str]]:
    """Tests by pinned seed that have no ``seed`` of their own: what they draw is their module's."""
    found: dict[int, list[str]] = {}
    for one in pinned():
        if not re.search(r"\bseed\b", _definition(one)):
            found.setdefault(one.seed, []).append(one.test)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed_that_failed", _alone())
def test_pinned_seeds_of_whole_modules_hold(seed_that_failed: int, tmp_path: Path):
    """Each in a process of its own, as in the draw that failed."""
    own = os.environ | {"TORCHID_SEED": str(seed_that_failed), "TORCHID_TEST_SHARED": str(tmp_path)}
    asked = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", "addopts=--strict-markers"]
    command = [*asked, *_alone()[seed_that_failed]]
    ended = subprocess.run(command, cwd=PROJECT, env=own, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout


@pytest.mark.parametrize("rate", [0.3, 0.9, 0.99, 0.999])
@pytest.mark.parametrize("count", [1, 5, 20, 200])
def test_what_is_asked_of_draws_is_the_most_that_chance_allows(rate, count):
    """One success more would fail too often."""
    least = at_least(rate, count)
    assert binom.cdf(least - 1, count, rate) < FALSE_ALARM <= binom.cdf(least, count, rate)
    assert at_least(rate, draws_for(rate, 3)) >= 3 > at_least(rate, draws_for(rate, 3) - 1)
