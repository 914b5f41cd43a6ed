"""Files of an evaluation, beside those of its run."""

from dataclasses import asdict
from typing import Any

import numpy as np
import xarray

from torchid.config import Config
from torchid.cycles.cycles import APART
from torchid.evaluation.compared import Compared
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import Ledger
from torchid.evaluation.numbers import INTERVAL, all_numbers
from torchid.evaluation.report.page import render_evaluation
from torchid.evaluation.statistics.answers import BodyAnswer
from torchid.evaluation.statistics.comparing import Comparison, spans
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


def evaluation_table(found: Evaluation) -> dict[str, Any]:
    """Everything but courses; the keys other programs read are those of the contracts."""
    options = found.config.evaluate
    return {
        "subject": found.config.subject.name,
        "reference": found.reference,
        "conditions": {
            name: {
                "device": getattr(found.worn[name].device, "name", None),
                "trials": [trial.name for trial in found.trials if trial.condition == name],
                "cycles": found.conditions.count(name),
            }
            for name in found.config.conditions
        },
        "convention": options.convention,
        "signs": found.signs,
        "template_is": found.usual,
        "per_mass_kg": found.per_mass_kg,
        **answer_table(found, found.identified),
        "device": {name: worn.parameters for name, worn in found.worn.items() if worn.device is not None},
        "sheet": {
            name: [asdict(finding) for finding in worn.findings]
            for name, worn in found.worn.items()
            if worn.device is not None
        },
        "template": answer_table(found, found.template),
        **tests_table(found),
        "corrections": [asdict(one) for one in found.corrections],
        "contacts": [vars(one) for one in found.contacts],
        "cycles": [
            {"trial": c.trial, "condition": found.conditions[k], "side": c.side, "frames": [c.start, c.stop],
             "apart": float(found.apart[k]), "stands_apart": float(found.apart[k]) > APART}
            for k, c in enumerate(found.cycles)
        ],
    }  # fmt: skip


def answer_table(found: Evaluation, answer: BodyAnswer) -> dict[str, Any]:
    """``joints`` and ``differences`` of one body."""
    joints: dict[str, Any] = {}
    for condition in found.config.conditions:
        mean, own = answer.mean(condition, answer.sample.values, answer.sample.draws), answer.cycles_of(condition)
        for k, column in enumerate(answer.sample.columns):
            place = joints.setdefault(column.where, {}).setdefault(condition, {})
            place[column.measure] = {name: float(getattr(mean, name)[k]) for name in ("value", "sd", "low", "high")}
            place[column.measure]["cycles"] = int(answer.sample.values[own, k].isfinite().sum())
    rows = [difference_row(one, k, found.level) for one in answer.comparisons for k in range(len(one.columns))]
    return {"joints": joints, "differences": rows}


def tests_table(found: Compared) -> dict[str, Any]:
    """``courses``, ``test``, ``level`` and ``not_determinable``, which one subject and a study have alike."""
    return {
        "courses": [row for one in found.comparisons for row in _course_rows(one, found.level)],
        "test": {one.condition: _test(one, found.level) for one in found.comparisons},
        "level": found.level,
        "not_determinable": [{"what": gap.what, "why": gap.why} for gap in found.gaps],
    }


def difference_row(one: Comparison, k: int, level: float) -> dict[str, Any]:
    """One difference of a comparison.

    Args:
        k: number of its column.
        level: family-wise.
    """
    return {
        "condition": one.condition, "where": one.columns[k].where, "measure": one.columns[k].measure,
        **{name: float(getattr(one.difference, name)[k]) for name in ("value", "sd", "low", "high")},
        "p": float(one.tested.p[k]), "p_adjusted": float(one.tested.adjusted[k]),
        "hedges_g": {name: float(getattr(one.effect, name)[k]) for name in INTERVAL},
        "found": float(one.tested.adjusted[k]) <= level,
    }  # fmt: skip


def _course_rows(one: Comparison, level: float) -> list[dict[str, Any]]:
    return [
        {
            "condition": one.condition, "where": column.where, "course": column.measure,
            "p_adjusted": float(one.tested.courses[j]), "found": float(one.tested.courses[j]) <= level,
            "differs_percent": spans(one.tested.points[:, j] <= level),
        }
        for j, column in enumerate(one.courses)
    ]  # fmt: skip


def _test(one: Comparison, level: float) -> dict[str, Any]:
    first, second = one.units.counts
    return {
        "units": one.units.kind if one.testable else "none", "reference": first, "condition": second,
        "cycles_per_block": one.units.cycles_per_block, "least_p": one.least_p, "all_arrangements": one.complete,
        "testable": one.testable, "units_wanted": one.needed.units, "permutations_wanted": one.needed.permutations,
        "findings": len(one.found(level)), "course_findings": len(one.found_courses(level)),
        "said": one.needed.said or one.units.granted,
    }  # fmt: skip
