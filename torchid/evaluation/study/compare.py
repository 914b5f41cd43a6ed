"""A condition against the reference over subjects: paired differences, signs flipped.

Every subject is one unit: its difference between condition and reference is one number per measure. Under the null
hypothesis its sign is as likely either way (Nichols & Holmes 2002, Hum Brain Mapp 15:1); the step-down maximum over all
measures adjusts the p-values as it does for one subject, and the number of conditions multiplies them. Courses are
tested point by point against the maximum over all points, for coordinates of which a measure was found.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config.study import Study
from torchid.evaluation.ledger import BODIES
from torchid.evaluation.statistics.arrangements import flip
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.evaluation.statistics.effects import Estimate, hedges_paired, mean_of
from torchid.evaluation.statistics.permutation import Tested, same_sized_p, sign_means, step_down
from torchid.evaluation.study.subject import SHARES, StudySubject


@dataclass(frozen=True)
class StudyAnswer:
    """What one body says of a condition over subjects."""

    values: Float[Tensor, "subjects columns"]
    """Differences of the subjects, NaN where one has none."""
    difference: Estimate
    effect: Estimate
    """Hedges' g of paired differences."""
    tested: Tested
    """p-values NaN where nothing can be tested."""

    def found(self, level: float) -> list[int]:
        """Columns whose difference is a finding at a family-wise level."""
        return [k for k, p in enumerate(self.tested.adjusted.tolist()) if p <= level]

    @property
    def agreeing(self) -> list[tuple[int, int]]:
        """Of each column, how many subjects change as their mean does, and how many have a value."""
        same = self.values * self.difference.value > 0.0
        known = torch.isfinite(self.values)
        return list(zip(same.sum(0).tolist(), known.sum(0).tolist(), strict=True))


@dataclass(frozen=True)
class SubjectsComparison:
    """One condition against the reference, over the subjects that have both."""

    reference: str
    condition: str
    subjects: tuple[StudySubject, ...]
    columns: tuple[MeasureColumn, ...]
    answers: dict[str, StudyAnswer]
    """By body."""
    least_p: float
    """Least p-value that so many subjects and permutations give, before the number of conditions multiplies it."""
    testable: bool
    """Whether so small a p-value, multiplied by that number, would be a finding."""
    wanted: int
    """Subjects from which on a finding is possible, with permutations enough."""
    permutations: int
    """At most so many ways of flipping signs are tried."""
    wanted_permutations: int
    """Permutations from which on a finding is possible, with subjects enough."""
    courses: tuple[MeasureColumn, ...]
    differing: Float[Tensor, "points courses"]
    """Adjusted p-values of the courses of which a measure was found; NaN for the others."""

    @property
    def needs(self) -> tuple[bool, bool]:
        """Whether more subjects and whether more permutations are needed for any finding."""
        short = not self.testable
        return short and len(self.subjects) < self.wanted, short and self.permutations < self.wanted_permutations


def least_subjects(level: float, comparisons: int) -> int:
    """Subjects from which on flipped signs can reach a level: 2^(1 - n) times the comparisons is no larger.

    Args:
        level: family-wise.
        comparisons: conditions that are compared with the reference.
    """
    return 1 + math.ceil(math.log2(comparisons / level) - 1e-9)


def least_permutations(level: float, comparisons: int) -> int:
    """Randomly drawn signs from which on they can reach a level: the comparisons over their number are no larger.

    Args:
        level: family-wise.
        comparisons: conditions that are compared with the reference.
    """
    return math.ceil(comparisons / level - 1e-9)


def compare_condition(
    subjects: Sequence[StudySubject], condition: str, comparisons: int, study: Study
) -> SubjectsComparison:  # fmt: skip
    """Compare a condition with the reference over subjects, with both bodies.

    Args:
        subjects: those that have it.
        condition: its name.
        comparisons: number of conditions that are compared.
        study: level, permutations and seed.
    """
    keys = list(dict.fromkeys((w, m) for one in subjects for _, c, w, m in one.differences if c == condition))
    columns = tuple(MeasureColumn(where, measure) for where, measure in keys)
    signs = flip(len(subjects), study.permutations, study.seed)
    complete = len(signs) == 2 ** len(subjects)
    least_p = (2 if complete else 1) / len(signs)
    testable = least_p * comparisons <= study.level
    answers = {}
    for body in BODIES:
        rows = [[_difference(one, body, condition, *key) for key in keys] for one in subjects]
        answers[body] = _answer(torch.tensor(rows, dtype=torch.float64), signs, comparisons, study.level, testable)
    courses = tuple(dict.fromkeys(column for one in subjects for column in one.courses[condition].columns))
    found = {columns[k].where for k in answers["identified"].found(study.level)}
    changes = torch.stack([_changes(one, condition, courses) for one in subjects])
    differing = _course_p(changes, [c.where in found for c in courses], signs)
    return SubjectsComparison(
        subjects[0].reference, condition, tuple(subjects), columns, answers, least_p, testable,
        least_subjects(study.level, comparisons), study.permutations, least_permutations(study.level, comparisons),
        courses, differing,
    )  # fmt: skip


def _difference(subject: StudySubject, body: str, condition: str, where: str, measure: str) -> float:
    own = subject.differences.get((body, condition, where, measure))
    return math.nan if own is None else own.value


def _answer(values: Tensor, signs: Tensor, comparisons: int, level: float, testable: bool) -> StudyAnswer:
    statistics = sign_means(values, signs)
    if not testable:
        statistics = torch.zeros_like(statistics)
    enough = torch.isfinite(values).sum(0) >= 2
    tested = step_down(torch.where(enough, statistics, 0.0), level)
    tested = replace(tested, adjusted=(tested.adjusted * comparisons).clamp(max=1.0))
    return StudyAnswer(values, mean_of(values, None), hedges_paired(values), tested)


def course_of(
    subject: StudySubject, condition: str, share: str, courses: Sequence[MeasureColumn]
) -> Float[Tensor, "points courses"]:  # fmt: skip
    """Courses of a subject's condition in a wanted order, NaN where it has none.

    Args:
        subject: who.
        condition: its name.
        share: of ``SHARES``, or ``template``.
        courses: wanted columns.
    """
    own = subject.courses[condition]
    mean = own.mean[share]
    blank = mean.new_full((len(mean),), torch.nan)
    return torch.stack([mean[:, own.columns.index(c)] if c in own.columns else blank for c in courses], dim=1)


def _changes(
    subject: StudySubject, condition: str, courses: Sequence[MeasureColumn]
) -> Float[Tensor, "points courses"]:
    first, second = (course_of(subject, name, SHARES[0], courses) for name in (subject.reference, condition))
    return second - first


def _course_p(
    changes: Float[Tensor, "subjects points courses"], wanted: Sequence[bool], signs: Tensor
) -> Float[Tensor, "points courses"]:
    found = changes.new_full(changes.shape[1:], torch.nan)
    if any(wanted):
        own = torch.tensor(wanted)
        asked = changes[..., own].flatten(1)
        statistics = torch.where(torch.isfinite(asked).sum(0) >= 2, sign_means(asked, signs), 0.0)
        p = torch.where(statistics[0] != 0.0, same_sized_p(statistics), torch.nan)
        found[:, own] = p.reshape(len(found), -1)
    return found
