"""Courses over the cycle: the human's share, what is demanded, the device's share, and the template's answer."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.numbers import course_means, unit
from torchid.evaluation.report.words import where_words
from torchid.evaluation.statistics.answers import sided_courses
from torchid.evaluation.statistics.comparing import Comparison, spans
from torchid.evaluation.statistics.effects import Estimate
from torchid.evaluation.torque_shares.back import NIOSH_N
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, draw, tidy
from torchid.wording import clean

DEVICE = "#38761d"
"""Green, darker than the bands in grey print."""
TITLES = {"extension_moment_Nm": "L5/S1 extension moment", "compression_N": "L5/S1 compression"}


def draw_courses(found: Evaluation, number: int, courses: Sequence[int], key: str, columns: int = 2) -> Markup:
    """Panels of courses of one comparison.

    Args:
        found: the evaluation.
        number: of the comparison.
        courses: positions in the layout's courses.
        key: prefix of the drawing's ids.
        columns: panels side by side.
    """
    comparison = found.identified.comparisons[number]
    lines = -(-len(courses) // columns)

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(lines, columns, sharex=True, squeeze=False).flatten()
        for axes, course in zip(panels, courses, strict=False):
            _panel(axes, found, number, course)
        for axes in panels[len(courses) :]:
            axes.set_visible(False)
        for axes in panels[max(0, len(courses) - columns) : len(courses)]:
            axes.set_xlabel("cycle [%]")
            axes.tick_params(labelbottom=True)
        canvas.legend(handles=_handles(found, comparison), loc="outside lower center", ncols=3)

    describe = f"Courses over the cycle, {clean(comparison.condition)} and {clean(comparison.reference)}"
    return draw(key, (7.5, 0.75 + 1.45 * lines), describe, paint)


def _panel(axes: Axes, found: Evaluation, number: int, course: int) -> None:
    comparison, column = found.identified.comparisons[number], found.layout.courses[course]
    points = found.identified.rows.human.shape[1]
    percent = np.linspace(0.0, 100.0, points)
    worn = found.worn[comparison.condition].device is not None
    torque = column.where != "L5/S1"
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    if worn and torque:
        for name, colour, dash in (("demand", MUTED, (0, (4, 2))), ("device", DEVICE, "solid")):
            mean = _means(found, name, comparison.condition).value.reshape(points, -1)[:, course]
            axes.plot(percent, mean, color=colour, linestyle=dash, linewidth=1.3)
    for condition, colour in ((comparison.reference, MEASURED), (comparison.condition, IDENTIFIED)):
        own = _means(found, "human", condition)
        mean, low, high = (x.reshape(points, -1)[:, course].numpy() for x in (own.value, own.low, own.high))
        axes.fill_between(percent, low, high, color=colour, alpha=0.16, linewidth=0.0)
        axes.plot(percent, mean, color=colour, linewidth=1.6)
    plain = _means(found, "template", comparison.condition).value.reshape(points, -1)[:, course]
    axes.plot(percent, plain, color=SCALED, linestyle=(0, (3, 1.5)), linewidth=1.1)
    if column.measure == "compression_N":
        axes.axhline(NIOSH_N, color="#8f1d14", linewidth=1.1)
        axes.annotate("NIOSH", (100.0, NIOSH_N), ha="right", va="bottom", fontsize=8, color="#8f1d14")
    significant = found.identified.course_p[number][:, course] <= found.config.evaluate.level
    for start, stop in spans(significant):
        axes.axvspan(start, max(stop, start + 0.5), ymin=0.0, ymax=0.035, color=IDENTIFIED, linewidth=0.0)
    axes.set_title(TITLES.get(column.measure, where_words(column.where)))
    axes.set_ylabel(f"[{unit(found, column)}]")
    axes.margins(x=0.0)
    tidy(axes)


def _means(found: Evaluation, which: str, condition: str) -> Estimate:
    rows = found.template.rows if which == "template" else found.identified.rows
    name = "human" if which == "template" else which
    draws = rows.human_draws if which == "human" else None
    courses = sided_courses(getattr(rows, name), found.layout, found.cycles)
    answer = found.template if which == "template" else found.identified
    return course_means(answer, courses, draws, condition)


def _handles(found: Evaluation, comparison: Comparison) -> list[Line2D | Patch]:
    worn = found.worn[comparison.condition].device is not None
    human = "human share" if worn else "torque"
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=MEASURED, label=clean(comparison.reference, 30)),
        Line2D([], [], color=IDENTIFIED, label=f"{clean(comparison.condition, 30)}: {human}"),
    ]
    if worn:
        handles += [
            Line2D([], [], color=DEVICE, label="device's share"),
            Line2D([], [], color=MUTED, linestyle=(0, (4, 2)), label="human and device"),
        ]
    handles.append(Line2D([], [], color=SCALED, linestyle=(0, (3, 1.5)),
                          label=f"{clean(comparison.condition, 30)}: {found.usual}"))  # fmt: skip
    if any(bool((p <= found.config.evaluate.level).any()) for p in found.identified.course_p):
        handles.append(Patch(color=IDENTIFIED, label="differs here"))
    return handles
