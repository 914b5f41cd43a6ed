"""Labels of a folder that say nothing, told by where their markers stand and how they move."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from torchid.folder.roles import standing_of
from torchid.folder.statements import SMALLEST_M, TALLEST_M, Person
from torchid.folder.survey import Surveyed
from torchid.geometry.placing.place import place_markers, seen_standing
from torchid.model.model import Model
from torchid.model.recognition import Recognised
from torchid.model.whole_body import whole_body
from torchid.recording import Trial

TOPS = (1.0, 0.94, 0.83, 0.57)
"""Choice. Height of the highest marker as a share of the stature, where nobody states that: on the head, on a band
about it, on a shoulder, on the pelvis."""
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
    unknown = tuple(label for label in labels if label in markers.unknown)
    trials = _trials(found)
    if not unknown or not trials:
        return markers
    progress(STAGE, 0.0)
    known = {label: spec for label, spec in (markers.listed | markers.worded).items() if label in labels}
    told = place_markers(unknown, _model((*unknown, *known), trials, person), trials, known)
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


def _model(labels: Sequence[str], trials: Sequence[Trial], person: Person) -> Model:
    """The template: of the stature that is stated, else of the one in which somebody is seen to stand best."""
    sex = person.sex or "unknown"
    if person.height_m is not None:
        return whole_body(person.height_m, person.mass_kg, sex)
    high = max(float(trial.markers.position[..., 2].nan_to_num(0.0).max()) for trial in trials)
    low = min(float(trial.markers.position[..., 2].nan_to_num(high).min()) for trial in trials)
    statures = [(high - low) / share for share in TOPS]
    models = [whole_body(tall, person.mass_kg, sex) for tall in statures if SMALLEST_M < tall < TALLEST_M]
    return max(models, key=lambda one: seen_standing(labels, one, trials), default=whole_body(None, None, sex))
