"""What was found, in sentences for people who do not read statistics."""

import math

from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import unit
from torchid.evaluation.report.words import column_words, digits_of
from torchid.evaluation.statistics.comparing import Comparison, MeasureColumn
from torchid.wording import clean

SIGNED = ("max_torque_Nm", "min_torque_Nm", "mean_torque_Nm", "negative_work_J")
"""Measures with a sign, of which neither lower nor higher is less."""


def difference_key(comparison: Comparison, column: MeasureColumn, statistic: str, body: str = "identified") -> Key:
    """Key of a number of a difference.

    Args:
        comparison: of a condition.
        column: its measure.
        statistic: value, low, high, p, p_adjusted, g, ...
        body: identified or template.
    """
    return Key("difference", statistic, comparison.condition, column.where, column.measure, body)


def ranked(comparison: Comparison) -> list[int]:
    """Columns that could be tested, the smallest adjusted p first, the largest effect before others as small.

    Args:
        comparison: of a condition.
    """
    p, size = comparison.tested.adjusted.tolist(), comparison.tested.statistic.abs().tolist()
    return sorted((k for k, one in enumerate(p) if math.isfinite(one)), key=lambda k: (p[k], -size[k]))


def finding(found: Evaluation, ledger: Ledger, comparison: Comparison, k: int) -> str:
    """One difference in a sentence, and what the scaled template would have said.

    Args:
        found: the evaluation.
        ledger: of its numbers.
        comparison: of a condition.
        k: number of the column.
    """
    column = comparison.columns[k]
    digits, own = digits_of(column.measure, found.per_mass_kg is not None), unit(found, column)
    means = [
        ledger.show(Key("measure", "value", name, column.where, column.measure), digits)
        for name in (comparison.condition, comparison.reference)
    ]
    low, high = (ledger.show(difference_key(comparison, column, end), digits) for end in ("low", "high"))
    percent = ledger.show(Key("method", "coverage"), 0, 100.0)
    words = column_words(column)
    return (
        f"{words[0].upper()}{words[1:]}: {change(ledger, difference_key(comparison, column, 'value'), digits, own)} "
        f"({means[0]} against {means[1]}; {percent} % interval of the difference {low} to {high}; adjusted "
        f"p = {ledger.show(difference_key(comparison, column, 'p_adjusted'), 3)}). "
        f"{template(found, ledger, comparison, k)}"
    )


def change(ledger: Ledger, key: Key, digits: int, own: str) -> str:
    """A difference in words: ``4.2 N m lower``.

    Args:
        ledger: of its number.
        key: of a difference's value.
        digits: decimals.
        own: its unit.
    """
    behind = own if own in ("", "°") else f" {own}"
    if key.measure in SIGNED:
        return f"{ledger.show(key, digits)}{behind} different"
    way = "lower" if ledger.value(key) < 0.0 else "higher"
    return f"{ledger.size(key, digits)}{behind} {way}"


def template(found: Evaluation, ledger: Ledger, comparison: Comparison, k: int) -> str:
    """What the scaled template would have said of a difference.

    Args:
        found: the evaluation.
        ledger: of its numbers.
        comparison: of the identified body.
        k: number of the column.
    """
    column, level = comparison.columns[k], found.config.evaluate.level
    digits = digits_of(column.measure, found.per_mass_kg is not None)
    key = difference_key(comparison, column, "p_adjusted", "template")
    if not math.isfinite(ledger.value(key)):
        return f"The {found.usual} would have said nothing."
    said = change(ledger, difference_key(comparison, column, "value", "template"), digits, unit(found, column))
    same = (ledger.value(key) <= level) == (float(comparison.tested.adjusted[k]) <= level)
    verdict = "the same verdict" if same else "another verdict"
    return f"The {found.usual} would have said {said}, adjusted p = {ledger.show(key, 3)}: {verdict}."


def headline(found: Evaluation, ledger: Ledger) -> str:
    """The whole evaluation in a sentence or two.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    said = []
    for one in found.identified.comparisons:
        number = len(one.found(found.config.evaluate.level))
        names = f"{clean(one.condition)} and {clean(one.reference)}"
        if not one.units.testable:
            said.append(f"Whether {names} differ cannot be told from these trials.")
        elif number:
            shown = ledger.show(Key("test", "findings", one.condition), 0)
            every = ledger.show(Key("test", "hypotheses", one.condition), 0)
            said.append(f"{shown} of {every} measures differ between {names} by more than chance makes.")
        else:
            every = ledger.show(Key("test", "hypotheses", one.condition), 0)
            said.append(f"None of {every} measures differs between {names} by more than chance makes.")
    if any(one.units.kind == "blocks" for one in found.identified.comparisons):
        said.append("Of these recordings, that is: whether the condition did it, single trials cannot tell.")
    level = ledger.show(Key("method", "level"), 0, 100.0)
    return " ".join(said) + f" The chance of any false finding is held at {level} %."
