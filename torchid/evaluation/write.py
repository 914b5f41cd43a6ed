"""Files of an evaluation, beside those of its run."""

from torchid.config import Config
from torchid.evaluation.datasets import cycles_dataset
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import Ledger
from torchid.evaluation.numbers import all_numbers
from torchid.evaluation.report.page import render_evaluation
from torchid.evaluation.table import evaluation_table
from torchid.storage.files import safe_name, write_json, write_text
from torchid.storage.netcdf import write_netcdf
from torchid.storage.results import OutputFolder

FILES = ("evaluation.json", "evaluation.csv", "evaluation.html")


def write_evaluation(found: Evaluation, folder: OutputFolder) -> None:
    """Write the tables, the cycles of every condition, and the report.

    Args:
        found: the evaluation.
        folder: that of its run, opened to write beside it.

    Raises:
        InputError: a file cannot be written.
    """
    ledger = Ledger(all_numbers(found))
    page = render_evaluation(found, ledger)  # before the CSV, which holds what it has shown
    write_json(folder.path("evaluation.json"), evaluation_table(found))
    write_text(folder.path("evaluation.csv"), ledger.csv())
    write_text(folder.path("evaluation.html"), page)
    for condition in found.config.conditions:
        write_netcdf(folder.path(f"cycles_{safe_name(condition)}.nc"), [cycles_dataset(found, condition)])


def file_names(config: Config) -> list[str]:
    """Names of the files that ``write_evaluation`` writes.

    Args:
        config: of the evaluation.
    """
    cycles = [f"cycles_{safe_name(condition)}.nc" for condition in config.conditions]
    return [*FILES, *cycles]
