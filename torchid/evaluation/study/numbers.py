"""Every number of a study, with its key and unit, for the ledger."""

import math
from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.ledger import BODIES, Key
from torchid.evaluation.numbers import (
    INTERVAL,
    PRESSED,
    Entry,
    column_unit,
    common_numbers,
    course_numbers,
    difference_numbers,
    interval_numbers,
)
from torchid.evaluation.statistics.comparing import Comparison, MeasureColumn
from torchid.evaluation.statistics.effects import mean_of
from torchid.evaluation.study.study import Pooled
from torchid.evaluation.study.subject import SHARES
from torchid.evaluation.torque_shares.back import NIOSH_N


def study_numbers(found: Pooled) -> Iterator[Entry]:
    """Key, value and unit of every number."""
    yield from common_numbers(found)
    for condition in found.names:
        yield Key("test", "recorded", condition), len(found.having(condition)), ""
    for body in BODIES:
        yield from _measures(found, body)
        for one in found.answers[body]:
            yield from _differences(found, one, body)
    yield from _pressed(found)
    yield from _shares(found)
    yield from _courses(found)


def columns_of(found: Pooled) -> tuple[MeasureColumn, ...]:
    """Measures of all comparisons, in order."""
    return tuple(dict.fromkeys(column for one in found.comparisons for column in one.columns))


def condition_values(found: Pooled, condition: str, body: str) -> Float[Tensor, "subjects columns"]:
    """Means of the subjects that have a condition, NaN where one has none.

    Args:
        body: identified or template.
    """
    rows = [
        [one.means[key].value if (key := (body, condition, c.where, c.measure)) in one.means else math.nan
         for c in columns_of(found)]
        for one in found.having(condition)
    ]  # fmt: skip
    return torch.tensor(rows, dtype=torch.float64)


def taken(found: Pooled, one: Comparison) -> tuple[list[str], Float[Tensor, "subjects coordinates"]]:
    """Coordinates, and the part of their load that the device takes, by subject; none where nothing was worn."""
    if all(subject.devices[one.condition] is None for subject in found.having(one.condition)):
        return [], torch.zeros(len(found.having(one.condition)), 0, dtype=torch.float64)
    names = list(
        dict.fromkeys(w for subject in found.having(one.condition) for w in subject.courses[one.condition].taken)
    )
    rows = [
        [subject.courses[one.condition].taken.get(w, math.nan) for w in names]
        for subject in found.having(one.condition)
    ]
    return names, torch.tensor(rows, dtype=torch.float64)


def _measures(found: Pooled, body: str) -> Iterator[Entry]:
    for condition in found.names:
        values = condition_values(found, condition, body)
        mean = mean_of(values, None)
        for k, column in enumerate(columns_of(found)):
            key = Key("measure", "value", condition, column.where, column.measure, body)
            unit = column_unit(column, found.per_mass)
            yield from interval_numbers(key, mean, k, unit)
            yield key._replace(statistic="sd"), float(mean.sd[k]), unit
            for subject, value in zip(found.having(condition), values[:, k].tolist(), strict=True):
                yield key._replace(item=subject.name), value, unit


def _differences(found: Pooled, one: Comparison, body: str) -> Iterator[Entry]:
    yield from difference_numbers(one, body, found.per_mass)
    for k, column in enumerate(one.columns):
        key = Key("difference", "", one.condition, column.where, column.measure, body)
        unit = column_unit(column, found.per_mass)
        for name, count in zip(("agree", "subjects"), one.agreeing[k], strict=True):
            yield key._replace(statistic=name), count, ""
        for subject in found.having(one.condition):
            each = subject.differences.get((body, one.condition, column.where, column.measure))
            for name in INTERVAL:
                value = math.nan if each is None else getattr(each, name)
                yield key._replace(statistic=name, item=subject.name), value, unit


def _pressed(found: Pooled) -> Iterator[Entry]:
    """Subjects of each condition whose low back is pressed beyond NIOSH's limit."""
    columns = columns_of(found)
    for k, column in enumerate(columns):
        if (column.where, column.measure) == PRESSED:
            for condition in found.names:
                own = condition_values(found, condition, "identified")[:, k]
                yield Key("measure", "above_limit", condition, *PRESSED), int((own > NIOSH_N).sum()), ""
                yield Key("measure", "known", condition, *PRESSED), int(own.isfinite().sum()), ""


def _shares(found: Pooled) -> Iterator[Entry]:
    for one in found.comparisons:
        names, values = taken(found, one)
        mean = mean_of(values, None)
        for k, where in enumerate(names):
            key = Key("device", "", one.condition, where, "load_taken")
            yield from interval_numbers(key, mean, k, "")
            for subject, value in zip(found.having(one.condition), values[:, k].tolist(), strict=True):
                yield key._replace(statistic="value", item=subject.name), value, ""


def _courses(found: Pooled) -> Iterator[Entry]:
    """The reference's courses stand once beside each condition, since comparisons may have other subjects each."""
    for one in found.comparisons:
        for condition in (one.reference, one.condition):
            name = condition if condition == one.condition else f"{one.reference} beside {one.condition}"
            for share in (*SHARES, "template"):
                section = "course" if share in ("human", "template") else f"course_{share}"
                key = Key(section, "", name, body="template" if share == "template" else "identified")
                yield from course_numbers(key, one, found.course(one, condition, share), found.per_mass)
