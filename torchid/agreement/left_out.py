"""Plates that reading has left out, and the change of reading under which a foot stands on them."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import torch

from torchid.agreement.changes import Change, corner_changes, plate_changes
from torchid.agreement.evidence import carries_foot
from torchid.agreement.finding import Finding, without
from torchid.agreement.readings import scene_of, tried
from torchid.io.mend import PlateAs, number_of
from torchid.recording import Trial

Reread = Callable[[Change], Trial | None]
"""Reads the trial again with a change; None where reading refuses."""
SMALLER = 1e-3
"""Resolution. Gain with which an overloaded plate is read again, so that it is kept, and which is then taken back: of
N mm taken for N and the like."""


def left_out_plates(trial: Trial, reread: Reread) -> tuple[Finding, ...]:
    """Return the plates that reading left out, on which a foot stands once they are read in another way.

    Args:
        trial: as read; its parameters name the plates.
        reread: reads it again with a change.
    """
    return tuple(
        [
            *_found(
                trial, "plates refused", "is refused for its corners, yet somebody stands on it", reread, _cornered
            ),
            *_found(trial, "plates overloaded", "reads what nobody bears as it is read", reread, _rewired),
        ]
    )


def _found(
    trial: Trial, kind: str, said: str, reread: Reread, ways: Callable[[int, Reread], list[Change]]
) -> Iterator[Finding]:
    for number in map(int, trial.parameters.get(kind, "").split()):
        if changes := ways(number, reread):
            yield Finding(f"plate {number} {said}", tuple(changes), without(number))


def _cornered(number: int, reread: Reread) -> list[Change]:
    """Return the changes of its corners under which a plate carries a foot."""
    return [change for change in corner_changes(number) if _carries(reread(change), number)]


def _rewired(number: int, reread: Reread) -> list[Change]:
    """Return the changes of its channels under which a plate that nobody could load so carries a foot best."""
    trial = reread(Change("", plates={number: PlateAs(gain=SMALLER)}))
    k = -1 if trial is None else _index(trial, number)
    if trial is None or trial.forces is None or k < 0:
        return []
    gain = torch.ones(len(trial.forces.plates), 1, dtype=trial.forces.wrench.dtype)
    gain[k] /= SMALLER
    scene = scene_of(replace(trial, forces=replace(trial.forces, wrench=trial.forces.wrench * gain)))
    return [] if scene is None else tried(scene, k, plate_changes(scene.forces.plates, k)).right


def _carries(trial: Trial | None, number: int) -> bool:
    scene = None if trial is None else scene_of(trial)
    k = -1 if trial is None else _index(trial, number)
    return scene is not None and k >= 0 and carries_foot(scene.feet, scene.forces.wrench[:, k], scene.heights[k])


def _index(trial: Trial, number: int) -> int:
    """Return where a plate stands among those of a trial, -1 where it is none of them."""
    plates = () if trial.forces is None else trial.forces.plates
    numbers = [number_of(plate, k) for k, plate in enumerate(plates)]
    return numbers.index(number) if number in numbers else -1
