"""Courses over the cycle: the human's share, what is demanded, the device's share, and the template's answer."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from torchid.evaluation.compared import Compared
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import column_unit
from torchid.evaluation.report.words import where_words
from torchid.evaluation.statistics.comparing import Comparison, spans
from torchid.evaluation.statistics.effects import Estimate
from torchid.evaluation.torque_shares.back import NIOSH_N
from torchid.report.blocks import Block, Figure, Section
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, draw, tidy
from torchid.wording import clean

DEVICE = "#38761d"
"""Green, darker than the bands in grey print."""
TITLES = {"extension_moment_Nm": "L5/S1 extension moment", "compression_N": "L5/S1 compression"}
DASHED, DOTTED = (0, (4, 2)), (0, (3, 1.5))
SHARES = ("human", "demand", "device", "template")
Means = dict[str, Estimate]
"""Mean courses by share; the reference's human share under ``reference``."""


def draw_courses(found: Compared, one: Comparison, courses: Sequence[int], key: str) -> Markup:
    """Panels of courses of one comparison, two abreast.

    Args:
        key: prefix of the drawing's ids.
    """
    lines, worn = -(-len(courses) // 2), bool(found.devices(one.condition))
    shares = SHARES if worn else ("human", "template")
    means = {share: found.course(one, one.condition, share) for share in shares}
    means["reference"] = found.course(one, one.reference, "human")

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(lines, 2, sharex=True, squeeze=False).flatten()
        for axes, course in zip(panels, courses, strict=False):
            _panel(axes, found, one, course, means)
        for axes in panels[len(courses) :]:
            axes.set_visible(False)
        for axes in panels[max(0, len(courses) - 2) : len(courses)]:
            axes.set_xlabel("cycle [%]")
            axes.tick_params(labelbottom=True)
        canvas.legend(handles=_handles(found, one, worn), loc="outside lower center", ncols=3)

    describe = f"Courses over the cycle, {clean(one.condition)} and {clean(one.reference)}"
    return draw(key, (7.5, 0.75 + 1.45 * lines), describe, paint)


def _panel(axes: Axes, found: Compared, one: Comparison, course: int, means: Means) -> None:
    column, points = one.courses[course], len(one.tested.points)
    percent = np.linspace(0.0, 100.0, points)

    def of(share: str, part: str = "value") -> np.ndarray:
        return getattr(means[share], part).reshape(points, -1)[:, course].numpy()

    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    if "device" in means and column.measure == "torque_Nm":
        axes.plot(percent, of("demand"), color=MUTED, linestyle=DASHED, linewidth=1.3)
        axes.plot(percent, of("device"), color=DEVICE, linewidth=1.3)
    for share, colour in (("reference", MEASURED), ("human", IDENTIFIED)):
        axes.fill_between(percent, of(share, "low"), of(share, "high"), color=colour, alpha=0.16, linewidth=0.0)
        axes.plot(percent, of(share), color=colour, linewidth=1.6)
    axes.plot(percent, of("template"), color=SCALED, linestyle=DOTTED, linewidth=1.1)
    if column.measure == "compression_N":
        axes.axhline(NIOSH_N, color="#8f1d14", linewidth=1.1)
        axes.annotate("NIOSH", (100.0, NIOSH_N), ha="right", va="bottom", fontsize=8, color="#8f1d14")
    for start, stop in spans(one.tested.points[:, course] <= found.level):
        axes.axvspan(start, max(stop, start + 0.5), ymin=0.0, ymax=0.035, color=IDENTIFIED, linewidth=0.0)
    axes.set_title(TITLES.get(column.measure, where_words(column.where)))
    axes.set_ylabel(f"[{column_unit(column, found.per_mass)}]")
    axes.margins(x=0.0)
    tidy(axes)


def _handles(found: Compared, one: Comparison, worn: bool) -> list[Line2D | Patch]:
    line, name = partial(Line2D, [], []), clean(one.condition, 30)
    handles: list[Line2D | Patch] = [
        line(color=MEASURED, label=clean(one.reference, 30)),
        line(color=IDENTIFIED, label=f"{name}: {'human share' if worn else 'torque'}"),
    ]
    if worn:
        handles += [line(color=DEVICE, label="device's share"),
                    line(color=MUTED, linestyle=DASHED, label="human and device")]  # fmt: skip
    handles.append(line(color=SCALED, linestyle=DOTTED, label=f"{name}: {found.usual}"))
    if one.found_courses(found.level):
        handles.append(Patch(color=IDENTIFIED, label="differs here"))
    return handles


def courses_section(found: Compared, ledger: Ledger) -> Section:
    """All courses over the cycle."""
    blocks: list[Block] = [
        Figure(draw_courses(found, one, range(len(one.courses)), f"c{k}"),
               f"{clean(one.condition)} and {clean(one.reference)}, in the sense of the coordinate.")
        for k, one in enumerate(found.comparisons)
    ]  # fmt: skip
    percent, kind = ledger.show(Key("method", "coverage"), 0, 100.0), found.comparisons[0].units.kind
    said = f"Means over {kind} with {percent} % bands.{marked(found, ledger)}"
    return Section("courses", "Human and device over the cycle", said, tuple(blocks))


def marked(found: Compared, ledger: Ledger) -> str:
    """What a bar in a panel marks; empty where nothing could be tested."""
    if not any(one.testable for one in found.comparisons):
        return ""
    level = ledger.show(Key("method", "level"), 0, 100.0)
    return f" A bar at the bottom marks a significant difference (family-wise {level} %: all measures, all points)."
