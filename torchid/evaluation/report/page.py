"""The sections of an evaluation as one page without anything from outside."""

from torchid.evaluation.compared import Compared
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.report.details import device_section, reach_section, values_section
from torchid.evaluation.report.figures import courses_section, draw_courses, marked
from torchid.evaluation.report.method import method_section
from torchid.evaluation.report.tables import differences_section, summary_section
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.torque_shares.draws import SAID
from torchid.report.blocks import Figure, Section, Table
from torchid.report.page import render_page
from torchid.wording import clean, listing

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
