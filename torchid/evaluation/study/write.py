"""Files of a study."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import xarray

from torchid.config import Config, Study
from torchid.evaluation.evaluate import evaluate
from torchid.evaluation.ledger import Ledger
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.study.numbers import columns_of, condition_values, study_numbers, taken
from torchid.evaluation.study.report import render_study
from torchid.evaluation.study.study import Pooled, course_of, pool, subjects_of
from torchid.evaluation.study.subject import SHARES
from torchid.evaluation.write import difference_row, tests_table
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

    Raises:
        InputError: a file cannot be written.
    """
    ledger = Ledger(study_numbers(found))
    page = render_study(found, ledger)  # before the CSV, which holds what it has shown
    write_json(folder.path("subjects.json"), study_table(found))
    write_text(folder.path("subjects.csv"), ledger.csv())
    write_netcdf(folder.path("subjects.nc"), [study_dataset(found)])
    write_text(folder.path("subjects.html"), page)


def study_table(found: Pooled) -> dict[str, Any]:
    """Everything but courses, by the names that ``evaluation.json`` has for them."""
    common = tests_table(found)
    return {
        "study": found.study.name,
        "reference": found.reference,
        "subjects": [{"name": one.name, "out": str(one.folder), "conditions": one.devices} for one in found.subjects],
        "convention": found.subjects[0].convention,
        "signs": found.subjects[0].signs,
        "template_is": found.usual,
        "per_mass": found.per_mass,
        "differences": _rows(found, "identified"),
        "template": {"differences": _rows(found, "template")},
        "device": {one.condition: _taken(found, one) for one in found.comparisons},
        **common,
        "test": {
            one.condition: {
                "subjects": [subject.name for subject in found.having(one.condition)],
                "subjects_wanted": one.needed.units, **common["test"][one.condition],
            }
            for one in found.comparisons
        },
    }  # fmt: skip


def _rows(found: Pooled, body: str) -> list[dict[str, Any]]:
    return [
        difference_row(one, k, found.level) | {
            "agree": one.agreeing[k][0], "subjects": one.agreeing[k][1],
            "each": {s.name: float(x) for s, x in zip(found.having(one.condition), one.rows.values[:, k], strict=True)},
        } for one in found.answers[body] for k in range(len(one.columns))
    ]  # fmt: skip


def _taken(found: Pooled, one: Comparison) -> dict[str, dict[str, float]]:
    names, values = taken(found, one)
    return {
        w: {s.name: float(values[j, k]) for j, s in enumerate(found.having(one.condition))} for k, w in enumerate(names)
    }


def study_dataset(found: Pooled) -> xarray.Dataset:
    """Measures and mean courses of every subject under every condition; NaN where one has none."""
    courses = tuple(dict.fromkeys(column for one in found.comparisons for column in one.courses))
    points = len(found.comparisons[0].tested.points)
    by_course = ("subject", "condition", "percent", "course")
    held: dict[str, Any] = {
        ("human_template" if share == "template" else share): (by_course, np.stack([
            np.stack([
                course_of(one, c, share, courses).numpy() if c in one.conditions
                else np.full((points, len(courses)), np.nan) for c in found.names
            ]) for one in found.subjects
        ])) for share in (*SHARES, "template")
    }  # fmt: skip
    for name, body in (("measure", "identified"), ("measure_template", "template")):
        values = torch.full((len(found.subjects), len(found.names), len(columns_of(found))), torch.nan).double()
        for c, condition in enumerate(found.names):
            own = [k for k, one in enumerate(found.subjects) if condition in one.conditions]
            values[own, c] = condition_values(found, condition, body)
        held[name] = (("subject", "condition", "column"), values.numpy())
    coords = {
        "subject": [one.name for one in found.subjects], "condition": list(found.names),
        "percent": np.linspace(0.0, 100.0, points), "course": [f"{c.where} {c.measure}" for c in courses],
        "column": [f"{c.where} {c.measure}" for c in columns_of(found)],
    }  # fmt: skip
    said = {"study": found.study.name, "units": "SI, rad", "convention": found.subjects[0].convention,
            "human": "demand minus the device's share", "per_mass": int(found.per_mass)}  # fmt: skip
    return xarray.Dataset(held, coords, said)
