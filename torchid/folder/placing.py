"""Labels of a folder that say nothing, told by where their markers stand and how they move."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from torchid.folder.roles import standing_of
from torchid.folder.statements import Person
from torchid.folder.survey import Surveyed
from torchid.geometry.placing.place import place_markers
from torchid.model.recognition import Recognised
from torchid.model.whole_body import whole_body
from torchid.recording import Trial

STAGE = "placing markers"


def placed(
    markers: Recognised,
    found: Sequence[Surveyed],
    person: Person,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> Recognised:
    """Return what labels tell, and what places and motion tell of the others.

    Args:
        markers: what the labels tell.
        found: recordings of one person.
        person: what is known of that person.
        progress: gets the stage and the part of it that is done.
    """
    labels = dict.fromkeys(label for one in found for label in one.labels)
    computed = {label for one in found for label in one.computed}
    unknown = tuple(label for label in labels if label in markers.unknown and label not in computed)
    trials = _trials(found)
    if not unknown or not trials:
        return markers
    progress(STAGE, 0.0)
    known = {label: spec for label, spec in (markers.listed | markers.worded).items() if label in labels}
    model = whole_body(person.height_m, person.mass_kg, person.sex or "unknown", age=person.age_years)
    told = place_markers(unknown, model, trials, known)
    progress(STAGE, 1.0)
    if told is None:
        return markers
    left = tuple(label for label in markers.unknown if label not in told.specs)
    return replace(markers, placed=dict(told.specs), unknown=left)


def _trials(found: Sequence[Surveyed]) -> tuple[Trial, ...]:
    """The recordings with a role: who stands still, and motion."""
    standing = standing_of(found)
    return tuple(
        Trial(one.name, one.some, role="static" if one is standing else "fit") for one in found if one.some is not None
    )
