"""What stands behind the first page: all differences, values, courses, cycles, contacts, devices and gaps."""

import math
from collections.abc import Sequence

from torchid.devices import SheetFinding
from torchid.evaluation.cycle_measures.cycles import APART
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.gaps import contradicted
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import cycle_name, unit
from torchid.evaluation.report.figures import draw_courses
from torchid.evaluation.report.sentences import difference_key, ranked
from torchid.evaluation.report.words import column_words, digits_of, headed, where_words
from torchid.evaluation.statistics.comparing import Comparison
from torchid.report.blocks import Block, Details, Figure, Items, Paragraph, Section, Table
from torchid.wording import ABSENT, clean, segment

HEAD = ("Measure", "Reference", "Condition", "Difference", "Interval", "Adj. p", "Template", "Adj. p", "Hedges' g")
"""The two columns on the scaled template say what it would have said of the difference."""


def difference_rows(
    found: Evaluation, ledger: Ledger, one: Comparison, columns: Sequence[int], title: str, effects: bool = True
) -> Table:  # fmt: skip
    """Table of differences, found ones in bold.

    Args:
        found: the evaluation.
        ledger: of its numbers.
        one: a comparison.
        columns: numbers of its columns.
        title: of the table.
        effects: whether there is a column of standardised effects.
    """
    rows = []
    for k in columns:
        column = one.columns[k]
        digits = digits_of(column.measure, found.per_mass_kg is not None)

        def show(name: str, decimals: int = digits, body: str = "identified", of: int = k) -> str:
            return ledger.show(difference_key(one, one.columns[of], name, body), decimals)

        means = [
            ledger.show(Key("measure", "value", name, column.where, column.measure), digits)
            for name in (one.reference, one.condition)
        ]
        own = unit(found, column)
        rows.append((
            f"{column_words(column)}{f' [{own}]' if own else ''}", *means, show("value"),
            f"{show('low')} to {show('high')}", show("p_adjusted", 3),
            show("value", digits, "template"), show("p_adjusted", 3, "template"), *([show("g", 2)] if effects else []),
        ))  # fmt: skip
    own = set(one.found(found.config.evaluate.level))
    strong = frozenset(k for k, column in enumerate(columns) if column in own)
    return Table(title, headed(HEAD if effects else HEAD[:-1], found.usual), tuple(rows), strong=strong)


def differences_section(found: Evaluation, ledger: Ledger) -> Section:
    """All differences.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    blocks: list[Block] = []
    for one in found.identified.comparisons:
        title = f"{clean(one.condition)} minus {clean(one.reference)}"
        blocks.append(difference_rows(found, ledger, one, ranked(one) or range(len(one.columns)), title))
    percent = ledger.show(Key("method", "coverage"), 0, 100.0)
    said = f"Intervals are {percent} % each; p-values are adjusted for all measures and conditions together. "
    return Section("differences", "All differences", said + "Rows in bold are findings.", tuple(blocks))


def values_section(found: Evaluation, ledger: Ledger) -> Section:
    """Means of all conditions with both bodies.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    tables: list[Block] = []
    for name in found.config.conditions:
        rows = []
        for column in found.layout.columns:
            key = Key("measure", "value", name, column.where, column.measure)
            if not math.isfinite(ledger.value(key)):
                continue
            digits, own = digits_of(column.measure, found.per_mass_kg is not None), unit(found, column)
            low, high = (ledger.show(key._replace(statistic=end), digits) for end in ("low", "high"))
            interval = ABSENT if low == ABSENT else f"{low} to {high}"
            rows.append((
                f"{column_words(column)}{f' [{own}]' if own else ''}", ledger.show(key, digits), interval,
                ledger.show(key._replace(statistic="cycles"), 0),
                ledger.show(key._replace(body="template"), digits),
            ))  # fmt: skip
        head = ("Measure", "Mean", "Interval", "Cycles", found.usual.capitalize())
        tables.append(Table(clean(name), head, tuple(rows)))
    said = "Means over trials; torques, powers and works are the human's share."
    return Section("values", "Values of every condition", said, tuple(tables))


def courses_section(found: Evaluation, ledger: Ledger) -> Section:
    """All courses over the cycle.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    blocks: list[Block] = []
    for number, one in enumerate(found.identified.comparisons):
        words = f"{clean(one.condition)} and {clean(one.reference)}, in the sense of the coordinate."
        every = range(len(found.layout.courses))
        blocks.append(Figure(draw_courses(found, number, every, f"c{number}"), words))
    level = ledger.show(Key("method", "level"), 0, 100.0)
    said = f"Where a bar marks a difference, it is one at {level} % for all points of all marked courses together."
    return Section("courses", "Human and device over the cycle", said, tuple(blocks))


def device_section(found: Evaluation, ledger: Ledger) -> Section | None:
    """What the devices do; None where none was worn.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    blocks: list[Block] = []
    for condition, worn in found.worn.items():
        if worn.device is None:
            continue
        rows = []
        for name in found.layout.names:
            peak = Key("device", "peak", condition, name, "torque_Nm")
            load = Key("device", "load_taken", condition, name, "cumulative_load_Nms")
            rows.append((where_words(name), ledger.show(peak, 1), ledger.show(load, 2)))
        head = ("Coordinate", f"Device's peak torque [{found.unit('N m')}]", f"Load taken [{found.unit('N m s')}]")
        blocks.append(Table(f"{clean(condition)}: {clean(worn.device.name)}", head, tuple(rows)))
        blocks += [*_parameters(ledger, condition, worn.parameters), *_sheet(ledger, worn.findings)]
        blocks += [Paragraph(ledger.say("device", clean(source, 300))) for source in worn.device.sources]
    if not blocks:
        return None
    said = "Load taken is the cumulative load of human and device together minus the human's, per cycle."
    return Section("device", "What the device does", said, tuple(blocks))


def _parameters(ledger: Ledger, condition: str, parameters: dict[str, dict]) -> list[Block]:
    rows = []
    for name, one in parameters.items():
        if "value" in one and ".com_" not in name:
            rows.append(
                (name, *(ledger.show(Key("device", part, condition, item=name), 3) for part in ("value", "sd")))
            )
    return [Table("Found of what its sheet leaves open", ("Parameter", "Value", "sd"), tuple(rows))] if rows else []


def _sheet(ledger: Ledger, findings: Sequence[SheetFinding]) -> list[Block]:
    """What the recordings say against the device's sheet, and what they cannot say of it."""
    said = []
    for one in findings:
        kind = one.kind.replace("_", " ")
        if one.found is None:
            said.append(f"{kind} of {one.where}: cannot be tested, {one.why}.")
        elif one.wrong:
            said.append(f"{kind} of {one.where}: {contradicted(one)}.")
    lines = tuple(ledger.say("device", clean(text, 400)) for text in said)
    return [Paragraph("The sheet against the recordings:"), Items(lines)] if lines else []


def reach_section(found: Evaluation, ledger: Ledger) -> Section:
    """Cycles, contacts, and everything that cannot be said.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    gaps = Items(tuple(ledger.say("gap", f"{gap.what}: {gap.why}.") for gap in found.gaps))
    blocks = (gaps, _contacts(found, ledger), *_apart(found, ledger), _cycles(found, ledger))
    return Section("reach", "What cannot be said, and what it rests on",
                   "Nothing was left out for how it looks.", blocks)  # fmt: skip


def _contacts(found: Evaluation, ledger: Ledger) -> Block:
    rows = []
    for one in found.contacts:
        shares = [ledger.show(Key("contact", n, one.condition, item=one.foot), 0, 100.0)
                  for n in ("measured", "shared", "beside")]  # fmt: skip
        rows.append((clean(one.condition), segment(one.foot), *shares))
    head = ("Condition", "Foot", "On its own plate [%]", "On a shared plate [%]", "Beside the plates [%]")
    return Table("Where the forces of the feet come from, parts of their contact", head, tuple(rows), text=2)


def _apart(found: Evaluation, ledger: Ledger) -> list[Block]:
    score = ledger.show(Key("method", "apart"), 1)
    names = [name for name, k in _names(found) if float(found.apart[k]) > APART]
    if not names:
        return []
    said = f"Cycles that stand apart from the others of their condition (modified z above {score}), and are in all "
    return [Paragraph(f"{said}figures: {', '.join(clean(name) for name in names)}.")]


def _cycles(found: Evaluation, ledger: Ledger) -> Block:
    rows = []
    for name, k in _names(found):
        key = Key("cycle", "", found.conditions[k], item=name)
        ends = [ledger.show(key._replace(statistic=end), 2) for end in ("t0", "t1")]
        score = ledger.show(key._replace(statistic="score"), 1)
        rows.append((clean(name), clean(found.conditions[k]), *ends, score))
    head = ("Cycle", "Condition", "From [s]", "To [s]", "Apart (z)")
    return Details("All cycles", (Table("", head, tuple(rows), text=2),))


def _names(found: Evaluation) -> list[tuple[str, int]]:
    seen: dict[str, int] = {}
    names = []
    for k, cycle in enumerate(found.cycles):
        seen[cycle.trial] = seen.get(cycle.trial, 0) + 1
        names.append((cycle_name(cycle.trial, seen[cycle.trial], cycle.side), k))
    return names
