"""The sections of a study as one page without anything from outside."""

from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.report.figures import courses_section
from torchid.evaluation.report.method import method_section
from torchid.evaluation.report.page import render_compared
from torchid.evaluation.report.sentences import interval
from torchid.evaluation.report.tables import differences_section, summary_section
from torchid.evaluation.report.words import where_words
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.study.numbers import taken
from torchid.evaluation.study.report.details import device_section, reach_section, subjects_section
from torchid.evaluation.study.report.figures import draw_subjects
from torchid.evaluation.study.study import Pooled
from torchid.report.blocks import Figure, Table
from torchid.wording import clean, listing

SHARES = 4
"""Choice. Of the device's shares, so many fit on the first page, shared by the comparisons."""


def render_study(found: Pooled, ledger: Ledger) -> str:
    """The page as text.

    Args:
        ledger: of its numbers; remembers what is shown.
    """

    def picture(one: Comparison, panels: int, key: str) -> Figure | None:
        order = one.ranked()[:panels]
        title = f"{clean(one.condition)} minus {clean(one.reference)}, every subject a row."
        return Figure(draw_subjects(found, one, order, key), title) if order else None

    return render_compared(found, [
        summary_section(found, ledger, _who(found, ledger), picture, _shares(found, ledger)),
        differences_section(found, ledger), subjects_section(found, ledger), courses_section(found, ledger),
        device_section(found, ledger), reach_section(found, ledger),
        method_section(found, ledger, "Intervals are Student's over subjects."),
    ])  # fmt: skip


def _who(found: Pooled, ledger: Ledger) -> Table:
    rows = []
    for condition in found.names:
        worn = list(dict.fromkeys(one.devices[condition] or "nothing worn" for one in found.having(condition)))
        role = " (reference)" if condition == found.reference else ""
        count = ledger.show(Key("test", "recorded", condition), 0)
        rows.append((f"{clean(condition)}{role}", listing(worn, 3), count))
    return Table("", ("Condition", "Device", "Subjects"), tuple(rows), text=2)


def _shares(found: Pooled, ledger: Ledger) -> list[str]:
    """What the device takes of the coordinates on which it acts most."""
    lines: list[str] = []
    for one in found.comparisons:
        said = []
        sizes = {where: abs(ledger.value(_taken(one, where))) for where in taken(found, one)[0]}
        largest = sorted((w for w in sizes if sizes[w] >= 0.005), key=lambda w: -sizes[w])
        for where in largest[: SHARES // len(found.comparisons)]:
            key = _taken(one, where)
            said.append(f"{where_words(where)} {ledger.show(key, 0, 100.0)} % ({interval(ledger, key, 0, 100.0)})")
        if said:
            what = f"Part of the load that the device takes in {clean(one.condition)}, the rest is the human's"
            lines.append(f"{what}: {'; '.join(said)}.")
    return lines


def _taken(one: Comparison, where: str) -> Key:
    return Key("device", "value", one.condition, where, "load_taken")
