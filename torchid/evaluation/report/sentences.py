"""What was found, in sentences for people who do not read statistics."""

import math
from collections.abc import Sequence

from torchid.evaluation.compared import Compared, Gap
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.loads import LEAST_PART, load_change
from torchid.evaluation.numbers import PRESSED, column_unit
from torchid.evaluation.report.words import column_words, digits_of, where_words
from torchid.evaluation.statistics.comparing import Comparison, MeasureColumn
from torchid.evaluation.torque_shares.back import NIOSH_N
from torchid.wording import ABSENT, clean, listing

SIGNED = ("max_torque_Nm", "min_torque_Nm", "mean_torque_Nm", "negative_work_J")
"""Measures with a sign, of which neither lower nor higher is less."""
SOME = 4
"""Choice. Names that a sentence lists."""


def difference_key(one: Comparison, column: MeasureColumn, statistic: str, body: str = "identified") -> Key:
    """Key of a number of a difference.

    Args:
        statistic: value, low, high, p, p_adjusted, g, agree, ...
        body: identified or template.
    """
    return Key("difference", statistic, one.condition, column.where, column.measure, body)


def interval(ledger: Ledger, key: Key, digits: int, factor: float = 1.0) -> str:
    """``LOW to HIGH`` of a number, a dash where one unit does not say how units scatter.

    Args:
        factor: by which the values are multiplied.
    """
    low, high = (ledger.show(key._replace(statistic=end), digits, factor) for end in ("low", "high"))
    return ABSENT if low == ABSENT else f"{low} to {high}"


def change(ledger: Ledger, key: Key, digits: int, own: str) -> str:
    """A difference in words: ``4.2 N m lower``.

    Args:
        key: of a difference's value.
        own: its unit.
    """
    behind = own if own in ("", "°") else f" {own}"
    ways = ("more negative", "more positive") if key.measure in SIGNED else ("lower", "higher")
    way = ways[ledger.value(key) >= 0.0]
    return f"{ledger.size(key, digits)}{behind} {way}"


def changed(found: Compared, ledger: Ledger, one: Comparison, k: int, body: str = "identified") -> str:
    """The difference of a column in words.

    Args:
        body: identified or template.
    """
    column = one.columns[k]
    digits, own = digits_of(column.measure, found.per_mass), column_unit(column, found.per_mass)
    return change(ledger, difference_key(one, column, "value", body), digits, own)


def finding(found: Compared, ledger: Ledger, one: Comparison, k: int) -> str:
    """One difference in a few sentences, and what the scaled template would have said.

    Args:
        k: number of its column.
    """
    column, digits = one.columns[k], digits_of(one.columns[k].measure, found.per_mass)
    key, percent = difference_key(one, column, "value"), ledger.show(Key("method", "coverage"), 0, 100.0)
    words = column_words(column)
    said = (
        f"{words[0].upper()}{words[1:]}: {changed(found, ledger, one, k)}{_beside(ledger, one, column, digits)} "
        f"({percent} % interval {interval(ledger, key, digits)}; adjusted "
        f"p = {ledger.show(key._replace(statistic='p_adjusted'), 3)}; effect size "
        f"{ledger.show(key._replace(statistic='g'), 2)})."
    )
    return f"{said} {_template(found, ledger, one, k)}"


def _beside(ledger: Ledger, one: Comparison, column: MeasureColumn, digits: int) -> str:
    """Means of both conditions; over subjects, in how many of them it is so."""
    if one.units.paired:
        key = difference_key(one, column, "agree")
        agree, known = (ledger.show(key._replace(statistic=name), 0) for name in ("agree", "subjects"))
        return f" on average, the same way in {agree} of {known} subjects"
    means = [ledger.show(Key("measure", "value", name, column.where, column.measure), digits)
             for name in (one.condition, one.reference)]  # fmt: skip
    return f", {means[0]} against {means[1]}"


def _template(found: Compared, ledger: Ledger, one: Comparison, k: int) -> str:
    key = difference_key(one, one.columns[k], "p_adjusted", "template")
    if not math.isfinite(ledger.value(key)):
        return f"The {found.usual} says nothing."
    same = (ledger.value(key) <= found.level) == (float(one.tested.adjusted[k]) <= found.level)
    said = changed(found, ledger, one, k, "template")
    return f"The {found.usual} says {said}, p = {ledger.show(key, 3)}: {'the same' if same else 'another'} verdict."


def headline(found: Compared, ledger: Ledger) -> str:
    """The whole evaluation or study in a few sentences, each condition's verdict first."""
    said = [part for one in found.comparisons for part in _verdict(found, ledger, one)]
    if any(one.testable and one.units.kind == "blocks" for one in found.comparisons):
        said.append("Single trials cannot tell whether the condition did it.")
    return " ".join(said)


def _verdict(found: Compared, ledger: Ledger, one: Comparison) -> list[str]:
    """Whether a condition helps, what was found, and where its device gives too much."""
    over = _beyond(found, ledger, one)
    asked = f"Does \u201c{clean(one.condition)}\u201d help?"
    if not one.testable:
        return [ledger.say("test", f"{asked} Not testable: {one.needed.said}."), *over]
    loads = load_change(one, found.level)
    tested, lower, higher = (
        ledger.show(Key("test", name, one.condition), 0) for name in ("loads", "loads_lower", "loads_higher")
    )
    answer = "Not shown" if not loads.lower else "Partly" if loads.higher or over else "Yes"
    if loads.higher and not loads.lower:
        answer = "No"
    largest = [
        f" ({column_words(one.columns[k])}: {changed(found, ledger, one, k)})"
        for k in (*loads.lower[:1], *([] if loads.lower else loads.higher[:1]))
    ]
    counted = f"{lower} of {tested} loads lower, {higher} higher"
    return [f"{asked} {answer}: {counted}{''.join(largest)}.", *over, *_counted(found, ledger, one)]


def _counted(found: Compared, ledger: Ledger, one: Comparison) -> list[str]:
    """How many measures and courses differ, and which courses."""
    key = Key("test", "", one.condition)
    findings, every, courses, all_courses = (
        ledger.show(key._replace(statistic=name), 0)
        for name in ("findings", "hypotheses", "course_findings", "courses")
    )
    level = ledger.show(Key("method", "level"), 0, 100.0)
    if not (one.found(found.level) or one.found_courses(found.level)):
        return [
            f"No significant difference (0 of {every} measures, 0 of {all_courses} courses, family-wise {level} %)."
        ]
    counted = f"{findings} of {every} measures and {courses} of {all_courses} courses differ"
    some = dict.fromkeys(where_words(one.courses[j].where) for j in one.found_courses(found.level))
    where = [f"Over the cycle: {listing(list(some), SOME)}."] if some else []
    return [f"{counted} significantly (family-wise {level} %).", *where]


def _beyond(found: Compared, ledger: Ledger, one: Comparison) -> list[str]:
    """Where the device gives more than the joint needs."""
    said = []
    for column in one.courses:
        key = Key("device", "beyond_part", one.condition, column.where, column.measure)
        if ledger.has(key) and ledger.value(key) >= LEAST_PART:
            unit, digits = column_unit(column, found.per_mass), digits_of(column.measure, found.per_mass)
            back = ledger.show(key._replace(statistic="beyond_torque"), digits)
            said.append(
                f"{where_words(column.where)} ({ledger.show(key, 0, 100.0)} % of the cycle, up to {back} {unit})"
            )
    if not said:
        return []
    more = f" and {len(said) - SOME + 1} more" if len(said) > SOME else ""
    shown = said[: SOME - 1] if more else said
    return [f"The device gives more than the joint needs, and the person works against it: {', '.join(shown)}{more}."]


def back_line(found: Compared, ledger: Ledger) -> str:
    """Peak compression of the low back against NIOSH's limit; empty where no condition has any."""
    said, above = [], False
    for condition in found.names:
        key = Key("measure", "value", condition, *PRESSED)
        if not ledger.has(key) or not math.isfinite(ledger.value(key)):
            continue
        counted, many = "", key._replace(statistic="above_limit")
        if ledger.has(many):
            count, known = (ledger.show(key._replace(statistic=name), 0) for name in ("above_limit", "known"))
            counted = f"; above the limit in {count} of {known} subjects"
        said.append(f"{ledger.show(key, 0)} N in {clean(condition)} ({interval(ledger, key, 0)}{counted})")
        above = above or ledger.value(key) > NIOSH_N
    limit = ledger.show(Key("method", "limit", "", *PRESSED), 0)
    side = "above it in at least one condition" if above else "below it in all conditions"
    mean = "on average " if any("subjects" in one for one in said) else ""
    return (
        f"Low back: peak compression at L5/S1 is {', '.join(said)}. NIOSH's limit is {limit} N: {mean}{side}."
        if said
        else ""
    )


def gap_lines(ledger: Ledger, gaps: Sequence[Gap]) -> tuple[str, ...]:
    """What cannot be said, remembered for the CSV.

    Args:
        gaps: what and why.
    """
    return tuple(ledger.say("gap", clean(f"{gap.what}: {gap.why}.", 600)) for gap in gaps)
