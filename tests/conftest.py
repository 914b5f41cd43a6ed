"""What all tests share: modest threads, the real recordings where they exist, seeds that a failure shows."""

import os
import time
from pathlib import Path

import pytest
import torch
from hypothesis import settings

torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "2")))
settings.register_profile("torchid", deadline=None, print_blob=True, max_examples=100)
settings.load_profile("torchid")

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The real recordings: ``$TORCHID_DATA``, else ``shared/data`` beside the project."""
    folder = Path(os.environ.get("TORCHID_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set TORCHID_DATA")
    return folder


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs leave out the report, a quarter of a small one, where nothing is read there."""
    monkeypatch.setattr("torchid.run.sequence.write_report", lambda *_: None)


@pytest.fixture
def seed() -> int:
    """A fresh seed from the clock, or ``$TORCHID_SEED``; pytest shows the printed line when the test fails."""
    value = int(os.environ.get("TORCHID_SEED", time.time_ns() % 2**32))
    print(f"repeat with TORCHID_SEED={value}")  # noqa: T201
    torch.manual_seed(value)
    return value
