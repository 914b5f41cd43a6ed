"""The sequence of a study: every subject's evaluation, what they have in common, the comparisons, the files."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from torchid.config import Config, Study, load_config
from torchid.errors import ConfigError, DataError
from torchid.evaluation.evaluate import evaluate
from torchid.evaluation.evaluation import Gap
from torchid.evaluation.study.compare import SubjectsComparison, compare_condition
from torchid.evaluation.study.subject import SHARES, StudySubject, read_subject
from torchid.session.fitting import OnStage
from torchid.wording import listing


@dataclass(frozen=True)
class Pooled:
    """Everything that a study knows."""

    study: Study
    subjects: tuple[StudySubject, ...]
    comparisons: tuple[SubjectsComparison, ...]
    gaps: tuple[Gap, ...]
    """Who and what was left out, and what cannot be said."""

    @property
    def reference(self) -> str:
        """Condition that the others are compared with."""
        return self.subjects[0].reference

    @property
    def conditions(self) -> tuple[str, ...]:
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
        """Subjects that were recorded under a condition.

        Args:
            condition: its name.
        """
        return tuple(one for one in self.subjects if condition in one.conditions)


def subjects_of(
    study: Study, progress: OnStage, make: Callable[[Config, OnStage], object] = evaluate
) -> tuple[tuple[StudySubject, ...], tuple[Gap, ...]]:
    """The subjects of a study, evaluated where it lists their configs, and those whose data support no evaluation.

    Args:
        study: whom to read.
        progress: called with stages and the share of each that is done.
        make: evaluates a config.

    Raises:
        ConfigError: ``study.twice`` where two subjects have one folder or one name; a config is at fault.
        InputError: ``study.subject`` where a folder has no evaluation.
    """
    configs = [None if one.config is None else load_config(one.config, one.set) for one in study.subjects]
    folders = [one.out if own is None else own.out for one, own in zip(study.subjects, configs, strict=True)]
    _refuse_twice([str(folder) for folder in folders], "folder")
    finished = {one.out: read_subject(one.out) for one in study.subjects if one.out is not None}
    _refuse_twice([own.subject.name for own in configs if own] + [one.name for one in finished.values()], "name")
    found, refused = [], []
    for folder, config in zip(folders, configs, strict=True):
        assert isinstance(folder, Path)
        if config is None:
            found.append(finished[folder])
            continue
        try:
            make(config, _named(progress, config.subject.name))
        except DataError as error:
            refused.append(Gap(f"subject {config.subject.name}", f"left out: {error.message} [{error.code}]"))
            continue
        found.append(read_subject(folder))
    return tuple(found), tuple(refused)


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
        study: level, permutations and seed.
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
    comparisons = tuple(compare_condition(having[c], c, len(compared), study) for c in compared)
    gaps = (*refused, *_lacking(subjects, having), *(gap for one in comparisons for gap in _limits(one, study.level)))
    return Pooled(study, tuple(subjects), comparisons, gaps)


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


def _limits(one: SubjectsComparison, level: float) -> Iterator[Gap]:
    """Measures that subjects lack, and too few subjects or permutations."""
    what = f"{one.condition} against {one.reference}"
    if not one.testable:
        least = (f"{one.wanted} subjects", f"permutations: {one.wanted_permutations}")
        needed = listing([words for words, short in zip(least, one.needs, strict=True) if short])
        yield Gap(
            f"whether {what} differs",
            f"{len(one.subjects)} subjects with permutations: {one.permutations} cannot show anything at a level of "
            f"{level:g}: no p-value of flipped signs is below {one.least_p:g}; {needed} are the least that can",
        )
    known = one.answers["identified"].values.isfinite()
    lacking: dict[str, list[str]] = {}
    for k, column in enumerate(one.columns):
        without = [s.name for s, has in zip(one.subjects, known[:, k].tolist(), strict=True) if not has]
        if without:
            lacking.setdefault(listing(without), []).append(f"{column.measure} of {column.where}")
    for names, measures in lacking.items():
        yield Gap(f"{listing(measures, 4)}, {what}", f"without {names}, who have no such value")
