"""The sections of a study as one page without anything from outside."""

from torchid.evaluation.ledger import Ledger
from torchid.evaluation.report.page import STYLES
from torchid.evaluation.study.report.details import (
    courses_section,
    device_section,
    differences_section,
    method_section,
    reach_section,
    subjects_section,
)
from torchid.evaluation.study.report.summary import summary_section
from torchid.evaluation.study.study import Pooled
from torchid.report.page import render_page
from torchid.wording import clean, listing


def render_study(found: Pooled, ledger: Ledger) -> str:
    """The page as text; its first section fills the first printed page.

    Args:
        found: the study.
        ledger: of its numbers; remembers what is shown.
    """
    title = f"{clean(found.study.name)}: {listing(list(found.conditions))}"
    every = [
        summary_section(found, ledger), differences_section(found, ledger), subjects_section(found, ledger),
        courses_section(found, ledger), device_section(found, ledger), reach_section(found, ledger),
        method_section(found, ledger),
    ]  # fmt: skip
    return render_page(title, [section for section in every if section is not None], styles=STYLES)
