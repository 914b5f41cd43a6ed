"""What else than a plate may be wrong: a file's vertical or moments, a recording on its head, markers of a size."""

from collections.abc import Callable
from dataclasses import replace

from torchid.checks.plates_against_feet.changes import Change, Up, file_changes
from torchid.checks.plates_against_feet.feet import floor_height
from torchid.checks.plates_against_feet.readings import scene_of, shared_changes, tried
from torchid.io.mend import ForcesAs
from torchid.recording import Trial

HANGING_M = 0.5
"""Who stands on plates has his feet this near the origin's height; who stands on his head has them further off."""
SIZES = (0.5, 2.0)
"""Factors of all markers that are tried where no reading of the forces helps."""


def other_up(reread: Callable[[Change], Trial | None]) -> Change | None:
    """The change of the vertical of markers or forces alone under which they agree, None where there is none."""
    axes: tuple[tuple[Up, Up], ...] = (("y", "z"), ("z", "y"))
    for markers, forces in axes:
        what = f"the markers have {markers.upper()} up and the forces {forces.upper()}"
        change = Change(what, ForcesAs(up=forces), up=markers)
        other = reread(change)
        scene = None if other is None else scene_of(other)
        if scene is None or other is None:
            continue
        each = {k: tried(scene, k, file_changes(True)) for k in range(len(scene.forces.plates))}
        if _all_agree(other):
            return change
        turned = shared_changes(scene, each)
        if turned:
            both = replace(turned[0].forces_as, up=forces)
            return replace(turned[0], up=markers, forces_as=both, what=f"{what}, and {turned[0].what}")
    return None


def moments_of_origins(reread: Callable[[Change], Trial | None]) -> Change | None:
    """The change that drops a file's moments, if forces at its points then agree; None where they do not.

    A point that is the pressure leaves no moment but the free one. Horizontal moments beside a point that moves with
    the foot are those about the plate's origin, and would count twice.
    """
    what = "its moments are about the plates' origins, while its points are the pressures"
    change = Change(what, ForcesAs(moment_gain=0.0))
    other = reread(change)
    return change if other is not None and _all_agree(other) else None


def off_the_floor(trial: Trial) -> bool:
    """Whether the lowest markers are far from the height of the plates."""
    return abs(floor_height(trial.markers)) > HANGING_M


def upside_down(trial: Trial) -> bool:
    """Whether forces and feet agree once the whole recording is turned on its feet."""
    if trial.forces is None or not off_the_floor(trial):
        return False
    half = trial.markers.position.new_tensor([1.0, -1.0, -1.0])
    bare = tuple(replace(plate, corners=None) for plate in trial.forces.plates)
    return _all_agree(
        replace(
            trial,
            markers=replace(trial.markers, position=trial.markers.position * half),
            forces=replace(trial.forces, wrench=trial.forces.wrench * half.repeat(2), plates=bare),
        )
    )


def other_size(trial: Trial) -> float | None:
    """The factor of all markers with which forces and feet agree, None where none of ``SIZES`` does."""
    for size in SIZES:
        if _all_agree(replace(trial, markers=replace(trial.markers, position=trial.markers.position * size))):
            return size
    return None


def _all_agree(trial: Trial) -> bool:
    scene = scene_of(trial)
    if scene is None:
        return False
    plates = [tried(scene, k, []) for k in range(len(scene.heights))]
    loaded = [plate for plate in plates if plate.enough(0)]
    return bool(loaded) and all(plate.agrees(0) for plate in loaded) and scene.astray(scene.forces.wrench) is None
