"""One list of plates for the whole session: a plate is known again by its corners, or by where it bears."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.effects.scene import PlateFrame, plate_frame
from torchid.io.mend import number_of
from torchid.recording import Forces, Plate

SAME_CORNERS = 0.02
"""Resolution. Distance of corners from which on they are another plate's [m]: more than files round, less than plates
are wide."""
SAME_PRESSURE = 0.35
"""Resolution. Distance between medians of the centre of pressure from which on they are another plate's, where a file
has no corners [m]: half of a plate and a stride's scatter."""


@dataclass(frozen=True)
class SessionPlate:
    """A plate of the session and the channels that belong to it."""

    frame: PlateFrame
    """Name, origin and axes of the plate."""
    corners: Float[Tensor, "4 3"] | None
    """Corners in W [m]; None where no file has them."""
    channels: dict[str, str]
    """Name of the plate in the file, by trial."""
    numbers: dict[str, int]
    """Number by which a config names it, by trial."""


def recognise(forces: Mapping[str, Forces]) -> tuple[tuple[SessionPlate, ...], dict[str, tuple[PlateFrame, ...]]]:
    """Return all plates of the session, and the frames of every trial's plates in the order of the file.

    Args:
        forces: readings by trial.
    """
    plates: list[SessionPlate] = []
    frames: dict[str, tuple[PlateFrame, ...]] = {}
    for trial, own in forces.items():
        middle = own.centre_of_pressure(LOADED_N).nanmedian(dim=0).values
        found = []
        for k, plate in enumerate(own.plates):
            known = _known(plates, plate, middle[k], trial)
            if known is None:
                name = f"plate_{len(plates) + 1}"
                centre = torch.nan_to_num(middle[k])
                eye = torch.eye(3, dtype=centre.dtype, device=centre.device)
                frame = PlateFrame(name, centre, eye) if plate.corners is None else plate_frame(name, plate.corners)
                known = SessionPlate(frame, plate.corners, {}, {})
                plates.append(known)
            known.channels[trial], known.numbers[trial] = plate.name, number_of(plate, k)
            found.append(known.frame)
        frames[trial] = tuple(found)
    return tuple(plates), frames


def _known(plates: list[SessionPlate], plate: Plate, middle: Tensor, trial: str) -> SessionPlate | None:
    """Return the plate of the list that has these corners or bears there; None where it is a new one.

    Of several that bear there, as belts under both feet of a runner do, that is meant which other files call the same.
    """
    corners = plate.corners
    free = [p for p in plates if trial not in p.channels and (p.corners is None) == (corners is None)]
    if corners is not None:
        return next((p for p in free if p.corners is not None and _apart(p.corners, corners) < SAME_CORNERS), None)
    if not bool(torch.isfinite(middle[:2]).all()):
        return None
    away = [float((p.frame.p_WF - middle)[:2].norm()) for p in free]
    near = [(plate.name not in p.channels.values(), d, k) for k, (p, d) in enumerate(zip(free, away, strict=True))]
    *_, k = min((one for one in near if one[1] < SAME_PRESSURE), default=(False, torch.inf, -1))
    return free[k] if k >= 0 else None


def _apart(a: Tensor, b: Tensor) -> float:
    """Return the largest distance between corners of the same number [m]."""
    return float((a - b).norm(dim=1).max())
