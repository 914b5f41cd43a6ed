"""The sections of an evaluation as one page without anything from outside."""

from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import Ledger
from torchid.evaluation.report.details import (
    courses_section,
    device_section,
    differences_section,
    reach_section,
    values_section,
)
from torchid.evaluation.report.method import method_section
from torchid.evaluation.report.summary import summary_section
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


def render_evaluation(found: Evaluation, ledger: Ledger) -> str:
    """The page as text; its first section fills the first printed page.

    Args:
        found: the evaluation.
        ledger: of its numbers; remembers what is shown.
    """
    title = f"{clean(found.config.subject.name)}: {listing(list(found.config.conditions))}"
    every = [
        summary_section(found, ledger), differences_section(found, ledger), values_section(found, ledger),
        courses_section(found, ledger), device_section(found, ledger), reach_section(found, ledger),
        method_section(found, ledger),
    ]  # fmt: skip
    return render_page(title, [section for section in every if section is not None], styles=STYLES)
