"""The first page of a report, tables of differences with the scaled template's beside them, and what the method was."""

from collections.abc import Callable, Sequence

from torchid.evaluation.compared import Compared
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.report.sentences import back_line, difference_key, finding, gap_lines, headline, interval
from torchid.evaluation.report.words import digits_of, headed, labelled
from torchid.evaluation.statistics.comparing import Comparison
from torchid.report.blocks import Block, Figure, Items, Paragraph, Section, Table
from torchid.wording import clean


def difference_rows(
    found: Compared, ledger: Ledger, one: Comparison, columns: Sequence[int], title: str, effects: bool = True
) -> Table:  # fmt: skip
    """Table of differences, findings in bold.

    Args:
        effects: whether all of standardised effects is shown.
    """
    rows = [_row(found, ledger, one, k, effects) for k in columns]
    head = (
        "Measure", *(() if one.units.paired else ("Reference", "Condition")), "Difference", "Interval",
        *(("Agree",) if one.units.paired else ()), "Adj. p", "Template", "Adj. p",
        *(("Hedges' g",) if effects or one.units.paired else ()),
        *(("Interval",) if effects and one.units.paired else ()),
    )  # fmt: skip
    own = set(one.found(found.level))
    strong = frozenset(k for k, column in enumerate(columns) if column in own)
    return Table(title, headed(head, found.usual), tuple(rows), strong=strong)


def _row(found: Compared, ledger: Ledger, one: Comparison, k: int, effects: bool) -> tuple[str, ...]:
    column, digits = one.columns[k], digits_of(one.columns[k].measure, found.per_mass)
    key, plain = (difference_key(one, column, "value", body) for body in ("identified", "template"))

    def show(name: str, decimals: int, of: Key = key) -> str:
        return ledger.show(of._replace(statistic=name), decimals)

    first, agree, g = [], [], [show("g", 2)]
    if one.units.paired:
        agree = [f"{show('agree', 0)} of {show('subjects', 0)}"]
        g += [f"{show('g_low', 2)} to {show('g_high', 2)}"] if effects else []
    else:
        first = [ledger.show(Key("measure", "value", name, column.where, column.measure), digits)
                 for name in (one.reference, one.condition)]  # fmt: skip
        g = g if effects else []
    return (
        labelled(column, found.per_mass), *first, show("value", digits), interval(ledger, key, digits), *agree,
        show("p_adjusted", 3), show("value", digits, plain), show("p_adjusted", 3, plain), *g,
    )  # fmt: skip


def differences_section(found: Compared, ledger: Ledger) -> Section:
    """All differences."""
    blocks: list[Block] = [
        difference_rows(found, ledger, one, one.ranked(), f"{clean(one.condition)} minus {clean(one.reference)}")
        for one in found.comparisons
    ]
    percent = ledger.show(Key("method", "coverage"), 0, 100.0)
    pairs = any(one.units.paired for one in found.comparisons)
    over = (
        "Mean over subjects of each one's own difference. Agree: subjects that change as the mean does. "
        if pairs
        else ""
    )
    tested = "p-values are adjusted for all measures, courses and conditions. Rows in bold are findings."
    if not any(one.testable for one in found.comparisons):
        tested = "Nothing could be tested."
    said = f"{over}Intervals are {percent} % each. {tested}"
    return Section("differences", "All differences", said, tuple(blocks))


FINDINGS, ROWS, PANELS, GAPS = 3, 6, 4, 3
"""Choice. Of findings, differences, panels and gaps, so many fit on the first page, shared by the comparisons; all of
them are behind it."""
Picture = Callable[[Comparison, int, str], Figure | None]
"""Of a comparison, so many panels, with a prefix of the drawing's ids."""


def summary_section(
    found: Compared, ledger: Ledger, who: Table, picture: Picture, more: Sequence[str] = ()
) -> Section:  # fmt: skip
    """The page that can be handed on alone.

    Args:
        more: sentences, an empty one left out.
    """
    first, share = headline(found, ledger), len(found.comparisons)
    blocks: list[Block] = [who]
    for number, one in enumerate(found.comparisons):
        order = one.ranked()
        own = [k for k in order if k in one.found(found.level)][: max(1, FINDINGS // share)]
        blocks += [Items(tuple(finding(found, ledger, one, k) for k in own))] if own else []
        drawn = picture(one, PANELS // share, f"s{number}") if PANELS // share > 1 else None
        blocks += [drawn] if drawn is not None else []
        if share == 1:
            title = f"Largest differences, {clean(one.condition)} minus {clean(one.reference)}"
            blocks.append(difference_rows(found, ledger, one, order[:ROWS], title, effects=False))
    blocks += [Paragraph(text) for text in (*more, back_line(found, ledger)) if text]
    some = gap_lines(ledger, found.gaps[: max(1, GAPS // share)])
    blocks += [Paragraph("Not determinable, or left out:"), Items(some)] if some else []
    return Section("summary", "Summary", first, tuple(blocks))


SIGNS = {
    "torchid": "flexion, adduction, internal rotation, dorsiflexion and inversion are positive (signs of ISB)",
    "isb": "names and signs of ISB: flexion, adduction, internal rotation, dorsiflexion and inversion are positive",
    "opensim": "names and signs of OpenSim (Rajagopal et al. 2016): lumbar extension is positive",
    "file_torchid": "names and signs of the model's own file",
    "file_opensim": "names and signs of the model's own file",
    "file_isb": "names and signs of ISB where the file's coordinate turns about the same axis, else the file's own",
}
"""By ``Evaluation.signs``."""
BODIES = {
    "scaled template": "The scaled template has tabulated inertia and lengths scaled to the markers.",
    "model as shipped": "The model as shipped has the joints and the inertia of its file, and the same markers placed "
    "on it anew.",
}
"""What is held beside the identified body, by ``Evaluation.usual``."""
ADJUSTED = (
    "p-values are adjusted by the step-down maximum over all measures and all courses (Westfall & Young 1993), and by "
    "the number of comparisons."
)
HUMAN = (
    "Human torque: inverse dynamics of the identified body and of the parts that it carries, minus the plates, minus "
    "the device's generalised force."
)


def method_section(found: Compared, ledger: Ledger, intervals: str, more: Sequence[str] = ()) -> Section:
    """The chapter on method.

    Args:
        intervals: what they hold.
        more: items behind those that one subject and a study have alike.
    """
    paired = any(one.units.paired for one in found.comparisons)
    effect = (
        "Effect size: Hedges' g of paired differences, their mean over their standard deviation; interval of the "
        "non-central t distribution (Cumming & Finch 2001)."
        if paired else "Effect size: Hedges' g, the difference over the pooled standard deviation between units."
    )  # fmt: skip
    items = [
        f"{HUMAN}{' Every subject was evaluated alone, and is one unit here.' if paired else ''}",
        *(BODIES[one] for one in found.usual.split(" or ")),
        f"Coordinates: {SIGNS[found.signs]}.",
        *(_test(ledger, one) for one in found.comparisons),
        *([ADJUSTED] if any(one.testable for one in found.comparisons) else []),
        intervals, effect, *more,
    ]  # fmt: skip
    mass = Key("method", "mass")
    said = f"Torques are divided by {ledger.show(mass, 1)} kg. " if ledger.has(mass) else ""
    return Section(
        "method", "Method", f"{said}Equations and limits: docs/evaluate.md of torchid.", (Items(tuple(items)),)
    )


def _test(ledger: Ledger, one: Comparison) -> str:
    first, second = (ledger.show(Key("test", name, one.condition), 0) for name in ("units_reference", "units"))
    least = ledger.show(Key("test", "least_p", one.condition), 4)
    what = "blocks of cycles" if one.units.kind == "blocks" else one.units.kind
    done = (f"signs of {second} subjects' differences were flipped (Nichols & Holmes 2002)" if one.units.paired
            else f"{first} {what} of the reference against {second} were exchanged")  # fmt: skip
    return f"{clean(one.condition)}: {done}; no p-value can be below {least}."
