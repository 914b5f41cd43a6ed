"""What stands behind the first page of a study alone: every subject, shares of the device, who was left out."""

from collections.abc import Sequence

from torchid.evaluation.compared import Gap
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.report.sentences import gap_lines, interval
from torchid.evaluation.report.words import digits_of, labelled, where_words
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.study.numbers import columns_of, taken
from torchid.evaluation.study.study import Pooled
from torchid.report.blocks import Block, Details, Items, Section, Table
from torchid.wording import clean

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
