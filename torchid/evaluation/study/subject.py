"""One subject of a study: what the files of its finished evaluation say."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import xarray
from jaxtyping import Float
from torch import Tensor

from torchid.cycles.conventions import side_of
from torchid.errors import InputError
from torchid.evaluation.ledger import BODIES
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.evaluation.statistics.units import trial_units, unit_means
from torchid.storage.files import safe_name

FILE = "evaluation.json"
SHARES = ("human", "demand", "device")
"""Courses of torque with the identified body, as ``cycles_<condition>.nc`` calls them."""
Number = tuple[str, str, str, str]
"""Body, condition, where, measure."""


@dataclass(frozen=True)
class NumberInterval:
    """A number with its interval within the subject; NaN where there is none."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class ConditionCourses:
    """Means over the trials of a condition, each of the means over its cycles."""

    columns: tuple[MeasureColumn, ...]
    mean: dict[str, Float[Tensor, "points courses"]]
    """By ``SHARES``, and ``template``: the human's with the scaled template, or the model as shipped."""
    taken: dict[str, float]
    """Part of the load on each coordinate that the device takes: 1 - int |human| dt / int |demand| dt, all cycles."""


@dataclass(frozen=True)
class StudySubject:
    """What one finished evaluation says."""

    name: str
    folder: Path
    reference: str
    devices: dict[str, str | None]
    """Name of what was worn, by condition."""
    convention: str
    signs: str
    """Whose names and signs coordinates have (``Evaluation.signs``)."""
    usual: str
    """What the identified body is held against (``Evaluation.usual``)."""
    per_mass: bool
    means: dict[Number, NumberInterval]
    differences: dict[Number, NumberInterval]
    """Of a condition from the reference."""
    courses: dict[str, ConditionCourses]
    gaps: tuple[tuple[str, str], ...]
    """What it cannot say, and why."""
    corrections: tuple[str, ...] = ()
    """What the diagnosis of its recordings corrected."""

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the conditions, the reference among them."""
        return tuple(self.devices)


def read_subject(folder: Path) -> StudySubject:
    """Read a finished evaluation.

    Args:
        folder: its ``out``.

    Raises:
        InputError: ``study.subject`` where there is none, or its files are damaged.
    """
    try:
        table = json.loads((folder / FILE).read_text(encoding="utf-8"))
        courses = {name: _courses(folder / f"cycles_{safe_name(name)}.nc") for name in table["conditions"]}
        return _subject(table, folder, courses)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            "study.subject", "this folder has no finished evaluation", source=folder, found=str(error)[:120],
            remedy="Run `torchid evaluate` on that subject's config first, or list the config in its place",
        ) from error  # fmt: skip


def _subject(table: dict[str, Any], folder: Path, courses: dict[str, ConditionCourses]) -> StudySubject:
    means, differences = {}, {}
    for body, answer in zip(BODIES, (table, table["template"]), strict=True):
        for where, conditions in answer["joints"].items():
            for condition, measures in conditions.items():
                for measure, one in measures.items():
                    means[body, condition, where, measure] = _interval(one)
        for row in answer["differences"]:
            differences[body, row["condition"], row["where"], row["measure"]] = _interval(row)
    return StudySubject(
        str(table["subject"]), folder, table["reference"],
        {name: one["device"] for name, one in table["conditions"].items()},
        table["convention"], table["signs"], table["template_is"],
        table["per_mass_kg"] is not None, means, differences, courses,
        tuple((gap["what"], gap["why"]) for gap in table["not_determinable"]),
        tuple(one["what"] for one in table.get("corrections", ())),
    )  # fmt: skip


def _interval(row: dict[str, Any]) -> NumberInterval:
    value, low, high = (math.nan if row[name] is None else float(row[name]) for name in ("value", "low", "high"))
    return NumberInterval(value, low, high)


def _courses(path: Path) -> ConditionCourses:
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        columns = tuple(_column(str(name)) for name in data["course"].values)
        lasting = torch.tensor(data["duration"].values, dtype=torch.float64)
        trials, sides = ([str(x) for x in data[name].values] for name in ("trial", "side"))
        held = {name: torch.tensor(data[name].values, dtype=torch.float64) for name in (*SHARES, "human_template")}
    foreign = torch.tensor([[bool(s and c.side) and s != c.side for c in columns] for s in sides], dtype=torch.bool)
    held = {name: x.masked_fill(foreign[:, None, :], torch.nan) for name, x in held.items()}
    mean = {name: _over_trials(x, trials) for name, x in held.items()}
    mean["template"] = mean.pop("human_template")
    loads = torch.stack([torch.trapezoid(held[name].abs(), dim=1) * lasting[:, None] for name in ("human", "demand")])
    human, demand = torch.where(loads.isfinite().all(0), loads, 0.0).sum(1)
    share = torch.where(demand > 0.0, 1.0 - human / demand, torch.nan)
    taken = {c.where: float(share[k]) for k, c in enumerate(columns) if c.measure == "torque_Nm"}
    return ConditionCourses(columns, mean, taken)


def _over_trials(
    courses: Float[Tensor, "cycles points courses"], trials: list[str]
) -> Float[Tensor, "points courses"]:  # fmt: skip
    return unit_means(courses.flatten(1), trial_units(trials)).nanmean(0).reshape(courses.shape[1:])


def _column(name: str) -> MeasureColumn:
    where, _, measure = name.rpartition(" ")
    return MeasureColumn(where, measure, side_of(where))
