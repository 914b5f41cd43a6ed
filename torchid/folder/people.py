"""Whom the recordings of a folder show: how many people, and what is known of one."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import linear_regression

from torchid.folder.statements import SMALLEST_M, TALLEST_M, Person, statements_of
from torchid.folder.survey import Surveyed, plain_name
from torchid.io.files import bids_subject, unique_names
from torchid.kinematics.recursion import body_transforms
from torchid.model.marker_set import MarkerSet
from torchid.model.model import Model
from torchid.model.whole_body import whole_body

ALIKE = 0.02
"""Choice. Part by which two statements may differ about a mass or a stature and still be of one person."""
BIRTHDAY = 1.0
"""Choice. Years by which two statements may differ about an age and still be of one person: one was made before a
birthday, the other after it."""
UPRIGHT = ("c7", "jugular_notch", "acromion", "asis", "psis", "knee_lateral", "ankle_lateral")
"""Landmarks whose heights tell the stature of one who stands."""
SPAN = 0.3
"""Choice. Part of the stature that these landmarks must span to tell it: from hips to shoulders."""
FEWEST = 4
"""Choice. Landmarks that tell a stature."""


@dataclass(frozen=True)
class PersonFacts:
    """A person, and where each fact comes from."""

    person: Person
    sources: Mapping[str, str]
    """By the name of the fact."""
    contradictions: tuple[str, ...] = ()


def told_of(folder: Path, found: Sequence[Surveyed], given: Person) -> PersonFacts:
    """Return what is known of the person of some recordings.

    Args:
        folder: that holds them; files in it are named by their path below it.
        found: the recordings.
        given: what the user says, which goes first.
    """
    each = [(given, "as given"), *(fact for one in found for fact in statements_of(one, folder))]
    facts: dict[str, str | float] = {}
    sources: dict[str, str] = {}
    against: dict[str, None] = {}
    for person, source in each:
        for key, value in person.known.items():
            if key not in facts:
                facts[key], sources[key] = value, source
            elif not _same(key, value, facts[key]):
                against[f"{key} is {facts[key]} ({sources[key]}) and {value} elsewhere"] = None
    return PersonFacts(Person(**facts), sources, tuple(against))  # pyright: ignore[reportArgumentType]


def _same(key: str, one: str | float, other: str | float) -> bool:
    """Return whether two statements of one fact agree."""
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    if key == "age_years":
        return abs(one - other) <= BIRTHDAY
    return abs(one / other - 1.0) <= ALIKE


def stature_of(standing: Surveyed, markers: MarkerSet) -> float | None:
    """Return the stature that the heights of a standing person's markers tell [m]; None where they span too little.

    The line through the landmarks' heights over those of the template has the ratio of both statures for its slope,
    whatever the lowest marker is.

    Args:
        standing: who stands still.
        markers: where the markers are.
    """
    given = markers.match(standing.labels).assigned
    model = whole_body(None, None)
    template = _template_heights(model)
    pairs = [(template[s.landmark], standing.heights[label]) for label, s in given.items() if s.landmark in template]
    if len(pairs) < FEWEST or max(z for z, _ in pairs) - min(z for z, _ in pairs) < SPAN * model.height:
        return None
    slope = linear_regression([z for z, _ in pairs], [z for _, z in pairs]).slope
    found = round(model.height * slope, 3)
    return found if SMALLEST_M < found < TALLEST_M else None


def _template_heights(model: Model) -> dict[str, float]:
    """Return heights of the upright landmarks of the template [m]."""
    tree, xi = model.tree, model.geometry.mean
    X_WB = body_transforms(tree, xi.new_zeros(1, len(tree.dofs)), model.geometry.geometry(xi))[0]
    return {
        name: float((X_WB[tree.index(one.segment)] @ xi.new_tensor([*one.p_BM_B, 1.0]))[2])
        for name, one in model.landmarks.items()
        if re.sub(r"_[lr]$", "", name) in UPRIGHT
    }


def people_in(found: Sequence[Surveyed], folder: Path) -> dict[str, list[Surveyed]]:
    """Return the recordings of each person, by a name of its own.

    Recordings show one person unless they, or files beside them, state masses, statures, sexes or ages that differ: the
    name of a subject is often that of a template. In names of Motion-BIDS it is the person's. Those of which nobody
    states anything belong to whom their folder belongs to.

    Args:
        found: the recordings.
        folder: that holds them all.
    """
    groups: list[tuple[Person, list[Surveyed]]] = []
    silent: list[Surveyed] = []
    for one in found:
        stated = told_of(folder, (one,), Person(bids_subject(one.file))).person
        own = next((members for person, members in groups if _alike(person, stated)), None)
        if not stated.known:
            silent.append(one)
        elif own is None:
            groups.append((stated, [one]))
        else:
            own.append(one)
    if len(groups) < 2:
        return {_name_of(found, folder): list(found)}
    for one in silent:
        depth = [max(_shared(one, other) for other in members) for _, members in groups]
        for (_, members), own in zip(groups, depth, strict=True):
            if own == max(depth):
                members.append(one)
    names = [_name_of(members, _common(members)) for _, members in groups]
    named = [
        name if names.count(name) == 1 else plain_name("_".join((name, *_said(person))))
        for name, (person, _) in zip(names, groups, strict=True)
    ]
    return dict(zip(unique_names(named), (members for _, members in groups), strict=True))


def _said(person: Person) -> list[str]:
    """Return what is known of a person, in words for a name."""
    facts = person.known.values()
    return [fact if isinstance(fact, str) else f"{fact:g}" for fact in facts]


def _shared(one: Surveyed, other: Surveyed) -> int:
    """Return how many folders two recordings share."""
    return len(Path(os.path.commonpath([one.file.parent, other.file.parent])).parts)


def _common(some: Sequence[Surveyed]) -> Path:
    """Return the folder that holds some recordings."""
    return Path(os.path.commonpath([one.file.parent for one in some]))


def _alike(one: Person, other: Person) -> bool:
    """Return whether two statements may be of one person."""
    return all(_same(key, one.known[key], other.known[key]) for key in one.known.keys() & other.known.keys())


def _name_of(some: Sequence[Surveyed], folder: Path) -> str:
    """Return the name that recordings state; where they state none or several, that of their folder."""
    named = {one.stated["subject"] for one in some if one.stated.get("subject")}
    return plain_name(named.pop() if len(named) == 1 else folder.name)
