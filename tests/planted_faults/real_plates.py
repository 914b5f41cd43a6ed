"""Force plates of a real session: which are one, what they bear, and wrenches in their frames.

The frame of a plate, which places and sizes of faults refer to, is torchid's own: at the centre of its corners, x along
the first edge, z up; where a file has no corners, at the middle of the pressure and in the axes of W. Which plates of
several trials are one is said here and not by the diagnosis, so that the same fault is planted for any version of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from planted_faults.real_files import Recorded, with_wrench
from planted_faults.real_truth import Inapplicable
from torchid.conventions import LOADED_N
from torchid.effects.scene import PlateFrame, plate_frame
from torchid.recording import Plate, Trial

Map = Callable[[Tensor, PlateFrame], Tensor]
"""From the wrench about the origin of W that a plate bears (samples, 6), and its frame, to what it reads."""
USED = 0.15
"""Choice. Part of a fit trial's load that a plate must bear for a fault of it to be planted."""
SAME_M = 0.35
"""Choice. Distance between the middles of the pressure in two trials up to which it is one plate [m]: half a plate and
the scatter of a stride."""


@dataclass(frozen=True)
class RealPlate:
    """A plate of the session, or a belt."""

    frame: PlateFrame
    channels: dict[str, str]
    """Name of the plate in the file, by trial."""


def plates_of(recorded: Recorded) -> tuple[RealPlate, ...]:
    """All plates of the session, known again by their names where files have corners, else by where they are pressed.

    What a file without corners has of a plate that nobody steps on belongs to none.
    """
    found: list[RealPlate] = []
    for trial in recorded.trials:
        if trial.forces is not None:
            middles = trial.forces.centre_of_pressure(LOADED_N).nanmedian(0).values
            for plate, middle in zip(trial.forces.plates, middles, strict=True):
                if plate.corners is not None or bool(middle.isfinite().all()):
                    _add_plate(found, trial.name, plate, middle)
    return tuple(found)


def _add_plate(found: list[RealPlate], trial: str, plate: Plate, middle: Tensor) -> None:
    """Put a trial's plate with the one of the session that it is, or make it a new one."""
    free = [one for one in found if trial not in one.channels]
    same = [one for one in free if plate.name in one.channels.values()]
    if plate.corners is None:
        # The belts of a treadmill are nearer to each other than their pressure is to itself: then the name tells.
        ranked = [(one not in same, float((one.frame.p_WF - middle).norm()), k) for k, one in enumerate(free)]
        same = [free[k] for _, apart, k in sorted(ranked) if apart < SAME_M]
    if same:
        same[0].channels[trial] = plate.name
        return
    name, eye = f"plate {len(found) + 1}", torch.eye(3, dtype=torch.float64)
    frame = PlateFrame(name, middle, eye) if plate.corners is None else plate_frame(name, plate.corners)
    found.append(RealPlate(frame, {trial: plate.name}))


def used_plates(recorded: Recorded) -> list[RealPlate]:
    """The plates that bear a good part of the load in a fit trial."""
    fitted = [recorded.trials[k] for k in recorded.fitted]
    found = [p for p in plates_of(recorded) if any(_share(trial, p) > USED for trial in fitted)]
    if not found:
        raise Inapplicable("no plate is loaded in a fit trial")
    return found


def _share(trial: Trial, plate: RealPlate) -> float:
    k = channel(trial, plate)
    if k is None or trial.forces is None:
        return 0.0
    load = trial.forces.wrench[..., 2].nan_to_num().sum(0)
    return float(load[k] / load.sum().clamp(min=1.0))


def channel(trial: Trial, plate: RealPlate) -> int | None:
    """Number of a plate in a trial, None where the trial lacks it."""
    if trial.forces is None or trial.name not in plate.channels:
        return None
    return [one.name for one in trial.forces.plates].index(plate.channels[trial.name])


def mapped(recorded: Recorded, plates: Sequence[RealPlate], change: Map) -> Recorded:
    """The session with what some plates read changed in every trial."""
    for k, trial in enumerate(recorded.trials):
        for plate in plates:
            at = channel(trial, plate)
            if at is not None:
                assert trial.forces is not None
                wrench = trial.forces.wrench.clone()
                wrench[:, at] = change(wrench[:, at], plate.frame)
                trial = with_wrench(trial, wrench)
        recorded = recorded.with_trial(k, trial)
    return recorded


def sideways(recorded: Recorded, plate: RealPlate) -> np.ndarray:
    """The horizontal direction from the left to the right of the body while a plate is loaded in fit trials."""
    found = []
    for k in recorded.fitted:
        trial = recorded.trials[k]
        at = channel(trial, plate)
        if at is None or trial.forces is None:
            continue
        load = np.interp(
            trial.markers.time.numpy(), trial.forces.time.numpy(),
            trial.forces.wrench[:, at, 2].nan_to_num().numpy(),
        )  # fmt: skip
        loaded = torch.from_numpy(load > LOADED_N)
        right, left = (_side(recorded, trial, end)[loaded] for end in ("_r", "_l"))
        found.append((right - left)[:, :2])
    mean = torch.cat(found).nanmean(0).numpy()
    return mean / np.linalg.norm(mean)


def _side(recorded: Recorded, trial: Trial, end: str) -> Tensor:
    own = [k for k, label in enumerate(trial.markers.labels) if recorded.segments.get(label, "").endswith(end)]
    return trial.markers.position[:, own].nanmean(1)


def to_plate(frame: PlateFrame, wrench: Tensor) -> Tensor:
    """A wrench about the origin of W, about the plate's origin and in its axes [N, N m]."""
    force = wrench[:, :3]
    moment = wrench[:, 3:] - torch.linalg.cross(frame.p_WF.expand_as(force), force)
    return torch.cat([force @ frame.R_WF, moment @ frame.R_WF], 1)


def to_world(frame: PlateFrame, wrench: Tensor) -> Tensor:
    """The inverse of ``to_plate``."""
    force, moment = wrench[:, :3] @ frame.R_WF.T, wrench[:, 3:] @ frame.R_WF.T
    return torch.cat([force, moment + torch.linalg.cross(frame.p_WF.expand_as(force), force)], 1)
