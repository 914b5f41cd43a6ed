"""What stands behind the first page of a study: all differences, every subject, courses, shares, gaps, method."""

from collections.abc import Sequence

from torchid.evaluation.evaluation import Gap
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import column_unit
from torchid.evaluation.report.method import BODIES, SIGNS
from torchid.evaluation.report.words import column_words, digits_of, headed, where_words
from torchid.evaluation.study.compare import SubjectsComparison
from torchid.evaluation.study.numbers import columns_of, taken
from torchid.evaluation.study.report.figures import draw_study_courses
from torchid.evaluation.study.report.sentences import gap_line, interval, key_of, ranked
from torchid.evaluation.study.study import Pooled
from torchid.report.blocks import Block, Details, Figure, Items, Section, Table
from torchid.wording import clean

HEAD = ("Measure", "Difference", "Interval", "Agree", "Adj. p", "Template", "Adj. p", "Hedges' g", "Interval")
ABREAST = 8
"""Choice. Subjects beside each other in a table that fits a printed page."""


def difference_rows(
    found: Pooled, ledger: Ledger, one: SubjectsComparison, columns: Sequence[int], title: str, effects: bool = True
) -> Table:  # fmt: skip
    """Table of differences over subjects, findings in bold.

    Args:
        found: the study.
        ledger: of its numbers.
        one: a comparison.
        columns: numbers of its columns.
        title: of the table.
        effects: whether the interval of the standardised effect is shown too.
    """
    rows = []
    for k in columns:
        column = one.columns[k]
        digits, own = digits_of(column.measure, found.per_mass), column_unit(column, found.per_mass)
        key, plain = (key_of(one, column, "value", body) for body in ("identified", "template"))
        agree, known = (ledger.show(key._replace(statistic=name), 0) for name in ("agree", "subjects"))
        g = key._replace(statistic="g")
        ends = [ledger.show(key._replace(statistic=name), 2) for name in ("g_low", "g_high")] if effects else []
        rows.append((
            f"{column_words(column)}{f' [{own}]' if own else ''}", ledger.show(key, digits),
            interval(ledger, key, digits), f"{agree} of {known}",
            ledger.show(key._replace(statistic="p_adjusted"), 3), ledger.show(plain, digits),
            ledger.show(plain._replace(statistic="p_adjusted"), 3), ledger.show(g, 2),
            *([" to ".join(ends)] if effects else []),
        ))  # fmt: skip
    own = set(one.answers["identified"].found(found.study.level))
    strong = frozenset(k for k, column in enumerate(columns) if column in own)
    return Table(title, headed(HEAD if effects else HEAD[:-1], found.usual), tuple(rows), strong=strong)


def differences_section(found: Pooled, ledger: Ledger) -> Section:
    """All differences.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    blocks: list[Block] = [
        difference_rows(found, ledger, one, ranked(one), f"{clean(one.condition)} minus {clean(one.reference)}")
        for one in found.comparisons
    ]
    percent = ledger.show(Key("method", "coverage"), 0, 100.0)
    said = (
        f"Mean over subjects of each one's own difference; intervals are {percent} % each, over subjects. Agree: "
        "subjects that change as the mean does. p-values are adjusted for all measures and conditions together. "
    )
    return Section("differences", "All differences", said + "Rows in bold are findings.", tuple(blocks))


def subjects_section(found: Pooled, ledger: Ledger) -> Section:
    """Every subject's differences and values.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    blocks: list[Block] = []
    for one in found.comparisons:
        title = f"{clean(one.condition)} minus {clean(one.reference)}"
        names = [subject.name for subject in one.subjects]
        blocks += _each(found, ledger, Key("difference", "value", one.condition), names, title)
    for condition in found.conditions:
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
            digits, unit = digits_of(column.measure, found.per_mass), column_unit(column, found.per_mass)
            each = [ledger.show(own._replace(item=name), digits) for name in some]
            rows.append((f"{column_words(column)}{f' [{unit}]' if unit else ''}", *each, ledger.show(own, digits)))
        tables.append(Table(title, ("Measure", *(clean(name, 16) for name in some), "Mean"), tuple(rows)))
    return tables


def courses_section(found: Pooled, ledger: Ledger) -> Section:
    """All courses over the cycle.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    blocks = tuple(
        Figure(draw_study_courses(found, one, f"c{k}"),
               f"{clean(one.condition)} and {clean(one.reference)}, in the sense of the coordinate.")
        for k, one in enumerate(found.comparisons)
    )  # fmt: skip
    level, percent = (ledger.show(Key("method", name), 0, 100.0) for name in ("level", "coverage"))
    said = (
        f"Means over subjects; bands are {percent} % intervals of the mean over subjects. Where a bar marks a "
        f"difference, it is one at {level} % for all points of all marked courses together."
    )
    return Section("courses", "Human and device over the cycle", said, blocks)


def share_table(found: Pooled, ledger: Ledger, one: SubjectsComparison, each: bool) -> Table | None:
    """Part of the load on each coordinate that the device takes; None where nothing was worn.

    Args:
        found: the study.
        ledger: of its numbers.
        one: a comparison.
        each: whether every subject has a column.
    """
    names, _ = taken(found, one)
    rows = []
    for where in names:
        key = Key("device", "value", one.condition, where, "load_taken")
        own = [ledger.show(key._replace(item=s.name), 0, 100.0) for s in one.subjects] if each else []
        rows.append((where_words(where), ledger.show(key, 0, 100.0), interval(ledger, key, 0, 100.0), *own))
    subjects = tuple(clean(s.name, 16) for s in one.subjects) if each else ()
    title = f"{clean(one.condition)}: part of the load that the device takes [%]"
    return Table(title, ("Coordinate", "Mean", "Interval", *subjects), tuple(rows)) if rows else None


def device_section(found: Pooled, ledger: Ledger) -> Section | None:
    """Shares of human and device; None where nothing was worn.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    tables = [share_table(found, ledger, one, len(one.subjects) <= ABREAST) for one in found.comparisons]
    blocks = tuple(table for table in tables if table is not None)
    said = (
        "Load is the time integral of a torque's size over all cycles: what human and device bear together, minus what "
        "the human bears, as a part of the former. Negative where the device adds to the human's load."
    )
    return Section("device", "What the device takes", said, blocks) if blocks else None


def reach_section(found: Pooled, ledger: Ledger) -> Section:
    """Who and what was left out, and what each subject's evaluation cannot say.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    own = Items(tuple(gap_line(ledger, gap) for gap in found.gaps) or ("Nobody and nothing was left out.",))
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
            each.append(Details(title, (Items(tuple(gap_line(ledger, Gap(*gap)) for gap in gaps)),)))
    return Section("reach", "What cannot be said", "Nothing was left out for how it looks.", (own, *each))


def method_section(found: Pooled, ledger: Ledger) -> Section:
    """How the figures were made.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    items = [
        "Every subject was evaluated alone (human torque: inverse dynamics of the identified body and of the parts "
        "that it carries, minus the plates, minus the device's generalised force), and is one unit here.",
        f"Coordinates: {SIGNS[found.subjects[0].signs]}.",
        *(_test(ledger, one) for one in found.comparisons),
        "p-values are adjusted by the step-down maximum over all measures (Westfall & Young 1993), and by the number "
        "of conditions that are compared. Intervals are Student's over subjects.",
        "Effect size: Hedges' g of paired differences, their mean over their standard deviation; interval of the "
        "non-central t distribution (Cumming & Finch 2001).",
        *(BODIES[one] for one in dict.fromkeys(subject.usual for subject in found.subjects)),
    ]
    said = "Equations and limits: docs/evaluate.md of torchid."
    return Section("method", "Method", said, (Items(tuple(items)),))


def _test(ledger: Ledger, one: SubjectsComparison) -> str:
    count, least = (ledger.show(Key("test", name, one.condition), d) for name, d in (("subjects", 0), ("least_p", 4)))
    return (
        f"{clean(one.condition)}: signs of {count} subjects' differences were flipped (Nichols & Holmes 2002); no "
        f"p-value can be below {least}."
    )
