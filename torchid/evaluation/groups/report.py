"""Groups of a cohort as one page without anything from outside, and as a table."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from torchid.evaluation.groups.groups import GroupComparison
from torchid.evaluation.numbers import column_unit
from torchid.evaluation.report.tables import ADJUSTED, SIGNS
from torchid.evaluation.report.words import column_words, digits_of, labelled, where_words
from torchid.evaluation.statistics.comparing import Comparison, spans
from torchid.evaluation.statistics.effects import COVERAGE, Estimate, mean_of
from torchid.report.blocks import Block, Figure, Items, Paragraph, Section, Table
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, draw, tidy
from torchid.report.page import render_page
from torchid.wording import ABSENT, clean, listing, number, percent

PER_MASS = True
"""Wording. Moments are per kilogram: people of a group differ in mass."""
SAID = 4
"""Choice. Differences that the first sentence lists."""
SHORT = {"angle_deg": "angle", "torque_Nm": "moment"}


def render_groups(found: GroupComparison) -> str:
    """Return the page.

    Args:
        found: the groups.
    """
    title = (
        f"{clean(found.question.cohort.name)}: {listing([found.reference, *(c.condition for c in found.comparisons)])}"
    )
    sections = [
        _summary(found),
        *(_differences(found, k) for k in range(len(found.comparisons))),
        _courses(found),
        _rests(found),
    ]
    return render_page(title, sections)


def _summary(found: GroupComparison) -> Section:
    groups = found.walking.groups
    rows = tuple((clean(name), str(groups.count(name))) for name in dict.fromkeys((found.reference, *groups)))
    said = " ".join(_said(found, one) for one in found.comparisons)
    return Section("summary", "Summary", said, (Table("", ("Group", "People"), rows),))


def _said(found: GroupComparison, one: Comparison) -> str:
    """A comparison in a few sentences."""
    names = f"\u201c{clean(one.condition)}\u201d against \u201c{clean(one.reference)}\u201d"
    if not one.testable:
        return f"{names}: not testable: {one.needed.said}."
    level = found.question.level
    columns = [k for k in one.ranked() if k in one.found(level)]
    courses = [one.courses[j] for j in one.found_courses(level)]
    of = (f"{len(columns)} of {int(one.tested.adjusted.isfinite().sum())} measures",
          f"{len(courses)} of {int(one.tested.courses.isfinite().sum())} courses")  # fmt: skip
    counted = f"{names}: {of[0]} and {of[1]} differ significantly (family-wise {100.0 * level:g} %)."
    largest = [f"{column_words(one.columns[k])} {_value(one, k)}" for k in columns[:SAID]]
    over = list(dict.fromkeys(f"{where_words(c.where)} ({SHORT[c.measure]})" for c in courses))
    more = [f"Largest: {listing(largest, SAID)}."] if largest else []
    more += [f"Over the stride: {listing(over, SAID)}."] if over else []
    return " ".join([counted, *more])


def _value(one: Comparison, k: int) -> str:
    """A difference with its sign and unit."""
    column, value = one.columns[k], float(one.difference.value[k])
    unit = column_unit(column, PER_MASS)
    return (
        f"{'+' if value > 0.0 else ''}{number(value, digits_of(column.measure, PER_MASS))}{f' {unit}' if unit else ''}"
    )


def _differences(found: GroupComparison, k: int) -> Section:
    one = found.comparisons[k]
    means = [mean_of(one.rows.values[one.units.second == side], None) for side in (False, True)]
    own, order = set(one.found(found.question.level)), one.ranked()
    rows = tuple(_row(one, column, means) for column in order)
    head = ("Measure", clean(one.reference), clean(one.condition), "Difference", "Interval", "Adj. p", "Hedges' g")
    strong = frozenset(line for line, column in enumerate(order) if column in own)
    title = f"{clean(one.condition)} minus {clean(one.reference)}"
    said = f"Means over people, with the {percent(COVERAGE)} interval of their difference; significant ones in bold."
    return Section(f"differences_{k}", title, said, (Table("", head, rows, strong=strong),))


def _row(one: Comparison, k: int, means: list[Estimate]) -> tuple[str, ...]:
    column = one.columns[k]
    digits = digits_of(column.measure, PER_MASS)
    low, high = (number(float(end[k]), digits) for end in (one.difference.low, one.difference.high))
    return (
        labelled(column, PER_MASS), *(number(float(mean.value[k]), digits) for mean in means),
        number(float(one.difference.value[k]), digits), ABSENT if low == ABSENT else f"{low} to {high}",
        number(float(one.tested.adjusted[k]), 3), number(float(one.effect.value[k]), 2),
    )  # fmt: skip


def _courses(found: GroupComparison) -> Section:
    blocks: list[Block] = [
        Figure(_drawn(found, one, f"g{k}"), f"{clean(one.condition)} and {clean(one.reference)}, both legs.")
        for k, one in enumerate(found.comparisons)
    ]
    said = f"Means over people with {percent(COVERAGE)} bands. A bar at the bottom marks a significant difference."
    return Section("courses", "Over the stride", said, tuple(blocks))


def _drawn(found: GroupComparison, one: Comparison, key: str) -> Markup:
    """Angles on the left and moments on the right, a line for each joint."""
    joints = list(dict.fromkeys(column.where for column in one.courses))
    means = [(found.course(name), colour) for name, colour in ((one.reference, MEASURED), (one.condition, IDENTIFIED))]

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(len(joints), len(SHORT), sharex=True, squeeze=False)
        for line, joint in zip(panels, joints, strict=True):
            for axes, measure in zip(line, SHORT, strict=True):
                course = next(j for j, c in enumerate(one.courses) if (c.where, c.measure) == (joint, measure))
                _panel(axes, found, one, course, means)
        for axes in panels[-1]:
            axes.set_xlabel("stride [%]")
        handles: list[Line2D | Patch] = [
            Line2D([], [], color=colour, label=clean(name, 30))
            for name, colour in ((one.reference, MEASURED), (one.condition, IDENTIFIED))
        ]
        if one.found_courses(found.question.level):
            handles.append(Patch(color=IDENTIFIED, label="differs here"))
        canvas.legend(handles=handles, loc="outside lower center", ncols=3)

    return draw(key, (7.5, 0.75 + 1.45 * len(joints)), f"Angles and moments, {clean(one.condition)}", paint)


def _panel(
    axes: Axes, found: GroupComparison, one: Comparison, course: int, means: list[tuple[Estimate, str]]
) -> None:  # fmt: skip
    column, points = one.courses[course], len(one.tested.points)
    stride = np.linspace(0.0, 100.0, points)
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    for mean, colour in means:
        value, low, high = (x.reshape(points, -1)[:, course].numpy() for x in (mean.value, mean.low, mean.high))
        axes.fill_between(stride, low, high, color=colour, alpha=0.16, linewidth=0.0)
        axes.plot(stride, value, color=colour, linewidth=1.6)
    for start, stop in spans(one.tested.points[:, course] <= found.question.level):
        axes.axvspan(start, max(stop, start + 0.5), ymin=0.0, ymax=0.035, color=IDENTIFIED, linewidth=0.0)
    axes.set_title(f"{where_words(column.where)}, {SHORT[column.measure]}")
    axes.set_ylabel(f"[{column_unit(column, PER_MASS)}]")
    axes.margins(x=0.0)
    tidy(axes)


def _rests(found: GroupComparison) -> Section:
    tested = [one for one in found.comparisons if one.testable]
    ways = " and ".join(
        f"{'all' if one.complete else 'random'} ways of dealing {' and '.join(map(str, one.units.counts))} people"
        for one in tested
    )
    items = (
        "A person is a unit: the mean of all strides of both legs. Rows of one person in the cohort's table count as "
        "different people.",
        "Moments are those of the identified bodies, per kilogram of identified mass.",
        f"Coordinates: {SIGNS['isb']}.",
        *([f"Labels of groups are exchanged in {ways}; {ADJUSTED}"] if tested else []),
        "Effect size: Hedges' g, the difference over the pooled standard deviation between people.",
    )
    gaps = tuple(clean(f"{gap.what}: {gap.why}.", 600) for gap in found.gaps)
    blocks = [Items(items), *([Paragraph("Left out, or not determinable:"), Items(gaps)] if gaps else [])]
    return Section("method", "What it rests on", "Nobody was left out for how it looks.", tuple(blocks))


def groups_table(found: GroupComparison) -> pd.DataFrame:
    """Return every difference, a row each, and every course with the largest part of it.

    Args:
        found: the groups.
    """
    return pd.DataFrame([row for one in found.comparisons for row in _rows(one)])


def _rows(one: Comparison) -> Iterator[dict[str, object]]:
    means = [mean_of(one.rows.values[one.units.second == side], None).value for side in (False, True)]
    for k, column in enumerate(one.columns):
        yield {
            "group": one.condition, "reference": one.reference, "where": column.where, "measure": column.measure,
            "unit": column_unit(column, PER_MASS), "mean_reference": float(means[0][k]), "mean": float(means[1][k]),
            "difference": float(one.difference.value[k]), "low": float(one.difference.low[k]),
            "high": float(one.difference.high[k]), "p_adjusted": float(one.tested.adjusted[k]),
            "hedges_g": float(one.effect.value[k]),
        }  # fmt: skip
    for j, column in enumerate(one.courses):
        yield {
            "group": one.condition, "reference": one.reference, "where": column.where,
            "measure": f"course of {column.measure}", "p_adjusted": float(one.tested.courses[j]),
        }  # fmt: skip
