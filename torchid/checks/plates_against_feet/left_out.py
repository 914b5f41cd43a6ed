"""Plates that reading has left out, and the change of reading under which a foot stands on them."""

from collections.abc import Callable
from dataclasses import replace

from torchid.checks.plates_against_feet.changes import Change, corner_changes, plate_changes
from torchid.checks.plates_against_feet.evidence import carries_foot
from torchid.checks.plates_against_feet.finding import ForceFinding, without
from torchid.checks.plates_against_feet.readings import scene_of, tried
from torchid.io.mend import PlateAs, number_of
from torchid.recording import Trial

Reread = Callable[[Change], Trial | None]
"""Reads the trial again with a change; None where reading refuses."""
SMALLER = 1e-3
"""Resolution. Gain with which an overloaded plate is read again, so that reading keeps it; it is then taken back."""


def left_out_plates(trial: Trial, reread: Reread) -> tuple[ForceFinding, ...]:
    """Return the plates that reading left out, on which a foot stands once they are read in another way.

    Args:
        trial: as read; its parameters name the plates.
        reread: reads it again with a change.
    """
    found = [_cornered(number, reread) for number in _numbers(trial, "plates refused")]
    found += [_rewired(number, reread) for number in _numbers(trial, "plates overloaded")]
    return tuple(one for one in found if one is not None)


def _numbers(trial: Trial, key: str) -> list[int]:
    return [int(number) for number in trial.parameters.get(key, "").split()]


def _cornered(number: int, reread: Reread) -> ForceFinding | None:
    """Return what is wrong with a plate that carries a foot once its corners are changed."""
    changes = tuple(change for change in corner_changes(number) if _carries(reread(change), number))
    said = f"plate {number} is refused for its corners, yet somebody stands on it"
    return ForceFinding(said, changes, without(number)) if changes else None


def _rewired(number: int, reread: Reread) -> ForceFinding | None:
    """Return what is wrong with an overloaded plate that carries a foot once its channels are changed, or once the
    config says nothing of it."""
    trial = reread(Change("", plates={number: PlateAs(gain=SMALLER)}))
    k = -1 if trial is None else _index(trial, number)
    if trial is None or trial.forces is None or k < 0:
        return None
    gain = trial.forces.wrench.new_ones(len(trial.forces.plates), 1)
    gain[k] /= SMALLER
    scene = scene_of(replace(trial, forces=replace(trial.forces, wrench=trial.forces.wrench * gain)))
    if scene is None:
        return None
    plate = tried(scene, k, plate_changes(scene.forces.plates, k))
    right = () if plate.agrees(0) else tuple(plate.right)
    said = f"plate {number} reads what nobody bears"
    return ForceFinding(said, right, without(number)) if right or plate.agrees(0) else None


def _carries(trial: Trial | None, number: int) -> bool:
    scene = None if trial is None else scene_of(trial)
    k = -1 if trial is None else _index(trial, number)
    return scene is not None and k >= 0 and carries_foot(scene.feet, scene.forces.wrench[:, k], scene.heights[k])


def _index(trial: Trial, number: int) -> int:
    """Return where a plate stands among those of a trial, -1 where it is none of them."""
    plates = () if trial.forces is None else trial.forces.plates
    numbers = [number_of(plate, k) for k, plate in enumerate(plates)]
    return numbers.index(number) if number in numbers else -1
