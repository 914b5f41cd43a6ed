"""One self-contained page about a run."""

from pathlib import Path

from torchid.errors import DataError
from torchid.experiment.outcome import Outcome
from torchid.files import write_text


def write_report(outcome: Outcome, path: Path, failure: DataError | None = None) -> None:
    write_text(path, "in progress")
