"""The session that a folder holds: one person, a marker set, and what every recording serves for."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torchid.errors import DataError, InputError
from torchid.folder.people import PersonFacts, people_in, stature_of, told_of
from torchid.folder.placing import placed
from torchid.folder.roles import Use, uses_of
from torchid.folder.statements import Person
from torchid.folder.survey import Surveyed, plain_name, survey
from torchid.io.files import container_of
from torchid.io.pairing import shares_name, unpaired_forces
from torchid.model.build import CHILD_M
from torchid.model.recognition import Recognised, recognised, unrecognised
from torchid.wording import listing, plural


class SeveralPeople(InputError):
    """A folder shows several people, and none is named."""

    people: tuple[str, ...] = ()
    """Names that choose one each; none where one was named that is not there."""


@dataclass(frozen=True)
class Proposal:
    """What a config is made of, with the reasons."""

    folder: Path
    told: PersonFacts
    markers: Recognised
    uses: tuple[Use, ...]
    doubts: tuple[str, ...]
    """What could not be decided, or may be wrong."""

    @property
    def name(self) -> str:
        """Of the subject."""
        return self.told.person.name or self.folder.name

    def of(self, role: str) -> tuple[Use, ...]:
        """Recordings of a role."""
        return tuple(use for use in self.uses if use.role == role)


def propose(
    folder: Path, given: Person = Person(), progress: Callable[[str, float], None] = lambda stage, part: None
) -> Proposal:
    """Return the session that a folder of recordings holds.

    Args:
        folder: that holds it, in any depth.
        given: what the user says of the person; a name chooses among several.
        progress: gets the stage and the part of it that is done.

    Raises:
        InputError: ``folder.absent``; ``check.empty`` without recordings, ``folder.unread`` where none can be used.
        SeveralPeople: ``folder.people`` where several people are shown and none, or another one, is named.
        ConfigError: ``markers.unrecognised``.
        DataError: ``folder.no_motion`` where nothing can be fitted.
    """
    folder = _existing(folder)
    every = survey(folder, progress)
    _refuse_unread(every, folder)
    found = _of_person(every, folder, given.name)
    markers, known = _markers(found, folder, told_of(folder, found, given).person, progress)
    uses = uses_of(found, known)
    if not any(use.role == "fit" for use in uses):
        said = [f"{use.of.name}: {use.why}" for use in uses]
        raise DataError(
            "folder.no_motion", "no recording shows a motion that can be fitted", source=str(folder),
            found=listing(said, 6), remedy="Add recordings of motion on force plates, or mend those that are left out",
        )  # fmt: skip
    facts = _facts(folder, found, uses, markers, given)
    pairs = [(one.file, one.forces) for one in every]
    alone = [file.name for file in unpaired_forces(folder, pairs)]
    doubts = [f"no TRC has the name of {listing(alone)}, whose forces are not used"] if alone else []
    doubts += [
        f"{file.name} takes the forces of {forces.name}, which alone begins and ends with it"
        for file, forces in pairs
        if forces is not None and not shares_name(file, forces)
    ]
    return Proposal(folder, facts, markers, uses, (*doubts, *_doubts(facts, uses)))


def _existing(folder: Path) -> Path:
    """Return a folder's whole path.

    Raises:
        InputError: ``folder.absent``.
    """
    if folder.is_dir() or (folder.is_file() and container_of(folder) == folder):
        return folder.resolve()
    raise InputError(
        "folder.absent", "a file is no folder" if folder.exists() else "no such folder", source=str(folder),
        remedy="Name the folder, or the .b3d file, that holds the recordings",
    )  # fmt: skip


def _refuse_unread(found: Sequence[Surveyed], folder: Path) -> None:
    """Refuse a folder of which no recording could be read, or none has labels."""
    if any(one.labels for one in found):
        return
    said = [f"{one.name}: {one.refusal.message if one.refusal else 'no label is seen in half of it'}" for one in found]
    first = next((one.refusal for one in found if one.refusal), None)
    raise InputError(
        "folder.unread", "no recording can be used", source=str(folder), found=listing(said, 6),
        remedy=first.remedy if first else "Label the points in the recording system and export the recordings again",
    )  # fmt: skip


def _markers(
    found: Sequence[Surveyed], folder: Path, person: Person, progress: Callable[[str, float], None]
) -> tuple[Recognised, dict[str, int]]:
    """Return the markers of the recordings whose labels are most alike, and how many of them each recording shows.

    Where labels do not tell enough, places and motion are asked.
    """
    each = {one.name: recognised(one.labels) for one in found if one.labels}
    sets = [own.name for own in each.values() if own.enough]
    first = max(sets, key=sets.count, default=None)
    own = [one for one in found if one.name in each and first in (None, each[one.name].name)]
    markers = recognised(label for one in own for label in one.labels)
    if not markers.enough:
        markers = placed(markers, own, person, progress)
    if not markers.enough:
        raise unrecognised(markers, str(folder))
    known = {one.name: len(markers.markers.match(one.labels).assigned) for one in found}
    return markers, known


def _of_person(found: tuple[Surveyed, ...], folder: Path, name: str | None) -> tuple[Surveyed, ...]:
    """Return the recordings of one person."""
    people = people_in(found, folder)
    if len(people) == 1:
        return found
    if name in people:
        return tuple(people[name])
    each = [f"{who} ({plural(len(some), 'recording')})" for who, some in people.items()]
    error = SeveralPeople(
        "folder.people", "the recordings are of several people" if name is None else "nobody here is called so",
        source=str(folder), place="" if name is None else f"subject {name}", found=listing(each, 12),
        remedy=f"Name one of them with --subject {next(iter(people))!r}",
    )  # fmt: skip
    error.people = () if name else tuple(people)
    raise error


def _facts(
    folder: Path, found: Sequence[Surveyed], uses: Sequence[Use], markers: Recognised, given: Person
) -> PersonFacts:
    """Return what is known of the person, the stature from standing markers where nobody states it."""
    told = told_of(folder, found, given)
    person, sources = told.person, dict(told.sources)
    name = plain_name(person.name) if person.name else next(iter(people_in(found, folder)))
    standing = next((use.of for use in uses if use.role == "static"), None)
    stature = None if standing is None else stature_of(standing, markers.markers)
    if person.height_m is None and stature is not None and standing is not None:
        person, sources = replace(person, height_m=stature), sources | {"height_m": f"markers of {standing.name}"}
    return replace(told, person=replace(person, name=name), sources=sources)


def _doubts(facts: PersonFacts, uses: Sequence[Use]) -> Iterator[str]:
    """Return what could not be decided, or may be wrong."""
    person, roles = facts.person, [use.role for use in uses]
    yield from facts.contradictions
    yield from (f"{use.of.name}: {use.why}" for use in uses if use.mend)
    if facts.sources.get("height_m", "").startswith("markers of"):
        yield f"no stature is stated; {person.height_m:.2f} m is what standing markers tell, to about 3 %"
    elif person.height_m is None:
        mean = "of adults is taken, which no child has" if person.age_years is None else "of that age is taken"
        yield f"no stature is stated: the mean {mean}"
    if person.age_years is None and person.height_m is not None and person.height_m < CHILD_M[1]:
        yield "no age is stated: the stature tells it, which a small adult's does not"
    if not any(use.role and use.serves_inertia for use in uses):
        yield "no forces: mass and inertia are not identified"
    elif person.mass_kg is None:
        yield "no mass is stated: what plates carry tells it"
    if person.sex is None:
        yield "no sex is stated: tables of both are averaged"
    if "static" not in roles:
        yield "nobody stands still: the posture of rest is told by motion alone"
    if "heldout" not in roles:
        yield "nothing is held out: no prediction can be tested"
