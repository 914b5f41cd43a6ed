"""Strides of a cohort's people as its tables have them: a row of measures and of mean courses for each person."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.cohort.cohort import NAME
from torchid.cycles.measures import STRIDE
from torchid.errors import InputError
from torchid.evaluation.compared import Gap
from torchid.evaluation.report.words import WHOLE_BODY
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.storage.files import safe_name
from torchid.wording import listing

COURSES = {"angle_deg": "angle_deg", "torque_Nm": "moment_Nm"}
"""Choice. Courses that are compared, with their columns in the table; powers are products of both."""
TABLES = ("cycles.csv", "results.csv")
"""Of each person's folder."""


@dataclass(frozen=True)
class WalkingGroups:
    """People of a cohort, each with a group and the means of all strides of both legs; NaN where one has none."""

    people: tuple[str, ...]
    """Names."""
    groups: tuple[str, ...]
    """Group of each."""
    columns: tuple[MeasureColumn, ...]
    """What ``values`` hold."""
    values: Float[Tensor, "people columns"]
    """Measures of strides, and ranges and extremes of courses; moments per kilogram of identified mass."""
    courses: tuple[MeasureColumn, ...]
    """What ``curves`` hold."""
    curves: Float[Tensor, "people points courses"]
    """Mean courses over a stride."""
    left_out: tuple[Gap, ...]
    """Who has no part in it, and why."""


def refuse_no_cohort(folder: Path) -> None:
    """Refuse a folder that ``torchid cohort`` has not written, before anything is written into it.

    Args:
        folder: in question.

    Raises:
        InputError: ``groups.no_cohort``.
    """
    if not (folder / f"{NAME}.csv").is_file():
        raise InputError(
            "groups.no_cohort", "this folder is no finished cohort", source=folder, found=f"no {NAME}.csv",
            remedy="Name the folder that `torchid cohort -o` has written, or a config of an evaluation",
        )  # fmt: skip


def read_groups(folder: Path) -> WalkingGroups:
    """Return the people of a finished cohort who have a group and strides.

    Args:
        folder: of the cohort.

    Raises:
        InputError: ``groups.no_cohort``; ``groups.unreadable`` where a table cannot be read; ``groups.nobody`` where
            nobody has a group and strides.
    """
    refuse_no_cohort(folder)
    with _reading(folder / f"{NAME}.csv", "it"):
        table = _table(folder / f"{NAME}.csv").fillna({"group": ""})
        aside = table["status"] != "done"
        gaps = [Gap(name, "set aside by the cohort") for name in table[aside]["subject"]]
        people = list(zip(*(table[name][~aside] for name in ("subject", "group", "mass_kg")), strict=True))
    found = []
    for name, group, mass_kg in people:
        own = folder / safe_name(name)
        if not group:
            gaps.append(Gap(name, "no group in the cohort's table"))
        elif not all((own / one).is_file() for one in TABLES):
            gaps.append(Gap(name, "no strides: nobody walks there, or the model lacks a leg"))
        else:
            if not math.isfinite(mass_kg):
                gaps.append(Gap(f"moments of {name}", "no mass was identified"))
            with _reading(own, "the folder"):
                found.append((name, group, *_person(own, mass_kg)))
    if not found:
        said = listing([f"{gap.what}: {gap.why}" for gap in gaps], 3)
        raise InputError(
            "groups.nobody", "nobody in this cohort has a group and strides", source=folder / f"{NAME}.csv", found=said,
            remedy="Fill the column `group` of the table of subjects with two names or more, and call `torchid cohort` "
            "again: nothing is run twice",
        )  # fmt: skip
    names, groups, scalars, courses = zip(*found, strict=True)
    measures, joints = _columns(scalars), _columns(courses)
    return WalkingGroups(
        names, groups, measures, torch.tensor([[one.get(c, np.nan) for c in measures] for one in scalars]).double(),
        joints, torch.stack([_stacked(one, joints) for one in courses]), tuple(gaps),
    )  # fmt: skip


def _columns(some: tuple[dict[MeasureColumn, object], ...]) -> tuple[MeasureColumn, ...]:
    return tuple(dict.fromkeys(column for one in some for column in one))


def _stacked(one: dict[MeasureColumn, np.ndarray], joints: tuple[MeasureColumn, ...]) -> Tensor:
    blank = np.full_like(next(iter(one.values())), np.nan)
    return torch.tensor(np.stack([one.get(column, blank) for column in joints], 1)).double()


@contextmanager
def _reading(place: Path, what: str) -> Iterator[None]:
    """Turns what is wrong with tables into InputError ``groups.unreadable``."""
    try:
        yield
    except (OSError, ValueError, KeyError) as error:
        # A damaged file is nobody's to overwrite, and a run is done again where its report is gone.
        raise InputError(
            "groups.unreadable", "a table of the cohort cannot be read", source=place, found=str(error)[:80],
            remedy=f"Remove {what} and call `torchid cohort` again: it writes what is missing",
        ) from None  # fmt: skip


def _table(path: Path) -> pd.DataFrame:
    # Only an empty cell is no text: somebody may be called NA, and a group None.
    return pd.read_csv(path, dtype={"subject": str, "group": str}, keep_default_na=False, na_values=[""])


def _person(folder: Path, mass_kg: float) -> tuple[dict[MeasureColumn, float], dict[MeasureColumn, np.ndarray]]:
    """Measures and mean courses of one person."""
    cycles, results = (_table(folder / name) for name in TABLES)
    strides = results[results["group"] == "stride"]
    quantity, value = np.array(strides["quantity"], str), np.array(strides["value"], float)
    scalars = {MeasureColumn(WHOLE_BODY, name): _mean(value[quantity == name]) for name in STRIDE if name in quantity}
    courses: dict[MeasureColumn, np.ndarray] = {}
    joints = list(dict.fromkeys(cycles["joint"]))
    shape = (-1, len(set(cycles["percent"])), len(joints))  # as a run writes it: strides, points, joints
    angles, moments = (np.array(cycles[name], float).reshape(shape) for name in COURSES.values())
    for k, joint in enumerate(joints):
        angle, moment = angles[..., k], moments[..., k] / mass_kg
        scalars[MeasureColumn(joint, "range_deg")] = _mean(np.ptp(angle, 1))
        # A stride whose moment is not all known may lack its peak.
        scalars[MeasureColumn(joint, "max_torque_Nm")] = _mean(moment.max(1))
        scalars[MeasureColumn(joint, "min_torque_Nm")] = _mean(moment.min(1))
        for measure, own in zip(COURSES, (angle, moment), strict=True):
            courses[MeasureColumn(joint, measure)] = np.array([_mean(point) for point in own.T])
    return scalars, courses


def _mean(values: np.ndarray) -> float:
    """Mean of what is known; NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def counts_of(groups: tuple[str, ...]) -> str:
    """Return how many people each group has, as a list.

    Args:
        groups: group of each person.
    """
    return listing([f"{name}: {groups.count(name)}" for name in dict.fromkeys(groups)], 6)
