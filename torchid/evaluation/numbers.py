"""Every number of an evaluation, with its key and unit, for the ledger."""

from collections import Counter
from collections.abc import Iterator

import torch
from torch import Tensor

from torchid.cycles.cycles import APART
from torchid.cycles.measures import divides_by_mass, unit_of
from torchid.evaluation.compared import Compared
from torchid.evaluation.cycle_measures.layout import BACK
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import BODIES, Key
from torchid.evaluation.loads import beyond_need, load_change
from torchid.evaluation.statistics.answers import BodyAnswer
from torchid.evaluation.statistics.comparing import Comparison, MeasureColumn
from torchid.evaluation.statistics.effects import COVERAGE, Estimate
from torchid.evaluation.torque_shares.back import NIOSH_N

Entry = tuple[Key, float, str]
INTERVAL = ("value", "low", "high")
PRESSED = ("L5/S1", "peak_compression_N")
"""Where and measure of what is held against NIOSH's limit."""


def all_numbers(found: Evaluation) -> Iterator[Entry]:
    """Key, value and unit of every number."""
    yield from common_numbers(found)
    yield from _method(found)
    yield from _cycles(found)
    yield from _contacts(found)
    yield from _device(found)
    for body, answer in zip(BODIES, (found.identified, found.template), strict=True):
        yield from _measures(found, answer, body)
        for one in answer.comparisons:
            yield from difference_numbers(one, body, found.per_mass)
    for one in found.comparisons:
        yield from _courses(found, one, one.condition)
    yield from _courses(found, found.comparisons[0], found.reference)


def common_numbers(found: Compared) -> Iterator[Entry]:
    """Numbers of method, tests and p-values of courses, which one subject and a study have alike."""
    yield Key("method", "level"), found.level, ""
    yield Key("method", "coverage"), COVERAGE, ""
    yield Key("method", "limit", "", *PRESSED), NIOSH_N, "N"
    for one in found.comparisons:
        counts, courses, loads = one.units.counts, one.tested.courses, load_change(one, found.level)
        said = {
            "units_reference": counts[0], "units": counts[1], "cycles_per_block": one.units.cycles_per_block,
            "least_p": one.least_p, "hypotheses": int(one.tested.adjusted.isfinite().sum()),
            "findings": len(one.found(found.level)), "courses": int(courses.isfinite().sum()),
            "course_findings": len(one.found_courses(found.level)), "loads": len(loads.tested),
            "loads_lower": len(loads.lower), "loads_higher": len(loads.higher),
        }  # fmt: skip
        yield from ((Key("test", name, one.condition), value, "") for name, value in said.items())
        yield from _course_tests(one)
        if found.devices(one.condition):
            yield from _beyond(found, one)


def _course_tests(one: Comparison) -> Iterator[Entry]:
    for j, column in enumerate(one.courses):
        key = Key("course", "p_adjusted", one.condition, column.where, column.measure)
        yield key, float(one.tested.courses[j]), ""
        for k, p in enumerate(one.tested.points[:, j].tolist()):
            yield key._replace(item=percent_of(k, len(one.tested.points))), p, ""


def percent_of(point: int, points: int) -> str:
    """A point of the cycle in percent, as keys have it.

    Args:
        point: from zero.
    """
    return f"{100.0 * point / (points - 1):g}"


def _beyond(found: Compared, one: Comparison) -> Iterator[Entry]:
    """Of every coordinate, where the device gives more than is needed."""
    human, demand, device = (found.course(one, one.condition, share) for share in ("human", "demand", "device"))
    part, back = beyond_need(human, demand.value, device.value, len(one.tested.points))
    for j, column in enumerate(one.courses):
        if column.measure == "torque_Nm":
            key = Key("device", "beyond_part", one.condition, column.where, column.measure)
            yield key, float(part[j]), ""
            yield key._replace(statistic="beyond_torque"), float(back[j]), column_unit(column, found.per_mass)


def difference_numbers(one: Comparison, body: str, per_mass: bool) -> Iterator[Entry]:
    """Numbers of all differences of a comparison.

    Args:
        body: identified or template.
    """
    for k, column in enumerate(one.columns):
        key = Key("difference", "", one.condition, column.where, column.measure, body)
        own = column_unit(column, per_mass)
        yield from interval_numbers(key, one.difference, k, own)
        yield key._replace(statistic="sd"), float(one.difference.sd[k]), own
        for name, source in (("g", "value"), ("g_low", "low"), ("g_high", "high")):
            yield key._replace(statistic=name), float(getattr(one.effect, source)[k]), ""
        yield key._replace(statistic="p"), float(one.tested.p[k]), ""
        yield key._replace(statistic="p_adjusted"), float(one.tested.adjusted[k]), ""


def interval_numbers(key: Key, estimate: Estimate, k: int, unit: str) -> Iterator[Entry]:
    """Value and interval of one number.

    Args:
        key: without its statistic.
        estimate: of several.
    """
    for name in INTERVAL:
        yield key._replace(statistic=name), float(getattr(estimate, name)[k]), unit


def course_numbers(key: Key, one: Comparison, mean: Estimate, per_mass: bool) -> Iterator[Entry]:
    """Numbers of the mean courses of a condition.

    Args:
        key: with section, condition and body.
        mean: flattened points times courses.
    """
    width, points = len(one.courses), len(one.tested.points)
    for at in range(len(mean.value)):
        column = one.courses[at % width]
        own = key._replace(where=column.where, measure=column.measure, item=percent_of(at // width, points))
        yield from interval_numbers(own, mean, at, column_unit(column, per_mass))


def column_unit(column: MeasureColumn, per_mass: bool) -> str:
    """Unit of a column.

    Args:
        column: of measures or courses.
        per_mass: whether torques are divided by mass; compression, which is judged against a limit in newtons, is not.
    """
    own = unit_of(column.measure)
    back = column.where == BACK and own == "N"
    return f"{own}/kg" if per_mass and divides_by_mass(column.measure) and not back else own


def _method(found: Evaluation) -> Iterator[Entry]:
    options = found.config.evaluate
    yield Key("method", "draws"), 0 if found.identified.rows.draws is None else options.draws, ""
    yield Key("method", "apart"), APART, ""
    yield Key("method", "corrections"), len(found.corrections), ""
    for name, value in zip(("lever_low", "lever_high"), options.lever_arm_m, strict=True):
        yield Key("method", name, where="L5/S1"), value, "m"
    if found.per_mass_kg is not None:
        yield Key("method", "mass"), found.per_mass_kg, "kg"


def _cycles(found: Evaluation) -> Iterator[Entry]:
    for condition in found.config.conditions:
        own = [k for k, name in enumerate(found.conditions) if name == condition]
        yield Key("cycle", "trials", condition), len([t for t in found.trials if t.condition == condition]), ""
        yield Key("cycle", "cycles", condition), len(own), ""
        yield Key("cycle", "apart", condition), int((found.apart[own] > APART).sum()), ""
    times = {trial.name: trial.followed.motion.time for trial in found.trials}
    for k, (item, cycle) in enumerate(zip(cycle_names(found), found.cycles, strict=True)):
        for name, frame in (("t0", cycle.start), ("t1", cycle.stop)):
            yield Key("cycle", name, found.conditions[k], item=item), float(times[cycle.trial][frame]), "s"
        yield Key("cycle", "score", found.conditions[k], item=item), float(found.apart[k]), ""


def cycle_names(found: Evaluation) -> list[str]:
    """Name of every cycle: trial, number within it from one, side."""
    seen = Counter[str]()
    names = []
    for cycle in found.cycles:
        seen[cycle.trial] += 1
        names.append(f"{cycle.trial}_{seen[cycle.trial]}{cycle.side}")
    return names


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
        own, per = found.identified.cycles_of(condition), "/kg" if found.per_mass else ""
        for j, (name, side) in enumerate(zip(layout.names, layout.sides, strict=True)):
            mine = [k for k in own if not side or not found.cycles[k].side or found.cycles[k].side == side]
            yield Key("device", "peak", condition, name, "torque_Nm"), _peak(rows.device[mine, :, j]), f"N m{per}"
            load = rows.device_load[mine, j].nanmean()
            yield Key("device", "load_taken", condition, name, "cumulative_load_Nms"), float(load), f"N m s{per}"
        for key, parameter in worn.parameters.items():
            for name in ("value", "sd"):
                if name in parameter:
                    yield Key("device", name, condition, item=key), float(parameter[name]), ""


def _peak(courses: Tensor) -> float:
    """Mean over cycles of the largest size."""
    return float(courses.abs().amax(1).nanmean()) if len(courses) else torch.nan


def _measures(found: Evaluation, answer: BodyAnswer, body: str) -> Iterator[Entry]:
    for condition in found.names:
        own = answer.cycles_of(condition)
        mean = answer.mean(condition, answer.sample.values, answer.sample.draws)
        for k, column in enumerate(answer.sample.columns):
            key = Key("measure", "", condition, column.where, column.measure, body)
            unit = column_unit(column, found.per_mass)
            yield from interval_numbers(key, mean, k, unit)
            yield key._replace(statistic="sd"), float(mean.sd[k]), unit
            count = int(torch.isfinite(answer.sample.values[own, k]).sum())
            yield key._replace(statistic="cycles"), count, ""


def _courses(found: Evaluation, one: Comparison, condition: str) -> Iterator[Entry]:
    for share, body in (("human", "identified"), ("template", "template")):
        yield from course_numbers(
            Key("course", "", condition, body=body), one, found.course(one, condition, share), found.per_mass
        )
