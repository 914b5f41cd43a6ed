"""Scales of 0 or of a thousandth: moments without the forces that make them, forces without moments, or neither.

A plate bears a foot somewhere, and a foot moves its pressure: forces whose moments vanish are as impossible as moments
without forces. Both are told from the plate's own channels; what mends them has to put the pressure under a foot.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.evidence import SLIP_M_S, slowest_point, weighted_quantile
from torchid.checks.plates_against_feet.feet import LOW_M, Feet, find_feet
from torchid.checks.plates_against_feet.finding import ForceFinding, without
from torchid.checks.plates_against_feet.readings import FEWEST, FeetScene, scene_of, tried
from torchid.conventions import SAMPLE_LOADED_N
from torchid.io.mend import PlateAs, mend, number_of
from torchid.io.plate_axes import in_plate
from torchid.recording import Forces, Plate, Trial

MOMENT_NM = 20.0
"""Choice. Moment that no idle plate shows: somebody 30 mm from the middle of a plate gives as much."""
ROOM_M = 20.0
"""Physical. Lever beyond which a force acts on no plate of the room, where a file has no corners."""
PINNED_M = 0.003
"""Physical. A pressure that stays this near the middle of a plate under nearly all load is that of moments scaled away:
who stands still sways by 5 mm, and his pressure is in the middle of 0.5 m by 0.6 m once in ten thousand times."""
NEARLY_ALL = 0.95
"""Choice. Share of the load meant by that."""
THOUSAND = 1e3
"""Derived. Between N and kN, and between N m and N mm."""


def scale_findings(trial: Trial, scene: FeetScene | None) -> tuple[ForceFinding, ...]:
    """Plates whose forces or moments have been scaled away.

    Args:
        trial: forces on the clock of its markers.
        scene: of it, None where no force is large enough to be judged.
    """
    if trial.forces is None:
        return ()
    alone = [k for k in range(len(trial.forces.plates)) if _moments_alone(trial.forces, k)]
    found = [_without_forces(trial, k) for k in alone]
    if scene is not None:
        found += [_without_moments(scene, k) for k in range(len(scene.forces.plates)) if _pinned(scene, k)]
    if found:
        return tuple(found)
    # Who stands for geometry alone may do so on plates that are switched off.
    silent = trial.role != "static" and not _any_loaded(trial.forces)
    return tuple(map(_unread, unread_plates(trial))) if silent else ()


def dead_plates(trial: Trial) -> tuple[int, ...]:
    """Indices of plates with moments and no force in any channel: who exchanges two channels leaves two of three dead.

    Args:
        trial: forces on the clock of its markers.
    """
    if trial.forces is None:
        return ()
    none = ~trial.forces.wrench[..., :3].nan_to_num().bool().any(dim=0).any(dim=-1)
    return tuple(k for k in range(len(none)) if none[k] and _moments_alone(trial.forces, k))


@dataclass(frozen=True)
class UnreadPlate:
    """A plate that reads nothing under a foot."""

    plate: Plate
    number: int
    seconds: float
    """For which a foot stands on it."""
    peak: float
    """Largest force that it reads [N]."""


def unread_plates(trial: Trial) -> tuple[UnreadPlate, ...]:
    """Plates with corners on which a foot stands and that read nothing throughout.

    Args:
        trial: forces on the clock of its markers.
    """
    feet = None if trial.forces is None else find_feet(trial.markers)
    if feet is None or trial.forces is None:
        return ()
    peak = trial.forces.wrench[..., :3].nan_to_num().norm(dim=-1).amax(dim=0)
    share = (float(trial.markers.time[-1]) - float(trial.markers.time[0])) / max(len(feet.frames), 1)
    found = []
    for k, plate in enumerate(trial.forces.plates):
        stands = 0 if plate.corners is None else int(_stands_on(feet, plate.corners).sum())
        if stands >= FEWEST and float(peak[k]) < SAMPLE_LOADED_N:
            found.append(UnreadPlate(plate, number_of(plate, k), stands * share, float(peak[k])))
    return tuple(found)


def _any_loaded(forces: Forces) -> bool:
    return bool((forces.wrench[..., :3].nan_to_num().norm(dim=-1) > SAMPLE_LOADED_N).any())


def _stands_on(feet: Feet, corners: Tensor) -> Tensor:
    """Frames (n) in which all markers of some foot are low and above the plate, and the foot stands still."""
    edges = torch.stack([corners[1] - corners[0], corners[3] - corners[0]])[:, :2]
    lengths = edges.norm(dim=1)
    along = (feet.position[..., :2] - corners[0, :2]) @ (edges / lengths[:, None]).T
    inside = ((along > 0.0) & (along < lengths)).all(dim=-1) & (feet.position[..., 2] - corners[:, 2].mean() < LOW_M)
    still = slowest_point(feet).norm(dim=-1) < SLIP_M_S
    each = [inside[:, feet.foot == f].all(dim=1) & still[:, f] for f in range(feet.count)]
    return torch.stack(each).any(dim=0)


def _unread(one: UnreadPlate) -> ForceFinding:
    said = f"{one.plate.name} reads {one.peak:.2g} N at most, yet a foot stands on it for {one.seconds:.1f} s"
    return ForceFinding(f"{said}: its channels are not connected, or scaled by 0", (), without(one.number))


def _levers(forces: Forces, k: int) -> tuple[Tensor, Tensor, float]:
    """Size of force and of horizontal moment (n) of a plate about its transducer, and the longest lever on it [m]."""
    plate, wrench = forces.plates[k], forces.wrench[:, k].nan_to_num()
    if plate.corners is None:
        return wrench[:, :3].norm(dim=1), wrench[:, 3:].norm(dim=1), ROOM_M
    own = in_plate(wrench, plate)
    return own[:, :3].norm(dim=1), own[:, 3:5].norm(dim=1), float((plate.corners[0] - plate.corners[2]).norm())


def _moments_alone(forces: Forces, k: int) -> bool:
    """Whether a plate shows a moment that none of its forces could make on it, and no load."""
    force, moment, longest = _levers(forces, k)
    at = moment.argmax()
    return bool((moment[at] > MOMENT_NM) & (force.max() < SAMPLE_LOADED_N) & (moment[at] > longest * force[at]))


def _pinned(scene: FeetScene, k: int) -> bool:
    """Whether the pressure of a plate stays in its middle under nearly all load."""
    plate = scene.forces.plates[k]
    force, moment, _ = _levers(scene.forces, k)
    loaded = scene.forces.wrench[:, k, 2] > SAMPLE_LOADED_N
    if plate.corners is None or int(loaded.sum()) < FEWEST:
        return False
    lever = moment / force.clamp_min(SAMPLE_LOADED_N)
    return float(weighted_quantile(lever[None], (force * loaded)[None], NEARLY_ALL)[0]) < PINNED_M


def _without_forces(trial: Trial, k: int) -> ForceFinding:
    assert trial.forces is not None
    plate, number = trial.forces.plates[k], number_of(trial.forces.plates[k], k)
    force, moment, _ = _levers(trial.forces, k)
    what = f"the forces of {plate.name} are too small by 1000"
    changes = (Change(what, plates={number: PlateAs(gain=THOUSAND, moment_gain=1.0 / THOUSAND)}),)
    said = f"{plate.name} shows moments up to {float(moment.max()):.0f} N m and forces of {float(force.max()):.2g} N"
    said += " at most: its forces are scaled by 0 or far too little"
    return ForceFinding(said, changes if _carries(trial, k, changes[0]) else (), without(number))


def _carries(trial: Trial, k: int, change: Change) -> bool:
    """Whether plate k carries a foot once it is changed."""
    forces = None if trial.forces is None else mend(trial.forces, change.forces_as, change.plates)
    scene = None if forces is None else scene_of(replace(trial, forces=forces))
    return scene is not None and tried(scene, k, []).agrees(0)


def _without_moments(scene: FeetScene, k: int) -> ForceFinding:
    plate, number = scene.forces.plates[k], number_of(scene.forces.plates[k], k)
    larger = Change(
        f"the moments of {plate.name} are too small by 1000", plates={number: PlateAs(moment_gain=THOUSAND)}
    )
    force, moment, _ = _levers(scene.forces, k)
    moves = THOUSAND * float(moment.max()) > MOMENT_NM
    changes = (larger,) if moves and tried(scene, k, [larger]).agrees(1) else ()
    said = f"{plate.name} bears {float(force.max()):.0f} N, and its moments are {float(moment.max()):.2g} N m at most"
    return ForceFinding(f"{said}: they are scaled by 0 or far too little", changes, without(number))
