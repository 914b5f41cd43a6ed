"""What all tests share: modest threads, the real recordings where they exist, seeds that nobody chose."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import children
import pytest
import torch
import type_checks
import whole_runs
from draws import GIVEN, enter, pinned_ids, pins_of, seed_of
from hypothesis import settings
from recordings import DATA

torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "2")))
settings.register_profile("torchid", deadline=None, print_blob=True, max_examples=100, derandomize=GIVEN is None)
settings.load_profile("torchid")
type_checks.install()
gc.disable()  # until everything is imported: a million objects that stay are not looked at again and again

KEEPS = "TORCHID_DRAWS" in os.environ and "PYTEST_XDIST_WORKER" not in os.environ
"""Whether this process writes failures of a draw into the ledger."""


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Hypothesis draws from the seed of a draw, too."""
    if GIVEN is not None and config.option.hypothesis_seed is None:
        config.option.hypothesis_seed = GIVEN


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where slow tests alone are asked for, files that have none are not even imported."""
    asked = config.option.markexpr.startswith("slow") and collection_path.suffix == ".py"
    return True if asked and "mark.slow" not in collection_path.read_text(encoding="utf-8") else None


def pytest_collection_finish() -> None:
    """What is imported stays: from here on only what tests make is looked through for garbage."""
    gc.freeze()
    gc.enable()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Each seed on which a test with a ``seed`` failed once is a case of its own."""
    own = pins_of(metafunc.definition.nodeid)
    if own and "seed" in metafunc.fixturenames:
        ids = [pytest.HIDDEN_PARAM, *(f"seed={one}" for one in own)]
        metafunc.parametrize("seed", [None, *own], ids=ids, indirect=True)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests whose verdict hangs on a seed are marked ``drawn``; a pinned seed is run in the case that failed alone."""
    others = [item for item in items if "[seed=" in item.nodeid and item.nodeid not in pinned_ids()]
    items[:] = [item for item in items if item not in others]
    if others:
        config.hook.pytest_deselected(items=others)
    for item in items:
        if is_drawn(item):
            item.add_marker("drawn")


def is_drawn(item: pytest.Item) -> bool:
    """Return whether a test asks for a seed, is of Hypothesis, or is in a module that draws for all its tests, unless
    that is marked ``shown``.

    Args:
        item: the test.
    """
    own = vars(item.module) if isinstance(item, pytest.Function) else {}
    whose = {getattr(one, "__module__", None) or getattr(one, "__name__", None) for one in own.values()}
    asks = "seed" in getattr(item, "fixturenames", ()) or "hypothesis" in item.keywords
    return asks or ("shown" not in item.keywords and ("SEED" in own or "small_session" in whose))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """A test that fails on a draw is entered in the ledger."""
    if KEEPS and report.failed and "drawn" in report.keywords and GIVEN is not None:
        said = getattr(getattr(report.longrepr, "reprcrash", None), "message", str(report.longrepr))
        enter(report.nodeid, int(GIVEN), said, Path(os.environ["TORCHID_DRAWS"]))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Every test checks shapes and types anew."""
    type_checks.begin_test()


@pytest.fixture(autouse=True)
def _seeded(request: pytest.FixtureRequest) -> None:
    """What a test draws without a seed of its own does not hang on the tests before it."""
    torch.manual_seed(seed_of(request.node.nodeid))


@pytest.fixture
def seed(request: pytest.FixtureRequest) -> int:
    """Of a hash of the test's name; of a draw, ``$TORCHID_SEED``; of a pinned case, the one that failed."""
    value = getattr(request, "param", None) or seed_of(request.node.nodeid)
    print(f"repeat with TORCHID_SEED={value}")  # noqa: T201 - shown where it fails
    torch.manual_seed(value)
    return value


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The real recordings: ``$TORCHID_DATA``, else ``shared/data`` beside the project."""
    if not DATA.is_dir():
        pytest.skip(f"no recordings at {DATA}; set TORCHID_DATA")
    return DATA


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs leave out the report where nothing is read there."""
    whole_runs.leave_out_report(monkeypatch)


@pytest.fixture
def tables_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs leave out the report and the series of trials where nothing is read there."""
    whole_runs.write_tables_alone(monkeypatch)


@pytest.fixture
def quick_children() -> Iterator[None]:
    """Processes beside a stream begin at once."""
    with children.quick_children():
        yield
