"""The first page of a study: who, what was found, every subject, the shares, the back, and what cannot be said."""

import math

from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.report.words import where_words
from torchid.evaluation.study.compare import SubjectsComparison
from torchid.evaluation.study.numbers import PRESSED, taken
from torchid.evaluation.study.report.details import difference_rows
from torchid.evaluation.study.report.figures import draw_subjects
from torchid.evaluation.study.report.sentences import finding, gap_line, headline, interval, ranked
from torchid.evaluation.study.study import Pooled
from torchid.evaluation.torque_shares.back import NIOSH_N
from torchid.report.blocks import Block, Figure, Items, Paragraph, Section, Table
from torchid.wording import clean, listing

FINDINGS, ROWS, PANELS, GAPS, SHARES = 3, 6, 4, 3, 4
"""Choice. Of findings, differences, measures with dots, gaps and device's shares, so many fit on the first page, shared
by the comparisons; all of them are behind it."""


def summary_section(found: Pooled, ledger: Ledger) -> Section:
    """The page that can be handed on alone.

    Args:
        found: the study.
        ledger: of its numbers.
    """
    blocks: list[Block] = [_who(found, ledger)]
    for number, one in enumerate(found.comparisons):
        blocks += _compared(found, ledger, number, one)
    blocks += [*_shares(found, ledger), *_back(found, ledger)]
    some = [gap_line(ledger, gap) for gap in found.gaps[: max(1, GAPS // len(found.comparisons))]]
    blocks += [Paragraph("Left out, or not determinable:"), Items(tuple(some))] if some else []
    return Section("summary", "Summary", headline(found, ledger), tuple(blocks))


def _who(found: Pooled, ledger: Ledger) -> Table:
    rows = []
    for condition in found.conditions:
        worn = list(dict.fromkeys(one.devices[condition] or "nothing worn" for one in found.having(condition)))
        role = " (reference)" if condition == found.reference else ""
        count = ledger.show(Key("test", "recorded", condition), 0)
        rows.append((f"{clean(condition)}{role}", listing(worn, 3), count))
    return Table("", ("Condition", "Device", "Subjects"), tuple(rows), text=2)


def _compared(found: Pooled, ledger: Ledger, number: int, one: SubjectsComparison) -> list[Block]:
    share, order = len(found.comparisons), ranked(one)
    own = set(one.answers["identified"].found(found.study.level))
    some = [k for k in order if k in own][: max(1, FINDINGS // share)]
    blocks: list[Block] = [Items(tuple(finding(found, ledger, one, k) for k in some))] if some else []
    panels = PANELS // share
    if panels > 1 and order:
        title = f"{clean(one.condition)} minus {clean(one.reference)}, every subject a row."
        blocks.append(Figure(draw_subjects(found, one, order[:panels], f"s{number}"), title))
    if share == 1:
        title = f"Largest differences, {clean(one.condition)} minus {clean(one.reference)}"
        blocks.append(difference_rows(found, ledger, one, order[:ROWS], title, effects=False))
    return blocks


def _shares(found: Pooled, ledger: Ledger) -> list[Block]:
    """What the device takes of the coordinates on which it acts most."""
    blocks: list[Block] = []
    for one in found.comparisons:
        said = []
        sizes = {where: abs(ledger.value(_taken(one, where))) for where in taken(found, one)[0]}
        largest = sorted((w for w in sizes if sizes[w] >= 0.005), key=lambda w: -sizes[w])
        for where in largest[: SHARES // len(found.comparisons)]:
            key = _taken(one, where)
            said.append(f"{where_words(where)} {ledger.show(key, 0, 100.0)} % ({interval(ledger, key, 0, 100.0)})")
        if said:
            what = f"Part of the load that the device takes in {clean(one.condition)}, the rest is the human's"
            blocks.append(Paragraph(f"{what}: {'; '.join(said)}."))
    return blocks


def _taken(one: SubjectsComparison, where: str) -> Key:
    return Key("device", "value", one.condition, where, "load_taken")


def _back(found: Pooled, ledger: Ledger) -> list[Block]:
    said, above = [], False
    for condition in found.conditions:
        key = Key("measure", "value", condition, *PRESSED)
        if not ledger.has(key) or not math.isfinite(ledger.value(key)):
            continue
        count = ledger.show(key._replace(statistic="above_limit"), 0)
        every = ledger.show(key._replace(statistic="known"), 0)
        said.append(f"{ledger.show(key, 0)} N in {clean(condition)} ({interval(ledger, key, 0)}; above the limit in "
                    f"{count} of {every} subjects)")  # fmt: skip
        above = above or ledger.value(key) > NIOSH_N
    if not said:
        return []
    limit = ledger.show(Key("method", "limit", "", *PRESSED), 0)
    side = "the mean is above it in at least one condition" if above else "the mean is below it in all conditions"
    return [Paragraph(f"Low back: peak compression at L5/S1 is {', '.join(said)}; NIOSH's limit is {limit} N, {side}.")]
