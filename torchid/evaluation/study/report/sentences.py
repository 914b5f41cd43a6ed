"""What a study found, in sentences for people who do not read statistics."""

import math

from torchid.evaluation.evaluation import Gap
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import column_unit
from torchid.evaluation.report.sentences import change
from torchid.evaluation.report.words import column_words, digits_of
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.evaluation.study.compare import SubjectsComparison
from torchid.evaluation.study.study import Pooled
from torchid.wording import ABSENT, clean


def key_of(one: SubjectsComparison, column: MeasureColumn, statistic: str, body: str = "identified") -> Key:
    """Key of a number of a difference over subjects.

    Args:
        one: the comparison.
        column: its measure.
        statistic: value, low, high, p, p_adjusted, g, agree, ...
        body: identified or template.
    """
    return Key("difference", statistic, one.condition, column.where, column.measure, body)


def ranked(one: SubjectsComparison) -> list[int]:
    """Columns with a mean difference, the smallest adjusted p first, then the largest effect.

    Args:
        one: the comparison.
    """
    own = one.answers["identified"]
    p = [x if math.isfinite(x) else math.inf for x in own.tested.adjusted.tolist()]
    size = [abs(x) if math.isfinite(x) else 0.0 for x in own.effect.value.tolist()]
    known = own.difference.value.isfinite().tolist()
    return sorted((k for k, has in enumerate(known) if has), key=lambda k: (p[k], -size[k]))


def interval(ledger: Ledger, key: Key, digits: int, factor: float = 1.0) -> str:
    """``LOW to HIGH`` of a number, a dash where one subject does not say how subjects scatter.

    Args:
        ledger: of its numbers.
        key: of its value.
        digits: decimals.
        factor: by which the values are multiplied.
    """
    low, high = (ledger.show(key._replace(statistic=end), digits, factor) for end in ("low", "high"))
    return ABSENT if low == ABSENT else f"{low} to {high}"


def finding(found: Pooled, ledger: Ledger, one: SubjectsComparison, k: int) -> str:
    """One difference in a sentence, and what the scaled template would have said.

    Args:
        found: the study.
        ledger: of its numbers.
        one: a comparison.
        k: number of its column.
    """
    column = one.columns[k]
    digits, own = digits_of(column.measure, found.per_mass), column_unit(column, found.per_mass)
    key = key_of(one, column, "value")
    agree, known = (ledger.show(key._replace(statistic=name), 0) for name in ("agree", "subjects"))
    percent = ledger.show(Key("method", "coverage"), 0, 100.0)
    words = column_words(column)
    return (
        f"{words[0].upper()}{words[1:]}: {change(ledger, key, digits, own)} on average ({percent} % interval "
        f"{interval(ledger, key, digits)}; effect size {ledger.show(key._replace(statistic='g'), 2)}; adjusted "
        f"p = {ledger.show(key._replace(statistic='p_adjusted'), 3)}), the same way in {agree} of {known} subjects. "
        f"{template(found, ledger, one, k)}"
    )


def template(found: Pooled, ledger: Ledger, one: SubjectsComparison, k: int) -> str:
    """What the scaled template would have said of a difference.

    Args:
        found: the study.
        ledger: of its numbers.
        one: a comparison.
        k: number of its column.
    """
    column, level = one.columns[k], found.study.level
    digits, own = digits_of(column.measure, found.per_mass), column_unit(column, found.per_mass)
    key = key_of(one, column, "p_adjusted", "template")
    if not math.isfinite(ledger.value(key)):
        return f"The {found.usual} would have said nothing."
    said = change(ledger, key._replace(statistic="value"), digits, own)
    same = (ledger.value(key) <= level) == (k in one.answers["identified"].found(level))
    verdict = "the same verdict" if same else "another verdict"
    return f"The {found.usual} would have said {said}, adjusted p = {ledger.show(key, 3)}: {verdict}."


def headline(found: Pooled, ledger: Ledger) -> str:
    """The whole study in a sentence or two.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    said = []
    for one in found.comparisons:
        names = f"{clean(one.condition)} and {clean(one.reference)}"
        count, every, findings = (
            ledger.show(Key("test", name, one.condition), 0) for name in ("subjects", "hypotheses", "findings")
        )
        if not one.testable:
            said.append(_untestable(ledger, one, names, count))
        else:
            number = len(one.answers["identified"].found(found.study.level))
            shown, verb = findings if number else "None", "differ" if number > 1 else "differs"
            said.append(
                f"{shown} of {every} measures {verb} between {names} over {count} subjects by more than chance."
            )
    level = ledger.show(Key("method", "level"), 0, 100.0)
    return " ".join(said) + f" The chance of any false finding is held at {level} %."


def _untestable(ledger: Ledger, one: SubjectsComparison, names: str, count: str) -> str:
    wanted, permutations, more = (
        ledger.show(Key("test", name, one.condition), 0) for name in ("wanted", "permutations", "wanted_permutations")
    )
    least = (f"{wanted} subjects", f"permutations: {more}")
    needed = " with ".join(words for words, short in zip(least, one.needs, strict=True) if short)
    given = f" with permutations: {permutations}" if one.needs[1] else ""
    return (
        f"Whether {names} differ for people in general cannot be told from {count} subjects{given}: {needed} are the "
        "least that can."
    )


def gap_line(ledger: Ledger, gap: Gap) -> str:
    """Something that cannot be said, remembered for the CSV.

    Args:
        ledger: of its numbers.
        gap: what and why.
    """
    return ledger.say("gap", clean(f"{gap.what}: {gap.why}.", 600))
