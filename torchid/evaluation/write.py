"""Files of an evaluation, beside those of its run."""

import numpy as np
import xarray

from torchid.config import Config
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
    """Names of the files that ``write_evaluation`` writes."""
    cycles = [f"cycles_{safe_name(condition)}.nc" for condition in config.conditions]
    return [*FILES, *cycles]


def cycles_dataset(found: Evaluation, condition: str) -> xarray.Dataset:
    """Courses and measures of the cycles of one condition."""
    own = [k for k, name in enumerate(found.conditions) if name == condition]
    rows, plain, layout = found.identified.rows, found.template.rows, found.layout
    by_course, by_column = ("cycle", "percent", "course"), ("cycle", "column")
    held = {
        "human": (by_course, rows.human[own].numpy()),
        "demand": (by_course, rows.demand[own].numpy()),
        "device": (by_course, rows.device[own].numpy()),
        "human_template": (by_course, plain.human[own].numpy()),
        "angle": (("cycle", "percent", "coordinate"), rows.angle[own].numpy()),
        "measure": (by_column, rows.values[own].numpy()),
        "measure_template": (by_column, plain.values[own].numpy()),
        "apart": (("cycle",), found.apart[own].numpy()),
    }
    if rows.human_draws is not None:
        held["human_sd"] = (by_course, rows.human_draws[:, own].std(0).numpy())
    cycles, times = [found.cycles[k] for k in own], {t.name: t.followed.motion.time for t in found.trials}
    coords = {
        "percent": np.linspace(0.0, 100.0, rows.human.shape[1]),
        "course": [f"{column.where} {column.measure}" for column in layout.courses],
        "coordinate": list(layout.names),
        "column": [f"{column.where} {column.measure}" for column in layout.columns],
        "trial": (("cycle",), [cycle.trial for cycle in cycles]),
        "side": (("cycle",), [cycle.side for cycle in cycles]),
        "duration": (("cycle",), [float(times[c.trial][c.stop] - times[c.trial][c.start]) for c in cycles]),
        "frame": (("cycle", "end"), np.array([[c.start, c.stop] for c in cycles], dtype=np.int64).reshape(-1, 2)),
    }
    return xarray.Dataset(
        held, coords, {"condition": condition, "units": "SI, rad", "convention": found.config.evaluate.convention,
                       "human": "demand minus the device's share", "per_mass_kg": found.per_mass_kg or 0.0},
    )  # fmt: skip
