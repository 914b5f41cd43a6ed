"""The sections of a study as one page without anything from outside."""

import math
from collections.abc import Sequence

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D

from torchid.evaluation.compared import Gap
from torchid.evaluation.ledger import BODIES, Key, Ledger
from torchid.evaluation.numbers import column_unit
from torchid.evaluation.report.figures import courses_section
from torchid.evaluation.report.page import render_compared
from torchid.evaluation.report.sentences import gap_lines, interval
from torchid.evaluation.report.tables import differences_section, method_section, summary_section
from torchid.evaluation.report.words import digits_of, labelled, measure_words, where_words
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.study.numbers import columns_of, taken
from torchid.evaluation.study.study import Pooled
from torchid.report.blocks import Block, Details, Figure, Items, Section, Table
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, draw, tidy
from torchid.wording import clean, listing

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


ABREAST = 8
"""Choice. Subjects beside each other in a table that fits a printed page."""


def subjects_section(found: Pooled, ledger: Ledger) -> Section:
    """Every subject's differences and values."""
    blocks: list[Block] = []
    for one in found.comparisons:
        title = f"{clean(one.condition)} minus {clean(one.reference)}"
        names = [subject.name for subject in found.having(one.condition)]
        blocks += _each(found, ledger, Key("difference", "value", one.condition), names, title)
    for condition in found.names:
        names = [subject.name for subject in found.having(condition)]
        tables = _each(found, ledger, Key("measure", "value", condition), names, clean(condition))
        blocks.append(Details(f"Values of {clean(condition)}", tuple(tables)))
    said = "Each subject's own change; their own evaluations say how sure each of them is, and are files of their own."
    return Section("subjects", "Every subject", said, tuple(blocks))


def _each(found: Pooled, ledger: Ledger, key: Key, names: Sequence[str], title: str) -> list[Block]:
    """Measures as rows and subjects as columns, the mean behind them; as many tables as their number needs."""
    tables: list[Block] = []
    for start in range(0, len(names), ABREAST):
        some, rows = names[start : start + ABREAST], []
        for column in columns_of(found):
            own = key._replace(where=column.where, measure=column.measure)
            if not ledger.has(own):
                continue
            digits = digits_of(column.measure, found.per_mass)
            each = [ledger.show(own._replace(item=name), digits) for name in some]
            rows.append((labelled(column, found.per_mass), *each, ledger.show(own, digits)))
        tables.append(Table(title, ("Measure", *(clean(name, 16) for name in some), "Mean"), tuple(rows)))
    return tables


def share_table(found: Pooled, ledger: Ledger, one: Comparison, each: bool) -> Table | None:
    """Part of the load on each coordinate that the device takes; None where nothing was worn.

    Args:
        each: whether every subject has a column.
    """
    names, _ = taken(found, one)
    rows = []
    for where in names:
        key = Key("device", "value", one.condition, where, "load_taken")
        own = [ledger.show(key._replace(item=s.name), 0, 100.0) for s in found.having(one.condition)] if each else []
        rows.append((where_words(where), ledger.show(key, 0, 100.0), interval(ledger, key, 0, 100.0), *own))
    subjects = tuple(clean(s.name, 16) for s in found.having(one.condition)) if each else ()
    title = f"{clean(one.condition)}: part of the load that the device takes [%]"
    return Table(title, ("Coordinate", "Mean", "Interval", *subjects), tuple(rows)) if rows else None


def device_section(found: Pooled, ledger: Ledger) -> Section | None:
    """Shares of human and device; None where nothing was worn."""
    tables = [share_table(found, ledger, one, len(found.having(one.condition)) <= ABREAST) for one in found.comparisons]
    blocks = tuple(table for table in tables if table is not None)
    said = (
        "Load is the time integral of a torque's size over all cycles: what human and device bear together, minus what "
        "the human bears, as a part of the former. Negative where the device adds to the human's load."
    )
    return Section("device", "What the device takes", said, blocks) if blocks else None


def reach_section(found: Pooled, ledger: Ledger) -> Section:
    """Who and what was left out, and what each subject's evaluation cannot say."""
    own = Items(gap_lines(ledger, found.gaps) or ("Nobody and nothing was left out.",))
    common = [gap for gap in found.subjects[0].gaps if all(gap in one.gaps for one in found.subjects)]
    each: list[Block] = []
    for title, gaps in [
        ("What no evaluation can say", common),
        *(
            (
                f"What the evaluation of {clean(one.name)} cannot say besides",
                [gap for gap in one.gaps if gap not in common],
            )
            for one in found.subjects
        ),
    ]:
        if gaps:
            each.append(Details(title, (Items(gap_lines(ledger, [Gap(*gap) for gap in gaps])),)))
    for one in found.subjects:
        if one.corrections:
            lines = tuple(ledger.say("correction", clean(text, 600)) for text in one.corrections)
            each.append(Details(f"Corrections that the evaluation of {clean(one.name)} rests on", (Items(lines),)))
    return Section(
        "reach", "What cannot be said, and what it rests on", "Nothing was left out for how it looks.", (own, *each)
    )


SHARES = 4
"""Choice. Of the device's shares, so many fit on the first page, shared by the comparisons."""


def render_study(found: Pooled, ledger: Ledger) -> str:
    """The page as text.

    Args:
        ledger: of its numbers; remembers what is shown.
    """

    def picture(one: Comparison, panels: int, key: str) -> Figure | None:
        order = one.ranked()[:panels]
        title = f"{clean(one.condition)} minus {clean(one.reference)}, every subject a row."
        return Figure(draw_subjects(found, one, order, key), title) if order else None

    return render_compared(found, [
        summary_section(found, ledger, _who(found, ledger), picture, _shares(found, ledger)),
        differences_section(found, ledger), subjects_section(found, ledger), courses_section(found, ledger),
        device_section(found, ledger), reach_section(found, ledger),
        method_section(found, ledger, "Intervals are Student's over subjects."),
    ])  # fmt: skip


def _who(found: Pooled, ledger: Ledger) -> Table:
    rows = []
    for condition in found.names:
        worn = list(dict.fromkeys(one.devices[condition] or "nothing worn" for one in found.having(condition)))
        role = " (reference)" if condition == found.reference else ""
        count = ledger.show(Key("test", "recorded", condition), 0)
        rows.append((f"{clean(condition)}{role}", listing(worn, 3), count))
    return Table("", ("Condition", "Device", "Subjects"), tuple(rows), text=2)


def _shares(found: Pooled, ledger: Ledger) -> list[str]:
    """What the device takes of the coordinates on which it acts most."""
    lines: list[str] = []
    for one in found.comparisons:
        said = []
        sizes = {where: abs(ledger.value(_taken(one, where))) for where in taken(found, one)[0]}
        largest = sorted((w for w in sizes if sizes[w] >= 0.005), key=lambda w: -sizes[w])
        for where in largest[: SHARES // len(found.comparisons)]:
            key = _taken(one, where)
            said.append(f"{where_words(where)} {ledger.show(key, 0, 100.0)} % ({interval(ledger, key, 0, 100.0)})")
        if said:
            what = f"Part of the load that the device takes in {clean(one.condition)}, the rest is the human's"
            lines.append(f"{what}: {'; '.join(said)}.")
    return lines


def _taken(one: Comparison, where: str) -> Key:
    return Key("device", "value", one.condition, where, "load_taken")
