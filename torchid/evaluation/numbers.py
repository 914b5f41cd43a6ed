"""Every number of an evaluation, with its key and unit, for the ledger."""

from collections.abc import Iterator

import torch
from torch import Tensor

from torchid.evaluation.cycle_measures.cycles import APART
from torchid.evaluation.cycle_measures.layout import BACK
from torchid.evaluation.cycle_measures.measures import divides_by_mass, unit_of
from torchid.evaluation.evaluation import BodyAnswer, Evaluation
from torchid.evaluation.ledger import BODIES, Key
from torchid.evaluation.statistics.answers import sided_courses
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.evaluation.statistics.effects import Estimate, mean_of
from torchid.evaluation.statistics.units import Units, trial_units, unit_means
from torchid.evaluation.torque_shares.back import NIOSH_N

Entry = tuple[Key, float, str]
COVERAGE = 0.95
"""Choice. Of all intervals and bands."""


def all_numbers(found: Evaluation) -> Iterator[Entry]:
    """Key, value and unit of every number.

    Args:
        found: the evaluation.
    """
    yield from _method(found)
    yield from _cycles(found)
    yield from _contacts(found)
    yield from _device(found)
    for body, answer in zip(BODIES, (found.identified, found.template), strict=True):
        yield from _measures(found, answer, body)
        yield from _differences(found, answer, body)
        yield from _courses(found, answer, body)


def unit(found: Evaluation, column: MeasureColumn) -> str:
    """Unit of a column.

    Args:
        found: the evaluation, which may divide by mass.
        column: of measures or courses.
    """
    return column_unit(column, found.per_mass_kg is not None)


def column_unit(column: MeasureColumn, per_mass: bool) -> str:
    """Unit of a column.

    Args:
        column: of measures or courses.
        per_mass: whether torques are divided by mass; compression, which is judged against a limit in newtons, is not.
    """
    own = unit_of(column.measure)
    back = column.where == BACK and own == "N"
    return f"{own}/kg" if per_mass and divides_by_mass(column.measure) and not back else own


def condition_units(answer: BodyAnswer, condition: str) -> tuple[list[int], Units]:
    """Cycles of a condition, and their trials as units.

    Args:
        answer: of one body.
        condition: its name.
    """
    own = [k for k, name in enumerate(answer.sample.conditions) if name == condition]
    return own, trial_units([answer.sample.trials[k] for k in own])


def condition_means(answer: BodyAnswer, condition: str) -> Estimate:
    """Mean of every column over the trials of a condition; over its cycles where there is one trial.

    Args:
        answer: of one body.
        condition: its name.
    """
    own, units = condition_units(answer, condition)
    values = answer.sample.values[own]
    draws = None if answer.sample.draws is None else answer.sample.draws[:, own]
    if len(units.second) > 1:
        values = unit_means(values, units)
        draws = None if draws is None else unit_means(draws, units)
    return mean_of(values, draws, COVERAGE)


def course_means(answer: BodyAnswer, courses: Tensor, draws: Tensor | None, condition: str) -> Estimate:
    """Mean course of a condition with its band, flattened to points times courses.

    Args:
        answer: of one body.
        courses: of all cycles, NaN where a cycle is of the other side.
        draws: the same with other bodies.
        condition: its name.
    """
    own, units = condition_units(answer, condition)
    values = courses[own].flatten(1)
    drawn = None if draws is None else draws[:, own].flatten(2)
    if len(units.second) > 1:
        values = unit_means(values, units)
        drawn = None if drawn is None else unit_means(drawn, units)
    return mean_of(values, drawn, COVERAGE)


def _method(found: Evaluation) -> Iterator[Entry]:
    options = found.config.evaluate
    yield Key("method", "level"), options.level, ""
    yield Key("method", "coverage"), COVERAGE, ""
    yield Key("method", "draws"), 0 if found.identified.rows.draws is None else options.draws, ""
    yield Key("method", "apart"), APART, ""
    yield Key("method", "limit", where="L5/S1", measure="peak_compression_N"), NIOSH_N, "N"
    for name, value in zip(("lever_low", "lever_high"), options.lever_arm_m, strict=True):
        yield Key("method", name, where="L5/S1"), value, "m"
    if found.per_mass_kg is not None:
        yield Key("method", "mass"), found.per_mass_kg, "kg"
    for one in found.identified.comparisons:
        second = int(one.units.second.sum())
        yield Key("test", "units_reference", one.condition), len(one.units.second) - second, ""
        yield Key("test", "units", one.condition), second, ""
        yield Key("test", "cycles_per_block", one.condition), one.units.cycles_per_block, ""
        yield Key("test", "least_p", one.condition), one.least_p, ""
        yield Key("test", "hypotheses", one.condition), int(torch.isfinite(one.tested.adjusted).sum()), ""
        yield Key("test", "findings", one.condition), len(one.found(options.level)), ""


def _cycles(found: Evaluation) -> Iterator[Entry]:
    for condition in found.config.conditions:
        own = [k for k, name in enumerate(found.conditions) if name == condition]
        yield Key("cycle", "trials", condition), len([t for t in found.trials if t.condition == condition]), ""
        yield Key("cycle", "cycles", condition), len(own), ""
        yield Key("cycle", "apart", condition), int((found.apart[own] > APART).sum()), ""
    seen: dict[str, int] = {}
    times = {trial.name: trial.followed.motion.time for trial in found.trials}
    for k, cycle in enumerate(found.cycles):
        seen[cycle.trial] = seen.get(cycle.trial, 0) + 1
        item = cycle_name(cycle.trial, seen[cycle.trial], cycle.side)
        for name, frame in (("t0", cycle.start), ("t1", cycle.stop)):
            yield Key("cycle", name, found.conditions[k], item=item), float(times[cycle.trial][frame]), "s"
        yield Key("cycle", "score", found.conditions[k], item=item), float(found.apart[k]), ""


def cycle_name(trial: str, count: int, side: str) -> str:
    """Name of a cycle: trial, number within it, side.

    Args:
        trial: its name.
        count: from one.
        side: l, r or empty.
    """
    return f"{trial}_{count}{side}"


def _contacts(found: Evaluation) -> Iterator[Entry]:
    for one in found.contacts:
        yield Key("contact", "frames", one.condition, item=one.foot), one.frames, ""
        for name in ("measured", "shared", "beside"):
            yield Key("contact", name, one.condition, item=one.foot), getattr(one, name), ""


def _device(found: Evaluation) -> Iterator[Entry]:
    """What the device takes of every coordinate's load, and its parameters."""
    rows, layout = found.identified.rows, found.layout
    for condition, worn in found.worn.items():
        if worn.device is None:
            continue
        own = [k for k, name in enumerate(found.conditions) if name == condition]
        for j, (name, side) in enumerate(zip(layout.names, layout.sides, strict=True)):
            mine = [k for k in own if not side or not found.cycles[k].side or found.cycles[k].side == side]
            yield Key("device", "peak", condition, name, "torque_Nm"), _peak(rows.device[mine, :, j]), found.unit("N m")
            load = rows.device_load[mine, j].nanmean()
            yield Key("device", "load_taken", condition, name, "cumulative_load_Nms"), float(load), found.unit("N m s")
        for key, parameter in worn.parameters.items():
            for name in ("value", "sd"):
                if name in parameter:
                    yield Key("device", name, condition, item=key), float(parameter[name]), ""


def _peak(courses: Tensor) -> float:
    """Mean over cycles of the largest size."""
    return float(courses.abs().amax(1).nanmean()) if len(courses) else torch.nan


def _measures(found: Evaluation, answer: BodyAnswer, body: str) -> Iterator[Entry]:
    for condition in found.config.conditions:
        own, _ = condition_units(answer, condition)
        mean = condition_means(answer, condition)
        for k, column in enumerate(answer.sample.columns):
            key = Key("measure", "", condition, column.where, column.measure, body)
            for name in ("value", "sd", "low", "high"):
                yield key._replace(statistic=name), float(getattr(mean, name)[k]), unit(found, column)
            count = int(torch.isfinite(answer.sample.values[own, k]).sum())
            yield key._replace(statistic="cycles"), count, ""


def _differences(found: Evaluation, answer: BodyAnswer, body: str) -> Iterator[Entry]:
    for one in answer.comparisons:
        for k, column in enumerate(one.columns):
            key, own = Key("difference", "", one.condition, column.where, column.measure, body), unit(found, column)
            for name in ("value", "sd", "low", "high"):
                yield key._replace(statistic=name), float(getattr(one.difference, name)[k]), own
            for name, source in (("g", "value"), ("g_low", "low"), ("g_high", "high")):
                yield key._replace(statistic=name), float(getattr(one.effect, source)[k]), ""
            yield key._replace(statistic="p"), float(one.tested.p[k]), ""
            yield key._replace(statistic="p_adjusted"), float(one.tested.adjusted[k]), ""


def _courses(found: Evaluation, answer: BodyAnswer, body: str) -> Iterator[Entry]:
    rows, columns = answer.rows, found.layout.courses
    human = sided_courses(rows.human, found.layout, found.cycles)
    points = human.shape[1]
    for condition in found.config.conditions:
        mean = course_means(answer, human, rows.human_draws, condition)
        for k in range(points):
            for j, column in enumerate(columns):
                item = f"{100.0 * k / (points - 1):g}"
                key = Key("course", "", condition, column.where, column.measure, body, item)
                for name in ("value", "low", "high"):
                    yield (
                        key._replace(statistic=name),
                        float(getattr(mean, name)[k * len(columns) + j]),
                        unit(found, column),
                    )
