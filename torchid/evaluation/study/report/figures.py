"""Every subject as a dot, and courses over the cycle."""

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from torchid.evaluation.numbers import column_unit
from torchid.evaluation.report.figures import DEVICE, TITLES
from torchid.evaluation.report.words import measure_words, where_words
from torchid.evaluation.statistics.comparing import spans
from torchid.evaluation.study.compare import SubjectsComparison
from torchid.evaluation.study.numbers import course_estimate
from torchid.evaluation.study.study import Pooled
from torchid.evaluation.torque_shares.back import NIOSH_N
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, draw, tidy
from torchid.wording import clean

NAMED = 12
"""Choice. Subjects up to which every row of a panel has its name."""
_DASHED = (0, (3, 1.5))


def draw_subjects(found: Pooled, one: SubjectsComparison, columns: Sequence[int], key: str) -> Markup:
    """A panel per measure: every subject's change as a dot with its own interval, the mean below.

    Args:
        found: the study.
        one: a comparison.
        columns: numbers of its columns.
        key: prefix of the drawing's ids.
    """
    lines = -(-len(columns) // 2)

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(lines, 2, sharey=True, squeeze=False).flatten()
        for axes, k in zip(panels, columns, strict=False):
            _dots(axes, found, one, k)
        for axes in panels[len(columns) :]:
            axes.set_visible(False)
        canvas.legend(handles=_dot_handles(found), loc="outside lower center", ncols=4)

    row = 0.17 if len(found.comparisons) == 1 else 0.12
    height = 0.55 + lines * (0.75 + row * min(NAMED, len(one.subjects) + 1))
    describe = f"Change of every subject, {clean(one.condition)} minus {clean(one.reference)}"
    return draw(key, (7.5, height), describe, paint)


def _dots(axes: Axes, found: Pooled, one: SubjectsComparison, k: int) -> None:
    column, count = one.columns[k], len(one.subjects)
    axes.axvline(0.0, color=MUTED, linewidth=0.8)
    for y, subject in enumerate(one.subjects):
        for body, colour, mark, shift in (("identified", IDENTIFIED, "o", 0.0), ("template", SCALED, "D", 0.25)):
            own = subject.differences.get((body, one.condition, column.where, column.measure))
            if own is None:
                continue
            if body == "identified":
                axes.plot([own.low, own.high], [y, y], color=colour, linewidth=0.9, alpha=0.6)
            axes.plot([own.value], [y + shift], mark, color=colour, markersize=4.0 - 8.0 * shift / 4.0,
                      fillstyle="none" if shift else "full")  # fmt: skip
    for body, colour, mark, shift in (("identified", MEASURED, "s", 0.0), ("template", SCALED, "D", 0.3)):
        mean = one.answers[body].difference
        low, value, high = (float(x[k]) for x in (mean.low, mean.value, mean.high))
        axes.plot([low, high], [count + shift] * 2, color=colour, linewidth=1.8 if not shift else 1.0)
        axes.plot([value], [count + shift], mark, color=colour, markersize=5.0 if not shift else 3.5)
    axes.set_xlim(*_reach(one, k))
    axes.set_yticks(range(count + 1), [clean(s.name, 14) if count <= NAMED else "" for s in one.subjects] + ["mean"])
    axes.set_ylim(count + 0.75, -0.6)
    axes.set_title(f"{where_words(column.where)}: {measure_words(column.measure)}"[:46], fontsize=8.5)
    unit = column_unit(column, found.per_mass)
    axes.set_xlabel(f"change{f' [{unit}]' if unit else ''}", fontsize=8.5)
    tidy(axes, "x")


def _reach(one: SubjectsComparison, k: int) -> tuple[float, float]:
    """Axis that holds zero, all dots and the mean's interval; a subject's own interval may go on beyond it."""
    shown = [0.0]
    for own in one.answers.values():
        mean = own.difference
        shown += [x for x in (*own.values[:, k].tolist(), float(mean.low[k]), float(mean.high[k])) if math.isfinite(x)]
    spare = 0.06 * (max(shown) - min(shown)) + 1e-9
    return min(shown) - spare, max(shown) + spare


def _dot_handles(found: Pooled) -> list[Line2D]:
    return [
        Line2D([], [], color=IDENTIFIED, marker="o", markersize=4, linewidth=0.9, label="a subject, own interval"),
        Line2D([], [], color=MEASURED, marker="s", markersize=5, linewidth=1.8, label="mean, interval over subjects"),
        Line2D([], [], color=SCALED, marker="D", markersize=3.5, fillstyle="none", linewidth=1.0,
               label=found.usual),
    ]  # fmt: skip


def draw_study_courses(found: Pooled, one: SubjectsComparison, key: str) -> Markup:
    """All courses of a comparison, means over subjects with their intervals.

    Args:
        found: the study.
        one: a comparison.
        key: prefix of the drawing's ids.
    """
    lines = -(-len(one.courses) // 2)

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(lines, 2, sharex=True, squeeze=False).flatten()
        for axes, course in zip(panels, range(len(one.courses)), strict=False):
            _course(axes, found, one, course)
        for axes in panels[len(one.courses) :]:
            axes.set_visible(False)
        for axes in panels[max(0, len(one.courses) - 2) : len(one.courses)]:
            axes.set_xlabel("cycle [%]")
            axes.tick_params(labelbottom=True)
        canvas.legend(handles=_course_handles(found, one), loc="outside lower center", ncols=3)

    describe = f"Courses over the cycle, {clean(one.condition)} and {clean(one.reference)}"
    return draw(key, (7.5, 0.75 + 1.45 * lines), describe, paint)


def _course(axes: Axes, found: Pooled, one: SubjectsComparison, course: int) -> None:
    column, width = one.courses[course], len(one.courses)
    percent = np.linspace(0.0, 100.0, len(one.differing))
    axes.axhline(0.0, color=MUTED, linewidth=0.6)

    def mean(condition: str, share: str) -> list[np.ndarray]:
        own = course_estimate(found, one, condition, share)
        return [x.reshape(-1, width)[:, course].numpy() for x in (own.value, own.low, own.high)]

    if _worn(one) and column.measure == "torque_Nm":
        for share, colour, dash in (("demand", MUTED, (0, (4, 2))), ("device", DEVICE, "solid")):
            axes.plot(percent, mean(one.condition, share)[0], color=colour, linestyle=dash, linewidth=1.3)
    for condition, colour in ((one.reference, MEASURED), (one.condition, IDENTIFIED)):
        value, low, high = mean(condition, "human")
        axes.fill_between(percent, low, high, color=colour, alpha=0.16, linewidth=0.0)
        axes.plot(percent, value, color=colour, linewidth=1.6)
    axes.plot(percent, mean(one.condition, "template")[0], color=SCALED, linestyle=_DASHED, linewidth=1.1)
    if column.measure == "compression_N":
        axes.axhline(NIOSH_N, color="#8f1d14", linewidth=1.1)
        axes.annotate("NIOSH", (100.0, NIOSH_N), ha="right", va="bottom", fontsize=8, color="#8f1d14")
    for start, stop in spans(one.differing[:, course] <= found.study.level):
        axes.axvspan(start, max(stop, start + 0.5), ymin=0.0, ymax=0.035, color=IDENTIFIED, linewidth=0.0)
    axes.set_title(TITLES.get(column.measure, where_words(column.where)))
    axes.set_ylabel(f"[{column_unit(column, found.per_mass)}]")
    axes.margins(x=0.0)
    tidy(axes)


def _worn(one: SubjectsComparison) -> bool:
    return any(subject.devices[one.condition] is not None for subject in one.subjects)


def _course_handles(found: Pooled, one: SubjectsComparison) -> list[Line2D | Patch]:
    human = "human share" if _worn(one) else "torque"
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=MEASURED, label=clean(one.reference, 30)),
        Line2D([], [], color=IDENTIFIED, label=f"{clean(one.condition, 30)}: {human}"),
    ]
    if _worn(one):
        handles += [
            Line2D([], [], color=DEVICE, label="device's share"),
            Line2D([], [], color=MUTED, linestyle=(0, (4, 2)), label="human and device"),
        ]
    handles.append(Line2D([], [], color=SCALED, linestyle=_DASHED,
                          label=f"{clean(one.condition, 30)}: {found.usual}"))  # fmt: skip
    if bool((one.differing <= found.study.level).any()):
        handles.append(Patch(color=IDENTIFIED, label="differs here"))
    return handles
