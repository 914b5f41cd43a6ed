"""The session that a folder holds: one person, a marker set, and what every recording serves for."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from torchid.errors import DataError, InputError
from torchid.folder.people import Person, PersonFacts, people_in, stature_of, told_of
from torchid.folder.roles import Use, uses_of
from torchid.folder.survey import Surveyed, survey
from torchid.model.recognition import Recognised, recognise
from torchid.wording import listing, plural


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
        InputError: ``check.empty`` without recordings; ``folder.people`` where several people are shown and none, or
            another one, is named.
        ConfigError: ``markers.unrecognised``.
        DataError: ``folder.no_motion`` where nothing can be fitted.
    """
    folder = folder.resolve()
    found = _of_person(survey(folder, progress), folder, given.name)
    labels = [label for one in found for label in one.labels]
    markers = recognise(labels, str(folder))
    uses = uses_of(found, {one.name: len(markers.markers.match(one.labels).assigned) for one in found})
    if not any(use.role == "fit" for use in uses):
        said = [f"{use.of.name}: {use.why}" for use in uses]
        raise DataError(
            "folder.no_motion", "no recording shows a motion that can be fitted", source=str(folder),
            found=listing(said, 6), remedy="Add recordings of motion on force plates, or mend those that are left out",
        )  # fmt: skip
    told, doubts = _person(folder, found, uses, markers, given)
    return Proposal(folder, told, markers, uses, doubts)


def _of_person(found: tuple[Surveyed, ...], folder: Path, name: str | None) -> tuple[Surveyed, ...]:
    """Return the recordings of one person."""
    people = people_in(found, folder)
    if len(people) == 1:
        return found
    if name in people:
        return tuple(people[name])
    each = [f"{who} ({plural(len(some), 'recording')})" for who, some in people.items()]
    raise InputError(
        "folder.people", "the recordings are of several people" if name is None else "nobody here is called so",
        source=str(folder), place="" if name is None else f"subject {name}", found=listing(each, 12),
        remedy=f"Name one of them with --subject {next(iter(people))!r}",
    )  # fmt: skip


def _person(
    folder: Path, found: tuple[Surveyed, ...], uses: tuple[Use, ...], markers: Recognised, given: Person
) -> tuple[PersonFacts, tuple[str, ...]]:
    """Return what is known of the person, completed from standing, and what is in doubt."""
    told = told_of(folder, found, given)
    name = told.person.name or next(iter(people_in(found, folder)))
    doubts = list(told.contradictions)
    person, sources = replace(told.person, name=name), dict(told.sources)
    standing = next((use.of for use in uses if use.role == "static"), None)
    stature = None if standing is None else stature_of(standing, markers.markers)
    if person.height_m is None and stature is not None and standing is not None:
        person, sources = replace(person, height_m=stature), sources | {"height_m": f"markers of {standing.name}"}
        doubts.append(f"no stature is stated; {stature:.2f} m is what standing markers tell, to about 3 %")
    if person.mass_kg is None:
        doubts.append("no mass is stated: what plates carry tells it")
    if person.sex is None:
        doubts.append("no sex is stated: tables of both are averaged")
    if standing is None:
        doubts.append("nobody stands still: the posture of rest is told by motion alone")
    if not any(use.role == "heldout" for use in uses):
        doubts.append("nothing is held out: no prediction can be tested")
    return PersonFacts(person, sources, told.contradictions), tuple(doubts)
