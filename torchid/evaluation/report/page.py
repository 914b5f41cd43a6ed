"""The sections of an evaluation as one page without anything from outside."""

import math
from collections.abc import Sequence

from torchid.cycles.cycles import APART
from torchid.devices import SheetFinding
from torchid.evaluation.compared import Compared
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.gaps import contradicted
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import cycle_names
from torchid.evaluation.report.figures import courses_section, draw_courses, marked
from torchid.evaluation.report.sentences import gap_lines, interval
from torchid.evaluation.report.tables import differences_section, method_section, summary_section
from torchid.evaluation.report.words import digits_of, labelled, where_words
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.torque_shares.draws import SAID
from torchid.report.blocks import Block, Details, Figure, Items, Paragraph, Section, Table
from torchid.report.cause_sentences import chance
from torchid.report.page import render_page
from torchid.wording import clean, listing, segment


def values_section(found: Evaluation, ledger: Ledger) -> Section:
    """Means of all conditions with both bodies."""
    tables: list[Block] = []
    for name in found.config.conditions:
        rows = []
        for column in found.layout.columns:
            key = Key("measure", "value", name, column.where, column.measure)
            if not math.isfinite(ledger.value(key)):
                continue
            digits = digits_of(column.measure, found.per_mass)
            rows.append((
                labelled(column, found.per_mass), ledger.show(key, digits), interval(ledger, key, digits),
                ledger.show(key._replace(statistic="cycles"), 0),
                ledger.show(key._replace(body="template"), digits),
            ))  # fmt: skip
        head = ("Measure", "Mean", "Interval", "Cycles", found.usual.capitalize())
        tables.append(Table(clean(name), head, tuple(rows)))
    said = "Means over trials; torques, powers and works are the human's share."
    return Section("values", "Values of every condition", said, tuple(tables))


def device_section(found: Evaluation, ledger: Ledger) -> Section | None:
    """What the devices do; None where none was worn."""
    blocks: list[Block] = []
    for condition, worn in found.worn.items():
        if worn.device is None:
            continue
        rows = []
        for name in found.layout.names:
            peak = Key("device", "peak", condition, name, "torque_Nm")
            load = Key("device", "load_taken", condition, name, "cumulative_load_Nms")
            rows.append((where_words(name), ledger.show(peak, 1), ledger.show(load, 2)))
        per = "/kg" if found.per_mass else ""
        head = ("Coordinate", f"Device's peak torque [N m{per}]", f"Load taken [N m s{per}]")
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
    """Cycles, contacts, and everything that cannot be said."""
    blocks = (
        Items(gap_lines(ledger, found.gaps)),
        *_corrections(found, ledger),
        _contacts(found, ledger),
        *_apart(found, ledger),
        _cycles(found, ledger),
    )
    return Section("reach", "What cannot be said, and what it rests on",
                   "Nothing was left out for how it looks.", blocks)  # fmt: skip


def _corrections(found: Evaluation, ledger: Ledger) -> list[Block]:
    """Faults that the diagnosis took out of body and recordings before anything was compared."""
    if not found.corrections:
        return []
    said = ("Corrections that the diagnosis made where the body was identified. Trials without a device have those of "
            "markers, too; forces of all trials are as they were read, so that conditions compare alike:")  # fmt: skip
    lines = (f"{one.what} Probability {chance(one.confidence)}." for one in found.corrections)
    return [Paragraph(said), Items(tuple(ledger.say("correction", clean(text, 600)) for text in lines))]


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
    names = [name for name, z in zip(cycle_names(found), found.apart.tolist(), strict=True) if z > APART]
    if not names:
        return []
    said = f"Cycles that stand apart from the others of their condition (modified z above {score}), and are in all "
    return [Paragraph(f"{said}figures: {', '.join(clean(name) for name in names)}.")]


def _cycles(found: Evaluation, ledger: Ledger) -> Block:
    rows = []
    for k, name in enumerate(cycle_names(found)):
        key = Key("cycle", "", found.conditions[k], item=name)
        ends = [ledger.show(key._replace(statistic=end), 2) for end in ("t0", "t1")]
        score = ledger.show(key._replace(statistic="score"), 1)
        rows.append((clean(name), clean(found.conditions[k]), *ends, score))
    head = ("Cycle", "Condition", "From [s]", "To [s]", "Apart (z)")
    return Details("All cycles", (Table("", head, tuple(rows), text=2),))


STYLES = """
#summary table, #differences table { font-size: .76rem; }
#summary th, #summary td, #differences th, #differences td { padding-right: .55rem; }
@media print {
  #summary { break-after: page; font-size: 8.4pt; line-height: 1.3; }
  #summary h2 { display: none; }
  #summary figure { margin-bottom: .5rem; }
  #summary svg { max-height: 8.6cm; }
  #summary p, #summary ul { margin: .3rem 0; }
  #summary table { font-size: 7pt; }
  #differences table { font-size: 6.4pt; }
  #summary th, #summary td, #differences th, #differences td { padding-right: .3rem; }
  #summary figcaption { font-size: 7.6pt; }
  th, td { padding-right: .3rem; }
  #summary .finding { font-size: 9.5pt; margin: .2rem 0 .5rem; }
  .maker { font-size: 7pt; }
  h1 { font-size: 14pt; }
}
"""


def render_compared(found: Compared, sections: list[Section | None]) -> str:
    """Sections as the page of an evaluation or a study; the first fills the first printed page.

    Args:
        sections: in the order in which they are read, None left out.
    """
    title = f"{clean(found.name)}: {listing(list(found.names))}"
    return render_page(title, [section for section in sections if section is not None], styles=STYLES)


def render_evaluation(found: Evaluation, ledger: Ledger) -> str:
    """The page as text.

    Args:
        ledger: of its numbers; remembers what is shown.
    """

    def picture(one: Comparison, panels: int, key: str) -> Figure:
        named = f"{clean(one.condition)}. " if len(found.comparisons) > 1 else ""
        drawing = draw_courses(found, one, shown_courses(one, panels), key)
        return Figure(drawing, f"{named}{_caption(found, ledger)}")

    return render_compared(found, [
        summary_section(found, ledger, _who(found, ledger), picture, (rests_on(found, ledger),)),
        differences_section(found, ledger), values_section(found, ledger), courses_section(found, ledger),
        device_section(found, ledger), reach_section(found, ledger), _method(found, ledger),
    ])  # fmt: skip


def _who(found: Evaluation, ledger: Ledger) -> Table:
    rows = []
    for name in found.names:
        count = [ledger.show(Key("cycle", what, name), 0) for what in ("trials", "cycles")]
        role = " (reference)" if name == found.reference else ""
        rows.append((f"{clean(name)}{role}", clean(next(iter(found.devices(name)), "nothing worn")), *count))
    return Table("", ("Condition", "Device", "Trials", "Cycles"), tuple(rows), text=2)


def shown_courses(one: Comparison, panels: int) -> list[int]:
    """Courses for the first page: those that differ most, the back's compression last."""
    p, points = one.tested.courses.nan_to_num(2.0).tolist(), one.tested.points
    share = (points <= points.nan_to_num(2.0).amin(0) + 1e-9).sum(0).tolist()
    torque = [j for j, column in enumerate(one.courses) if column.measure == "torque_Nm"]
    torque.sort(key=lambda j: (p[j], -share[j]))
    back = [j for j, column in enumerate(one.courses) if column.measure == "compression_N"]
    return [*torque[: panels - len(back)], *back]


def _caption(found: Evaluation, ledger: Ledger) -> str:
    percent, draws = ledger.show(Key("method", "coverage"), 0, 100.0), ledger.show(Key("method", "draws"), 0)
    bands = f" Bands: {percent} %, between trials and over {draws} bodies that the recordings allow."
    drawn = found.identified.rows.human_draws is not None
    return f"Mean torque that the human supplies over the cycle.{bands if drawn else ''}{marked(found, ledger)}"


def rests_on(found: Evaluation, ledger: Ledger) -> str:
    """Corrections of the diagnosis in a sentence; empty where there are none."""
    if not found.corrections:
        return ""
    count, names = ledger.show(Key("method", "corrections"), 0), listing([one.label for one in found.corrections], 7)
    some = "correction" if len(found.corrections) == 1 else "corrections"
    return ledger.say("correction", f"Rests on {count} {some} by the diagnosis: {names}.")


def _method(found: Evaluation, ledger: Ledger) -> Section:
    levers = [ledger.show(Key("method", name, where="L5/S1"), 1, 100.0) for name in ("lever_low", "lever_high")]
    widened = (
        "Intervals are Welch's between trials, of one body: none was drawn."
        if found.identified.rows.draws is None
        else "Intervals are Welch's, widened by what differs over bodies drawn, the same for all conditions; they "
        f"differ in: {SAID}."
    )
    back = (
        "L5/S1: moment between pelvis and trunk in the pelvis' axes; compression of a single equivalent muscle "
        f"(Chaffin & Andersson) with a lever arm of {levers[0]} to {levers[1]} cm; limit of NIOSH (Waters et al. 1993)."
    )
    return method_section(found, ledger, widened, (back,))
