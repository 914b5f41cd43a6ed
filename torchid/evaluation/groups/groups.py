"""Each group of a cohort against the reference, with people as the units that are exchanged."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.config.groups import GroupQuestion
from torchid.errors import ConfigError
from torchid.evaluation.compared import Gap
from torchid.evaluation.gaps import untested
from torchid.evaluation.groups.reading import WalkingGroups, counts_of, read_groups
from torchid.evaluation.statistics.comparing import Comparison, Rule, UnitRows, compare_units
from torchid.evaluation.statistics.effects import Estimate, mean_of
from torchid.evaluation.statistics.units import Units


@dataclass(frozen=True)
class GroupComparison:
    """Groups of a cohort compared."""

    question: GroupQuestion
    """What was asked."""
    walking: WalkingGroups
    """The people."""
    reference: str
    """Group that the others are compared with."""
    comparisons: tuple[Comparison, ...]
    """One for each other group."""
    gaps: tuple[Gap, ...]
    """Who was left out, and what cannot be said."""

    def course(self, group: str) -> Estimate:
        """Return the mean courses of a group with their band, flattened to points times courses.

        Args:
            group: its name.
        """
        return mean_of(self.walking.curves[_of(self.walking, (group,))].flatten(1), None)


def compare_groups(question: GroupQuestion) -> GroupComparison:
    """Return each group of a cohort against the reference.

    Args:
        question: cohort, reference, level.

    Raises:
        ConfigError: ``groups.reference`` where no such group is there, ``groups.one`` where there is one alone.
        InputError: as of ``read_groups``.
    """
    walking = read_groups(question.cohort)
    names = tuple(dict.fromkeys(walking.groups))
    reference = question.reference or names[0]
    place = str(question.cohort)
    if reference not in names:
        raise ConfigError(
            "groups.reference", "nobody is in this group", place=place, found=reference,
            remedy=f"Give one of these: {counts_of(walking.groups)}",
        )  # fmt: skip
    others = [name for name in names if name != reference]
    if not others:
        raise ConfigError(
            "groups.one", "everybody is in one group", place=place, found=counts_of(walking.groups),
            remedy="Give the others of the cohort's table another name in the column `group`",
        )  # fmt: skip
    comparisons = tuple(_compared(walking, reference, name, question, len(others)) for name in others)
    gaps = (*walking.left_out, *(gap for one in comparisons for gap in untested(one)))
    return GroupComparison(question, walking, reference, comparisons, gaps)


def _compared(walking: WalkingGroups, reference: str, name: str, question: GroupQuestion, others: int) -> Comparison:
    own = _of(walking, (reference, name))
    second = torch.tensor([walking.groups[k] == name for k in own])
    rows = UnitRows(walking.columns, walking.values[own], None, walking.courses, walking.curves[own])
    rule = Rule(question.level, question.permutations, question.seed, others)
    return compare_units((reference, name), Units("people", tuple(range(len(own))), second), rows, rule)


def _of(walking: WalkingGroups, groups: Sequence[str]) -> list[int]:
    return [k for k, name in enumerate(walking.groups) if name in groups]
