"""Content of ``subjects.json`` and ``subjects.nc``."""

from typing import Any

import numpy as np
import torch
import xarray

from torchid.evaluation.study.compare import StudyAnswer, SubjectsComparison, course_of
from torchid.evaluation.study.numbers import columns_of, condition_values, taken
from torchid.evaluation.study.study import Pooled
from torchid.evaluation.study.subject import SHARES


def study_table(found: Pooled) -> dict[str, Any]:
    """Everything but courses, by the names that ``evaluation.json`` has for them.

    Args:
        found: the study.
    """
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
        "test": {
            one.condition: {
                "subjects": [subject.name for subject in one.subjects], "least_p": one.least_p,
                "subjects_wanted": one.wanted, "permutations_wanted": one.wanted_permutations,
                "testable": one.testable,
                "findings": len(one.answers["identified"].found(found.study.level)),
            }
            for one in found.comparisons
        },
        "level": found.study.level,
        "not_determinable": [{"what": gap.what, "why": gap.why} for gap in found.gaps],
    }  # fmt: skip


def _rows(found: Pooled, body: str) -> list[dict[str, Any]]:
    return [_row(one, one.answers[body], k, found.study.level)
            for one in found.comparisons for k in range(len(one.columns))]  # fmt: skip


def _row(one: SubjectsComparison, own: StudyAnswer, k: int, level: float) -> dict[str, Any]:
    return {
        "condition": one.condition, "where": one.columns[k].where, "measure": one.columns[k].measure,
        **{name: float(getattr(own.difference, name)[k]) for name in ("value", "sd", "low", "high")},
        "p": float(own.tested.p[k]), "p_adjusted": float(own.tested.adjusted[k]),
        "hedges_g": {name: float(getattr(own.effect, name)[k]) for name in ("value", "low", "high")},
        "agree": own.agreeing[k][0], "subjects": own.agreeing[k][1],
        "each": {subject.name: value for subject, value in zip(one.subjects, own.values[:, k].tolist(), strict=True)},
        "found": float(own.tested.adjusted[k]) <= level,
    }  # fmt: skip


def _taken(found: Pooled, one: SubjectsComparison) -> dict[str, dict[str, float]]:
    names, values = taken(found, one)
    return {w: {s.name: float(values[j, k]) for j, s in enumerate(one.subjects)} for k, w in enumerate(names)}


def study_dataset(found: Pooled) -> xarray.Dataset:
    """Measures and mean courses of every subject under every condition; NaN where one has none.

    Args:
        found: the study.
    """
    courses = tuple(dict.fromkeys(column for one in found.comparisons for column in one.courses))
    points = len(found.comparisons[0].differing)
    by_course = ("subject", "condition", "percent", "course")
    held: dict[str, Any] = {
        ("human_template" if share == "template" else share): (by_course, np.stack([
            np.stack([
                course_of(one, c, share, courses).numpy() if c in one.conditions
                else np.full((points, len(courses)), np.nan) for c in found.conditions
            ]) for one in found.subjects
        ])) for share in (*SHARES, "template")
    }  # fmt: skip
    for name, body in (("measure", "identified"), ("measure_template", "template")):
        values = torch.full((len(found.subjects), len(found.conditions), len(columns_of(found))), torch.nan).double()
        for c, condition in enumerate(found.conditions):
            own = [k for k, one in enumerate(found.subjects) if condition in one.conditions]
            values[own, c] = condition_values(found, condition, body)
        held[name] = (("subject", "condition", "column"), values.numpy())
    coords = {
        "subject": [one.name for one in found.subjects], "condition": list(found.conditions),
        "percent": np.linspace(0.0, 100.0, points), "course": [f"{c.where} {c.measure}" for c in courses],
        "column": [f"{c.where} {c.measure}" for c in columns_of(found)],
    }  # fmt: skip
    said = {"study": found.study.name, "units": "SI, rad", "convention": found.subjects[0].convention,
            "human": "demand minus the device's share", "per_mass": int(found.per_mass)}  # fmt: skip
    return xarray.Dataset(held, coords, said)
