"""Every subject of a study as a dot."""

import math
from collections.abc import Sequence

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D

from torchid.evaluation.ledger import BODIES
from torchid.evaluation.numbers import column_unit
from torchid.evaluation.report.words import measure_words, where_words
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.study.study import Pooled
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, draw, tidy
from torchid.wording import clean

NAMED = 12
"""Choice. Subjects up to which every row of a panel has its name."""


def draw_subjects(found: Pooled, one: Comparison, columns: Sequence[int], key: str) -> Markup:
    """A panel per measure: every subject's change as a dot with its own interval, the mean below.

    Args:
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
    height = 0.55 + lines * (0.75 + row * min(NAMED, len(one.units.second) + 1))
    describe = f"Change of every subject, {clean(one.condition)} minus {clean(one.reference)}"
    return draw(key, (7.5, height), describe, paint)


def _dots(axes: Axes, found: Pooled, one: Comparison, k: int) -> None:
    column, count = one.columns[k], len(one.units.second)
    axes.axvline(0.0, color=MUTED, linewidth=0.8)
    for y, subject in enumerate(found.having(one.condition)):
        for body, colour, mark, shift in (("identified", IDENTIFIED, "o", 0.0), ("template", SCALED, "D", 0.25)):
            own = subject.differences.get((body, one.condition, column.where, column.measure))
            if own is None:
                continue
            if body == "identified":
                axes.plot([own.low, own.high], [y, y], color=colour, linewidth=0.9, alpha=0.6)
            axes.plot([own.value], [y + shift], mark, color=colour, markersize=4.0 - 8.0 * shift / 4.0,
                      fillstyle="none" if shift else "full")  # fmt: skip
    for body, colour, mark, shift in (("identified", MEASURED, "s", 0.0), ("template", SCALED, "D", 0.3)):
        mean = _body(found, one, body).difference
        low, value, high = (float(x[k]) for x in (mean.low, mean.value, mean.high))
        axes.plot([low, high], [count + shift] * 2, color=colour, linewidth=1.8 if not shift else 1.0)
        axes.plot([value], [count + shift], mark, color=colour, markersize=5.0 if not shift else 3.5)
    axes.set_xlim(*_reach(found, one, k))
    axes.set_yticks(
        range(count + 1), [clean(s.name, 14) if count <= NAMED else "" for s in found.having(one.condition)] + ["mean"]
    )
    axes.set_ylim(count + 0.75, -0.6)
    axes.set_title(f"{where_words(column.where)}: {measure_words(column.measure)}"[:46], fontsize=8.5)
    unit = column_unit(column, found.per_mass)
    axes.set_xlabel(f"change{f' [{unit}]' if unit else ''}", fontsize=8.5)
    tidy(axes, "x")


def _body(found: Pooled, one: Comparison, body: str) -> Comparison:
    """What a body says of the comparison's condition."""
    return next(own for own in found.answers[body] if own.condition == one.condition)


def _reach(found: Pooled, one: Comparison, k: int) -> tuple[float, float]:
    """Axis that holds zero, all dots and the mean's interval; a subject's own interval may go on beyond it."""
    shown = [0.0]
    for own in (_body(found, one, body) for body in BODIES):
        mean = own.difference
        shown += [
            x for x in (*own.rows.values[:, k].tolist(), float(mean.low[k]), float(mean.high[k])) if math.isfinite(x)
        ]
    spare = 0.06 * (max(shown) - min(shown)) + 1e-9
    return min(shown) - spare, max(shown) + spare


def _dot_handles(found: Pooled) -> list[Line2D]:
    return [
        Line2D([], [], color=IDENTIFIED, marker="o", markersize=4, linewidth=0.9, label="a subject, own interval"),
        Line2D([], [], color=MEASURED, marker="s", markersize=5, linewidth=1.8, label="mean, interval over subjects"),
        Line2D([], [], color=SCALED, marker="D", markersize=3.5, fillstyle="none", linewidth=1.0,
               label=found.usual),
    ]  # fmt: skip
