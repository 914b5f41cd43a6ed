"""Files of a comparison of groups, into the cohort's folder."""

from torchid.config.groups import GroupQuestion
from torchid.evaluation.groups.groups import GroupComparison, compare_groups
from torchid.evaluation.groups.reading import refuse_no_cohort
from torchid.evaluation.groups.report import groups_table, render_groups
from torchid.storage.files import write_text
from torchid.storage.results import OutputFolder
from torchid.storage.tables import write_table

NAME = "groups"
"""Of the page's and the table's files."""


def evaluate_groups(question: GroupQuestion) -> GroupComparison:
    """Compare the groups of a cohort, and write ``groups.html`` and ``groups.csv`` into its folder.

    Args:
        question: cohort, reference, level.

    Raises:
        TorchidError: as of ``compare_groups``; ``results.*`` where the folder cannot be written.
    """
    refuse_no_cohort(question.cohort)
    with OutputFolder(question.cohort, beside=True) as folder:
        folder.claim((f"{NAME}.html", f"{NAME}.csv"))
        found = compare_groups(question)
        write_table(groups_table(found), NAME, (), folder.path)
        write_text(folder.path(f"{NAME}.html"), render_groups(found))
    return found
