"""The first page: who, whether it helps, what was found, the back, what it rests on, and what cannot be said."""

from collections.abc import Callable, Sequence

from torchid.evaluation.compared import Compared
from torchid.evaluation.ledger import Ledger
from torchid.evaluation.report.sentences import back_line, finding, gap_lines, headline
from torchid.evaluation.report.tables import difference_rows
from torchid.evaluation.statistics.comparing import Comparison
from torchid.report.blocks import Block, Figure, Items, Paragraph, Section, Table
from torchid.wording import clean

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
        found: the evaluation or the study.
        ledger: of its numbers.
        who: what was recorded.
        picture: of a comparison.
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
