"""Files of a study."""

from collections.abc import Callable

from torchid.config import Config, Study
from torchid.evaluation.evaluate import evaluate
from torchid.evaluation.ledger import Ledger
from torchid.evaluation.study.numbers import study_numbers
from torchid.evaluation.study.report.page import render_study
from torchid.evaluation.study.study import Pooled, pool, subjects_of
from torchid.evaluation.study.table import study_dataset, study_table
from torchid.session.fitting import OnStage
from torchid.storage.files import write_json, write_text
from torchid.storage.netcdf import write_netcdf
from torchid.storage.results import OutputFolder

FILES = ("subjects.json", "subjects.csv", "subjects.nc", "subjects.html")


def evaluate_study(
    study: Study,
    progress: OnStage = lambda stage, fraction: None,
    make: Callable[[Config, OnStage], object] = evaluate,
) -> Pooled:
    """Evaluate the subjects of a study, test them together, and write the study's files into its ``out``.

    Args:
        study: whom, and how.
        progress: called with stages and the share of each that is done.
        make: evaluates a config.

    Raises:
        TorchidError: as of ``subjects_of`` and ``pool``; ``results.*`` where the folder cannot be written.
    """
    with OutputFolder(study.out, beside=True) as folder:
        folder.claim(FILES)  # before hours of work, which may write into this folder too
    subjects, refused = subjects_of(study, progress, make)
    found = pool(study, subjects, refused)
    with OutputFolder(study.out, beside=True) as folder:
        folder.claim(FILES)
        write_study(found, folder)
    return found


def write_study(found: Pooled, folder: OutputFolder) -> None:
    """Write tables, courses and the report.

    Args:
        found: the study.
        folder: of its results.

    Raises:
        InputError: a file cannot be written.
    """
    ledger = Ledger(study_numbers(found))
    page = render_study(found, ledger)  # before the CSV, which holds what it has shown
    write_json(folder.path("subjects.json"), study_table(found))
    write_text(folder.path("subjects.csv"), ledger.csv())
    write_netcdf(folder.path("subjects.nc"), [study_dataset(found)])
    write_text(folder.path("subjects.html"), page)
