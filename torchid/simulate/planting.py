"""Effects that a synthetic session hides."""

from collections.abc import Collection, Iterable
from dataclasses import replace

import torch

from torchid.effects.catalogue import effect
from torchid.effects.effect import Planted
from torchid.effects.place import Place, parse_angle
from torchid.effects.scene import PlateFrame, Reading, plate_frame
from torchid.errors import ConfigError
from torchid.recording import Plate, Trial
from torchid.simulate.options import PlantedOptions


def planted(options: PlantedOptions) -> Planted:
    """The effect that the options describe.

    Raises:
        ConfigError: unknown, or a parameter is missing.
    """
    found = effect(options.effect)
    values = {key: torch.as_tensor(value, dtype=torch.float64) for key, value in options.parameters.items()}
    point = tuple(values["point_seg_m"].tolist()) if "point_seg_m" in values else None
    follows = None if options.follows is None else parse_angle(options.follows)
    place = Place(options.where, options.when, point, found.grid(values), follows=follows, markers=options.markers)
    return Planted(found, place, found.internal(place, values))


def check_places(hidden: Iterable[Planted], known: Collection[str], labels: Collection[str]) -> None:
    """Nothing is hidden at what a session does not have.

    Raises:
        ConfigError: a place is none of those known, or a marker has no label.
    """
    for one in hidden:
        strange = [name for name in one.place.where if name not in known and name not in labels]
        strange += [name for name in one.place.markers if name not in labels]
        if strange:
            raise ConfigError(
                "effect.place", "the session has nothing of that name", place=one.effect.name, found=", ".join(strange),
                remedy=f"Name markers by their labels; other places are {', '.join(sorted(known))}",
            )  # fmt: skip


def numbered_frames(plates: tuple[Plate, ...]) -> tuple[PlateFrame, ...]:
    """Frames of plates with corners, numbered from one."""
    corners = [plate.corners for plate in plates]
    return tuple(plate_frame(f"plate_{k + 1}", c) for k, c in enumerate(corners) if c is not None)


def misread(trial: Trial, hidden: tuple[Planted, ...]) -> Trial:
    """The recording as plates with these effects would have made it."""
    if not hidden or trial.forces is None:
        return trial
    reading = Reading(trial.name, trial.forces.time, trial.forces.wrench, numbered_frames(trial.forces.plates))
    for one in hidden:
        reading = one.read(reading)
    return replace(trial, forces=replace(trial.forces, wrench=reading.wrench))
