"""A condition against the reference over subjects: every subject is one unit, with one difference per measure."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config.study import Study
from torchid.evaluation.statistics.comparing import Comparison, MeasureColumn, Rule, UnitRows, compare_units
from torchid.evaluation.statistics.units import subject_units
from torchid.evaluation.study.subject import SHARES, StudySubject


def compare_condition(
    subjects: Sequence[StudySubject], condition: str, comparisons: int, study: Study, body: str
) -> Comparison:  # fmt: skip
    """Compare a condition with the reference over subjects, with one body.

    Args:
        body: identified or template.
    """
    keys = list(dict.fromkeys((w, m) for one in subjects for _, c, w, m in one.differences if c == condition))
    values = [[_difference(one, body, condition, *key) for key in keys] for one in subjects]
    courses = tuple(dict.fromkeys(column for one in subjects for column in one.courses[condition].columns))
    share = SHARES[0] if body == "identified" else body
    changes = [
        course_of(one, condition, share, courses) - course_of(one, one.reference, share, courses) for one in subjects
    ]
    rows = UnitRows(
        tuple(MeasureColumn(where, measure) for where, measure in keys), torch.tensor(values, dtype=torch.float64),
        None, courses, torch.stack(changes),
    )  # fmt: skip
    rule = Rule(study.level, study.permutations, study.seed, comparisons)
    return compare_units((subjects[0].reference, condition), subject_units(len(subjects)), rows, rule)


def _difference(subject: StudySubject, body: str, condition: str, where: str, measure: str) -> float:
    own = subject.differences.get((body, condition, where, measure))
    return math.nan if own is None else own.value


def course_of(
    subject: StudySubject, condition: str, share: str, courses: Sequence[MeasureColumn]
) -> Float[Tensor, "points courses"]:  # fmt: skip
    """Courses of a subject's condition in a wanted order, NaN where it has none.

    Args:
        share: of ``SHARES``, or ``template``.
    """
    own = subject.courses[condition]
    mean = own.mean[share]
    blank = mean.new_full((len(mean),), torch.nan)
    return torch.stack([mean[:, own.columns.index(c)] if c in own.columns else blank for c in courses], dim=1)
