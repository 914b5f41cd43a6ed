"""The sequence of a study: every subject's evaluation, what they have in common, the comparisons, the files."""

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config, Study, load_config
from torchid.errors import ConfigError, DataError, TorchidError, said_of_defect
from torchid.evaluation.compared import Gap
from torchid.evaluation.evaluate import evaluate
from torchid.evaluation.gaps import untested
from torchid.evaluation.ledger import BODIES
from torchid.evaluation.statistics.comparing import Comparison, MeasureColumn, Rule, UnitRows, compare_units
from torchid.evaluation.statistics.effects import Estimate, mean_of
from torchid.evaluation.statistics.units import subject_units
from torchid.evaluation.study.subject import SHARES, StudySubject, read_subject
from torchid.session.fitting import OnStage
from torchid.wording import listing


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


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Pooled:
    """Everything that a study knows."""

    study: Study
    subjects: tuple[StudySubject, ...]
    answers: dict[str, tuple[Comparison, ...]]
    """By body."""
    gaps: tuple[Gap, ...]
    """Who and what was left out, and what cannot be said."""

    @property
    def reference(self) -> str:
        """Condition that the others are compared with."""
        return self.subjects[0].reference

    @property
    def name(self) -> str:
        """Of the study."""
        return self.study.name

    @property
    def level(self) -> float:
        """Family-wise rate of false findings."""
        return self.study.level

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """With the identified bodies."""
        return self.answers["identified"]

    @property
    def template(self) -> tuple[Comparison, ...]:
        """With the scaled templates, or the models as shipped."""
        return self.answers["template"]

    @property
    def signs(self) -> str:
        """Whose names and signs coordinates have (``Evaluation.signs``)."""
        return self.subjects[0].signs

    @property
    def names(self) -> tuple[str, ...]:
        """The reference and what is compared with it."""
        return (self.reference, *(one.condition for one in self.comparisons))

    @property
    def per_mass(self) -> bool:
        """Whether torques are divided by mass."""
        return self.subjects[0].per_mass

    @property
    def usual(self) -> str:
        """What the identified bodies are held against: scaled templates, or the subjects' own models as shipped."""
        return " or ".join(dict.fromkeys(one.usual for one in self.subjects))

    def having(self, condition: str) -> tuple[StudySubject, ...]:
        """Subjects that were recorded under a condition."""
        return tuple(one for one in self.subjects if condition in one.conditions)

    def devices(self, condition: str) -> tuple[str, ...]:
        """Names of what was worn; none where nobody wore anything."""
        worn = (one.devices[condition] for one in self.having(condition))
        return tuple(dict.fromkeys(name for name in worn if name is not None))

    def course(self, one: Comparison, condition: str, share: str) -> Estimate:
        """Mean courses over the subjects of a comparison with their band, flattened to points times courses.

        Args:
            condition: its own or the reference.
            share: of ``SHARES``, or ``template``.
        """
        each = [course_of(subject, condition, share, one.courses) for subject in self.having(one.condition)]
        return mean_of(torch.stack(each).flatten(1), None)


def subjects_of(
    study: Study, progress: OnStage, make: Callable[[Config, OnStage], object] = evaluate
) -> tuple[tuple[StudySubject, ...], tuple[Gap, ...]]:
    """The subjects of a study, evaluated where it lists their configs, and why others cannot be evaluated.

    One subject's fault, or a defect that shows in one, leaves the others what they are.

    Args:
        study: whom to read.
        progress: called with stages and the share of each that is done.

    Raises:
        ConfigError: ``study.twice`` where two subjects have one folder or one name; a config is at fault, which is said
            before any work.
        InputError: ``study.subject`` where a folder has no evaluation.
    """
    configs = [None if one.config is None else load_config(one.config, one.set) for one in study.subjects]
    folders = [one.out if own is None else own.out for one, own in zip(study.subjects, configs, strict=True)]
    _refuse_twice([str(folder) for folder in folders], "folder")
    finished = {one.out: read_subject(one.out) for one in study.subjects if one.out is not None}
    _refuse_twice([own.subject.name for own in configs if own] + [one.name for one in finished.values()], "name")
    found, refused = [], []
    for k, (folder, config) in enumerate(zip(folders, configs, strict=True), 1):
        assert isinstance(folder, Path)
        if config is None:
            found.append(finished[folder])
            continue
        try:
            make(config, _named(progress, config.subject.name))
            found.append(read_subject(folder))
        except Exception as error:  # hours of the others' work are not lost for it
            refused.append(_left_out(config.subject.name, k, error))
    return tuple(found), tuple(refused)


def _left_out(name: str, k: int, error: Exception) -> Gap:
    known = isinstance(error, TorchidError)
    why = f"left out: {error}" if known else f"left out by a defect of torchid: {said_of_defect(error)}"
    log.warning("subject %d of the study is %s", k, why)
    log.debug("subject %d of the study", k, exc_info=error)
    return Gap(f"subject {name}", why)


def _named(progress: OnStage, name: str) -> OnStage:
    return lambda stage, fraction: progress(f"{name}: {stage}", fraction)


def _refuse_twice(keys: Sequence[str], what: str) -> None:
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise ConfigError(
            "study.twice", f"two subjects of the study have one {what}", place="subjects", found=listing(twice),
            remedy="Give each its own: set: [subject.name=..., out=...]",
        )  # fmt: skip


def pool(study: Study, subjects: Sequence[StudySubject], refused: Sequence[Gap] = ()) -> Pooled:
    """Test all conditions over the subjects that have them.

    Args:
        subjects: at least two with a condition in common, else there is nothing to test.
        refused: who was left out already.

    Raises:
        ConfigError: ``study.differs`` where their evaluations were asked for different things.
        DataError: ``study.nothing`` where no condition has two subjects.
    """
    _refuse_differing(subjects)
    reference = subjects[0].reference if subjects else ""
    every = dict.fromkeys(c for one in subjects for c in one.conditions if c != reference)
    having = {c: [one for one in subjects if c in one.conditions] for c in every}
    compared = [c for c in every if len(having[c]) >= 2]
    if not compared:
        had = [f"{one.name}: {', '.join(one.conditions)}"[:200] for one in subjects]
        mend = "Mend what left subjects out; else n" if refused else "N"
        raise DataError(
            "study.nothing", "no condition was recorded with two subjects or more", source=study.name,
            found="; ".join((*(f"{gap.what} {gap.why}"[:200] for gap in refused), *had)) or "no subject",
            remedy=f"{mend}ame the same conditions alike in the subjects' configs, or add subjects",
        )  # fmt: skip
    answers = {
        body: tuple(compare_condition(having[c], c, len(compared), study, body) for c in compared) for body in BODIES
    }
    limits = (gap for one in answers["identified"] for gap in _limits(one, having[one.condition]))
    return Pooled(study, tuple(subjects), answers, (*refused, *_lacking(subjects, having), *limits))


def _refuse_differing(subjects: Sequence[StudySubject]) -> None:
    asked: dict[str, Callable[[StudySubject], object]] = {
        "reference": lambda one: one.reference,
        "evaluate.convention or model": lambda one: one.signs,
        "evaluate.per_mass": lambda one: one.per_mass,
        "evaluate.points": lambda one: len(one.courses[one.reference].mean[SHARES[0]]),
    }
    for what, of in asked.items():
        said = {one.name: of(one) for one in subjects}
        if len(set(said.values())) > 1:
            raise ConfigError(
                "study.differs", f"subjects differ in {what}", place="subjects",
                found=", ".join(f"{name}: {value}" for name, value in said.items())[:300],
                remedy="Evaluate all of them with the same choice",
            )  # fmt: skip


def _lacking(subjects: Sequence[StudySubject], having: dict[str, list[StudySubject]]) -> Iterator[Gap]:
    """Conditions that subjects lack, and devices that are not the same."""
    for condition, own in having.items():
        without = [one.name for one in subjects if one not in own]
        if len(own) < 2:
            yield Gap(condition, f"not compared: {own[0].name} alone was recorded under it")
        elif without:
            yield Gap(f"{condition} of {listing(without)}", "left out of this comparison: no such condition")
        worn = {one.name: one.devices[condition] or "nothing" for one in own}
        if len(set(worn.values())) > 1:
            said = "; ".join(f"{name}: {device}" for name, device in worn.items())
            yield Gap(f"one device in {condition}", f"subjects wore different ones ({said})")


def _limits(one: Comparison, subjects: Sequence[StudySubject]) -> Iterator[Gap]:
    """Measures that subjects lack, and too few subjects or permutations."""
    yield from untested(one)
    what, known = f"{one.condition} against {one.reference}", one.rows.values.isfinite()
    lacking: dict[str, list[str]] = {}
    for k, column in enumerate(one.columns):
        without = [s.name for s, has in zip(subjects, known[:, k].tolist(), strict=True) if not has]
        if without:
            lacking.setdefault(listing(without), []).append(f"{column.measure} of {column.where}")
    for names, measures in lacking.items():
        yield Gap(f"{listing(measures, 4)}, {what}", f"without {names}, who have no such value")
