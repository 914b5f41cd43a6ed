"""Every number of a study, with its key and unit, for the ledger."""

import math
from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.ledger import BODIES, Key
from torchid.evaluation.numbers import COVERAGE, Entry, column_unit
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.evaluation.statistics.effects import Estimate, mean_of
from torchid.evaluation.study.compare import SubjectsComparison, course_of
from torchid.evaluation.study.study import Pooled
from torchid.evaluation.study.subject import SHARES
from torchid.evaluation.torque_shares.back import NIOSH_N

PRESSED = ("L5/S1", "peak_compression_N")
"""Where and measure of what is held against NIOSH's limit."""


def study_numbers(found: Pooled) -> Iterator[Entry]:
    """Key, value and unit of every number.

    Args:
        found: the study.
    """
    yield from _method(found)
    for body in BODIES:
        yield from _measures(found, body)
        for one in found.comparisons:
            yield from _differences(found, one, body)
    yield from _pressed(found)
    yield from _shares(found)
    yield from _courses(found)


def columns_of(found: Pooled) -> tuple[MeasureColumn, ...]:
    """Measures of all comparisons, in order.

    Args:
        found: the study.
    """
    return tuple(dict.fromkeys(column for one in found.comparisons for column in one.columns))


def condition_values(found: Pooled, condition: str, body: str) -> Float[Tensor, "subjects columns"]:
    """Means of the subjects that have a condition, NaN where one has none.

    Args:
        found: the study.
        condition: its name.
        body: identified or template.
    """
    rows = [
        [one.means[key].value if (key := (body, condition, c.where, c.measure)) in one.means else math.nan
         for c in columns_of(found)]
        for one in found.having(condition)
    ]  # fmt: skip
    return torch.tensor(rows, dtype=torch.float64)


def course_estimate(found: Pooled, one: SubjectsComparison, condition: str, share: str) -> Estimate:
    """Mean course over the subjects of a comparison with its interval, points times courses.

    Args:
        found: the study.
        one: the comparison.
        condition: its own or the reference.
        share: of ``SHARES``, or ``template``.
    """
    each = torch.stack([course_of(subject, condition, share, one.courses) for subject in one.subjects])
    return mean_of(each.flatten(1), None, COVERAGE)


def taken(found: Pooled, one: SubjectsComparison) -> tuple[list[str], Float[Tensor, "subjects coordinates"]]:
    """Coordinates, and the part of their load that the device takes, by subject; none where nothing was worn.

    Args:
        found: the study.
        one: the comparison.
    """
    if all(subject.devices[one.condition] is None for subject in one.subjects):
        return [], torch.zeros(len(one.subjects), 0, dtype=torch.float64)
    names = list(dict.fromkeys(w for subject in one.subjects for w in subject.courses[one.condition].taken))
    rows = [[subject.courses[one.condition].taken.get(w, math.nan) for w in names] for subject in one.subjects]
    return names, torch.tensor(rows, dtype=torch.float64)


def _method(found: Pooled) -> Iterator[Entry]:
    yield Key("method", "level"), found.study.level, ""
    yield Key("method", "coverage"), COVERAGE, ""
    yield Key("method", "subjects"), len(found.subjects), ""
    yield Key("method", "limit", "", *PRESSED), NIOSH_N, "N"
    for condition in found.conditions:
        yield Key("test", "recorded", condition), len(found.having(condition)), ""
    for one in found.comparisons:
        own = one.answers["identified"]
        yield Key("test", "subjects", one.condition), len(one.subjects), ""
        yield Key("test", "wanted", one.condition), one.wanted, ""
        yield Key("test", "permutations", one.condition), one.permutations, ""
        yield Key("test", "wanted_permutations", one.condition), one.wanted_permutations, ""
        yield Key("test", "least_p", one.condition), one.least_p, ""
        yield Key("test", "hypotheses", one.condition), int(own.tested.adjusted.isfinite().sum()), ""
        yield Key("test", "findings", one.condition), len(own.found(found.study.level)), ""


def _measures(found: Pooled, body: str) -> Iterator[Entry]:
    for condition in found.conditions:
        values = condition_values(found, condition, body)
        mean = mean_of(values, None, COVERAGE)
        for k, column in enumerate(columns_of(found)):
            key, unit = Key("measure", "", condition, column.where, column.measure, body), _unit(found, column)
            for name in ("value", "sd", "low", "high"):
                yield key._replace(statistic=name), float(getattr(mean, name)[k]), unit
            for subject, value in zip(found.having(condition), values[:, k].tolist(), strict=True):
                yield key._replace(statistic="value", item=subject.name), value, unit


def _differences(found: Pooled, one: SubjectsComparison, body: str) -> Iterator[Entry]:
    own = one.answers[body]
    for k, column in enumerate(one.columns):
        key, unit = Key("difference", "", one.condition, column.where, column.measure, body), _unit(found, column)
        for name in ("value", "sd", "low", "high"):
            yield key._replace(statistic=name), float(getattr(own.difference, name)[k]), unit
        for name, source in (("g", "value"), ("g_low", "low"), ("g_high", "high")):
            yield key._replace(statistic=name), float(getattr(own.effect, source)[k]), ""
        yield key._replace(statistic="p"), float(own.tested.p[k]), ""
        yield key._replace(statistic="p_adjusted"), float(own.tested.adjusted[k]), ""
        for name, count in zip(("agree", "subjects"), own.agreeing[k], strict=True):
            yield key._replace(statistic=name), count, ""
        for subject in one.subjects:
            each = subject.differences.get((body, one.condition, column.where, column.measure))
            for name in ("value", "low", "high"):
                value = math.nan if each is None else getattr(each, name)
                yield key._replace(statistic=name, item=subject.name), value, unit


def _pressed(found: Pooled) -> Iterator[Entry]:
    """Subjects of each condition whose low back is pressed beyond NIOSH's limit."""
    columns = columns_of(found)
    for k, column in enumerate(columns):
        if (column.where, column.measure) == PRESSED:
            for condition in found.conditions:
                own = condition_values(found, condition, "identified")[:, k]
                yield Key("measure", "above_limit", condition, *PRESSED), int((own > NIOSH_N).sum()), ""
                yield Key("measure", "known", condition, *PRESSED), int(own.isfinite().sum()), ""


def _shares(found: Pooled) -> Iterator[Entry]:
    for one in found.comparisons:
        names, values = taken(found, one)
        mean = mean_of(values, None, COVERAGE)
        for k, where in enumerate(names):
            key = Key("device", "", one.condition, where, "load_taken")
            for name in ("value", "low", "high"):
                yield key._replace(statistic=name), float(getattr(mean, name)[k]), ""
            for subject, value in zip(one.subjects, values[:, k].tolist(), strict=True):
                yield key._replace(statistic="value", item=subject.name), value, ""


def _courses(found: Pooled) -> Iterator[Entry]:
    for one in found.comparisons:
        for condition in (one.reference, one.condition):
            for share in (*SHARES, "template"):
                mean = course_estimate(found, one, condition, share)
                yield from _course(found, one, condition, share, mean)
        for k, row in enumerate(one.differing.tolist()):
            item = f"{100.0 * k / (len(one.differing) - 1):g}"
            for column, p in zip(one.courses, row, strict=True):
                yield Key("course", "p_adjusted", one.condition, column.where, column.measure, item=item), p, ""


def _course(
    found: Pooled, one: SubjectsComparison, condition: str, share: str, mean: Estimate
) -> Iterator[Entry]:  # fmt: skip
    """The reference's courses stand once beside each condition, since comparisons may have other subjects each."""
    width = len(one.courses)
    section = "course" if share in ("human", "template") else f"course_{share}"
    name = condition if condition == one.condition else f"{one.reference} beside {one.condition}"
    body = "template" if share == "template" else "identified"
    for at in range(len(mean.value)):
        column = one.courses[at % width]
        item = f"{100.0 * (at // width) / (len(mean.value) // width - 1):g}"
        key = Key(section, "", name, column.where, column.measure, body, item)
        for statistic in ("value", "low", "high"):
            yield key._replace(statistic=statistic), float(getattr(mean, statistic)[at]), _unit(found, column)


def _unit(found: Pooled, column: MeasureColumn) -> str:
    return column_unit(column, found.per_mass)
