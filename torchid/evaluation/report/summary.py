"""The first page: who, what was found, the shares of human and device, the back, and what cannot be said."""

import math

from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.report.details import difference_rows
from torchid.evaluation.report.figures import draw_courses
from torchid.evaluation.report.sentences import finding, headline, ranked
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.torque_shares.back import NIOSH_N
from torchid.report.blocks import Block, Figure, Items, Paragraph, Section, Table
from torchid.wording import clean

FINDINGS, ROWS, PANELS, GAPS = 3, 6, 4, 3
"""Choice. Of findings, differences, courses and gaps, so many fit on the first page, shared by the comparisons; all of
them are behind it."""


def summary_section(found: Evaluation, ledger: Ledger) -> Section:
    """The page that can be handed on alone.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    blocks: list[Block] = [_who(found, ledger)]
    for number, one in enumerate(found.identified.comparisons):
        blocks += _compared(found, ledger, number, one)
    blocks += [*_back(found, ledger), *_missing(found, ledger)]
    return Section("summary", "Summary", headline(found, ledger), tuple(blocks))


def _who(found: Evaluation, ledger: Ledger) -> Table:
    rows = []
    for name in found.config.conditions:
        device = found.worn[name].device
        count = [ledger.show(Key("cycle", what, name), 0) for what in ("trials", "cycles")]
        worn = "nothing worn" if device is None else clean(device.name)
        role = " (reference)" if name == found.reference else ""
        rows.append((f"{clean(name)}{role}", worn, count[0], count[1]))
    return Table("", ("Condition", "Device", "Trials", "Cycles"), tuple(rows), text=2)


def _compared(found: Evaluation, ledger: Ledger, number: int, one: Comparison) -> list[Block]:
    own, share = one.found(found.config.evaluate.level), len(found.others)
    order = [k for k in ranked(one) if k in own]
    blocks: list[Block] = []
    if order:
        blocks.append(Items(tuple(finding(found, ledger, one, k) for k in order[: max(1, FINDINGS // share)])))
    elif not one.units.testable:
        blocks.append(Paragraph(ledger.say("test", f"{one.units.reason[0].upper()}{one.units.reason[1:]}.")))
    panels = PANELS // share
    if panels > 1:
        drawing = draw_courses(found, number, shown_courses(found, one, panels), f"s{number}")
        blocks.append(Figure(drawing, f"{clean(one.condition)}. {caption(found, ledger)}" if share > 1 else
                             caption(found, ledger)))  # fmt: skip
    rows = ranked(one)[:ROWS]
    if rows and len(found.others) == 1:
        title = f"Largest differences, {clean(one.condition)} minus {clean(one.reference)}"
        blocks.append(difference_rows(found, ledger, one, rows, title, effects=False))
    return blocks


def shown_courses(found: Evaluation, one: Comparison, panels: int) -> list[int]:
    """Courses for the first page: those of which most was found, the back's compression last.

    Args:
        found: the evaluation.
        one: a comparison.
        panels: how many.
    """
    courses = found.layout.courses
    best: dict[str, float] = {}
    for k in ranked(one):
        best.setdefault(one.columns[k].where, float(one.tested.adjusted[k]))
    torque = [j for j, column in enumerate(courses) if column.where != "L5/S1"]
    torque.sort(key=lambda j: best.get(courses[j].where, math.inf))
    back = [j for j, column in enumerate(courses) if column.measure == "compression_N"]
    return [*torque[: panels - len(back)], *back]


def caption(found: Evaluation, ledger: Ledger) -> str:
    """What the courses show.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    percent = ledger.show(Key("method", "coverage"), 0, 100.0)
    draws = ledger.show(Key("method", "draws"), 0)
    bands = f"Bands: {percent} %, between trials and over {draws} bodies that the recordings allow. "
    return (
        "Mean over the cycle of the torque that the human supplies. "
        f"{bands if found.identified.rows.human_draws is not None else ''}"
        "A bar at the bottom marks where the courses differ, of coordinates with a finding."
    )


def _back(found: Evaluation, ledger: Ledger) -> list[Block]:
    if not found.layout.back:
        return []
    said, above = [], False
    for name in found.config.conditions:
        key = Key("measure", "value", name, "L5/S1", "peak_compression_N")
        low, high = (ledger.show(key._replace(statistic=end), 0) for end in ("low", "high"))
        said.append(f"{ledger.show(key, 0)} N in {clean(name)} ({low} to {high})")
        above = above or ledger.value(key) > NIOSH_N
    limit = ledger.show(Key("method", "limit", where="L5/S1", measure="peak_compression_N"), 0)
    side = "above it in at least one condition" if above else "below it in all conditions"
    return [Paragraph(f"Low back: peak compression at L5/S1 is {', '.join(said)}; NIOSH's limit is {limit} N, {side}.")]


def _missing(found: Evaluation, ledger: Ledger) -> list[Block]:
    some = [ledger.say("gap", f"{gap.what}: {gap.why}.") for gap in found.gaps[:GAPS]]
    return [Paragraph("Not determinable, or taken for granted:"), Items(tuple(some))] if some else []
