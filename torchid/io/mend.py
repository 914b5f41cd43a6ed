"""What a user says is wrong with the forces of a recording, and how it is undone while the recording is read.

The same keys stand in a config (``forces_as`` for a whole file, ``plates`` by number) and are tried by
``torchid.checks.plates_against_feet`` when forces and feet disagree, so that what it advises is what reading does.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Literal

import torch
from annotated_types import Ge, Le, Len
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import y_up_to_z_up
from torchid.errors import InputError
from torchid.io.plate_axes import from_plate, in_plate
from torchid.recording import Forces, Plate

Channel = Literal["fx", "fy", "fz", "mx", "my", "mz"]
CHANNELS: tuple[Channel, ...] = ("fx", "fy", "fz", "mx", "my", "mz")
Corner = Annotated[int, Ge(1), Le(4)]
Shift = tuple[float, float]


@dataclass(frozen=True)
class ForcesAs:
    """How the forces of a whole file are to be read."""

    use: bool = True
    """False leaves them out: the trial then serves geometry alone."""
    believe: bool = False
    """True takes them as they are read, although they do not agree with the feet: a chair or a cane on a plate."""
    up: Literal["y", "z"] | None = None
    """Vertical axis of the forces, where it is not that of the markers."""
    turn_deg: Literal[0, 90, 180, 270] = 0
    """Turns all forces about the vertical through the origin, counter-clockwise from above."""
    mirror: Literal["x", "y"] | None = None
    """Reverses this horizontal axis of W (after the turn): of a left-handed file."""
    gain: float = 1.0
    """Factor of forces and moments: 1000 for kN, -1 for the reaction on the ground."""
    moment_gain: float = 1.0
    """Further factor of the stored moments alone: 0.001 for N mm."""
    lag_ms: float = 0.0
    """How much later than the markers the forces were stamped."""
    shift_m: Shift = (0.0, 0.0)
    """Moves all plates, and what they read, by this much along X and Y of W: of another origin than the markers'."""


@dataclass(frozen=True)
class PlateAs:
    """How one force plate is to be read."""

    use: bool = True
    """False leaves the plate out; frames with a foot of the model on it then count as not measured."""
    turn_deg: Literal[0, 90, 180, 270] = 0
    """Turns the plate on its place, counter-clockwise from above."""
    corners: Annotated[tuple[Corner, ...], Len(4, 4)] | None = None
    """Right order of the four corners, such as [2, 1, 4, 3]."""
    corner_unit: Literal["mm", "cm", "dm", "m", "in"] | None = None
    """Unit of its corners, where it is not that of the markers."""
    mirror: Literal["x", "y"] | None = None
    """Reverses this axis of the plate: of left-handed wiring."""
    exchange: tuple[Channel, Channel] | None = None
    """Two channels of the plate that carry each other's signal."""
    reads: Annotated[int, Ge(1)] | None = None
    """The plate whose channels this one's corners belong to, where two are exchanged."""
    gain: float = 1.0
    """Factor of its forces and moments."""
    moment_gain: float = 1.0
    """Further factor of its moments alone: 0.001 for N mm."""
    lag_ms: float = 0.0
    """How much later than the markers it was stamped."""
    shift_m: Shift = (0.0, 0.0)
    """Moves the plate, and what it reads, by this much along X and Y of W: of wrong corners."""
    origin_shift_m: Shift = (0.0, 0.0)
    """Moves what it reads alone, its corners being right: of a wrong ORIGIN."""


PlatesAs = Mapping[int, PlateAs]


def in_words(change: ForcesAs | PlateAs) -> str:
    """The change as a config writes it, such as ``{turn_deg: 180}``."""
    different = [f for f in fields(change) if getattr(change, f.name) != f.default]
    return f"{{{', '.join(f'{f.name}: {in_config(getattr(change, f.name))}' for f in different)}}}"


def in_config(value: object) -> str:
    """A value as a config writes it."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(in_config, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def number_of(plate: Plate, index: int) -> int:
    """The number by which a config names a plate: the one in its name (``plate 2``), else its place in the file.

    Args:
        index: its place among the plates, for one that reading has not counted.
    """
    if plate.number is not None:
        return plate.number
    match = re.fullmatch(r"plate (\d+)", plate.name)
    return int(match[1]) if match else index + 1


def ordered_corners(corners: Float[Tensor, "4 3"], change: PlateAs) -> Float[Tensor, "4 3"]:
    """The corners [m] in the order that ``corners`` and ``turn_deg`` ask for."""
    order = [k - 1 for k in change.corners] if change.corners else [0, 1, 2, 3]
    # Corners stand in the quadrants ++, -+, --, +- of a frame with Z down: the next in the list lies clockwise as the
    # file's X and Y show it, so that giving each the place before it turns the plate's frame counter-clockwise.
    anticlockwise = _turning(corners[order]) > 0
    steps = (change.turn_deg // 90) * (1 if anticlockwise else -1)
    return torch.roll(corners[order], -steps, dims=0)


def _turning(corners: Tensor) -> float:
    """Twice the signed area of the corners' outline from above; positive when they run counter-clockwise."""
    a, b = corners[:, :2], torch.roll(corners, -1, dims=0)[:, :2]
    return float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())


def mend(forces: Forces, file: ForcesAs, plates: PlatesAs, source: str = "") -> Forces | None:
    """Forces in W as the user says that they are.

    Corners are moved here, and no more: a plate's frame is needed before its channels mean anything, so that reading
    applies ``corners``, ``turn_deg`` and ``corner_unit`` of a plate first.

    Args:
        file: what holds for the whole file.
        plates: what holds for single plates, by number.

    Raises:
        InputError: ``plates.number`` for a plate that the file lacks, ``plates.corners`` where a change needs corners
            that the file does not have.
    """
    if not file.use or not forces.plates:
        return None
    counted = tuple(replace(plate, number=number_of(plate, k)) for k, plate in enumerate(forces.plates))
    forces = replace(forces, plates=counted)
    index = {number_of(plate, k): k for k, plate in enumerate(forces.plates)}
    _refuse_unknown(plates, index, source)
    if file == ForcesAs() and not plates:
        return forces  # an hour's forces are not copied for nothing
    wrench = torch.stack([_mended(forces, k, plates.get(n), index, source) for n, k in index.items()], dim=1)
    wrench = _turned(_scaled(wrench, forces.plates, file), file)
    moved = _moved(replace(forces, time=forces.time - file.lag_ms / 1e3, wrench=wrench), file, plates)
    kept = [k for n, k in index.items() if plates.get(n, PlateAs()).use]
    return moved.of(kept) if kept else None


def _moved(forces: Forces, file: ForcesAs, plates: PlatesAs) -> Forces:
    """Forces whose plates, and what they read, have been moved to where the user says that they are."""
    known, arms = list(forces.plates), torch.zeros(len(forces.plates), 3).to(forces.wrench)
    for k, plate in enumerate(forces.plates):
        own = plates.get(number_of(plate, k), PlateAs())
        place, origin = (arms.new_tensor([*one, 0.0]) for one in (own.shift_m, own.origin_shift_m))
        place = place + arms.new_tensor([*file.shift_m, 0.0])
        arms[k] = place + origin
        known[k] = plate if plate.corners is None else replace(plate, corners=plate.corners + place)
    if not bool(arms.any()):
        return forces
    force, moment = forces.wrench[..., :3], forces.wrench[..., 3:]
    moment = moment + torch.linalg.cross(arms.expand_as(force), force)
    return replace(forces, wrench=torch.cat([force, moment], dim=-1), plates=tuple(known))


def reframed(forces: Forces, plates: PlatesAs) -> Forces:
    """Forces as reading would give them with corners in the order that ``plates`` asks for."""
    wrench, known = forces.wrench.clone(), list(forces.plates)
    for k, plate in enumerate(forces.plates):
        change = plates.get(number_of(plate, k))
        if change is not None and plate.corners is not None and (change.corners or change.turn_deg):
            known[k] = replace(plate, corners=ordered_corners(plate.corners, change))
            wrench[:, k] = from_plate(in_plate(forces.wrench[:, k], plate), known[k])
    return replace(forces, wrench=wrench, plates=tuple(known))


def _refuse_unknown(plates: PlatesAs, index: dict[int, int], source: str) -> None:
    asked = {n for n, p in plates.items() if p != PlateAs(use=False)} | {p.reads for p in plates.values() if p.reads}
    if not asked <= set(index):
        raise InputError(
            "plates.number", "the file has no such force plate, or it could not be read", source=source, place="plates",
            found=", ".join(map(str, sorted(asked - set(index)))), remedy=f"Known: {', '.join(map(str, index))}",
        )  # fmt: skip


def _mended(forces: Forces, k: int, change: PlateAs | None, index: dict[int, int], source: str) -> Tensor:
    """Wrench (samples, 6) of plate k."""
    wrench, plate = forces.wrench[:, k], forces.plates[k]
    if change is None or change == PlateAs():
        return wrench
    if change.corners or change.turn_deg or change.corner_unit:
        _with_corners(plate, source)  # reading has moved them
    if change.reads or change.exchange or change.mirror:
        origin = index[change.reads] if change.reads else k
        channels = in_plate(forces.wrench[:, origin], _with_corners(forces.plates[origin], source))
        wrench = from_plate(_rewired(channels, change, plate.moment_length), _with_corners(plate, source))
    wrench = _moments(wrench, plate, change.moment_gain) * change.gain
    return _shifted(wrench, change.lag_ms / 1e3 * forces.rate) if change.lag_ms else wrench


def _with_corners(plate: Plate, source: str) -> Plate:
    if plate.corners is None:
        raise InputError(
            "plates.corners", "this change needs the plate's corners, which the file does not have", source=source,
            place=plate.name, found="no corners",
            remedy="Use forces_as: with up, turn_deg or mirror for the axes of the whole file",
        )  # fmt: skip
    return plate


def _rewired(channels: Tensor, change: PlateAs, moment_length: float) -> Tensor:
    channels = channels.clone()
    if change.exchange:
        a, b = (CHANNELS.index(name) for name in change.exchange)
        # What was read as a force in N and is a moment was stored in N times the file's length, and vice versa.
        unit = channels.new_tensor([1.0] * 3 + [moment_length] * 3)
        channels[:, [a, b]] = channels[:, [b, a]] * unit[[a, b]] / unit[[b, a]]
    if change.mirror:
        channels = channels * _reflection(change.mirror, channels)
    return channels


def _reflection(axis: str, like: Tensor) -> Tensor:
    """Signs (6,) that reflect a wrench along x or y: of the force that component, of the moment the two others."""
    signs = {"x": [-1.0, 1.0, 1.0, 1.0, -1.0, -1.0], "y": [1.0, -1.0, 1.0, -1.0, 1.0, -1.0]}
    return like.new_tensor(signs[axis])


def _moments(wrench: Tensor, plate: Plate, factor: float) -> Tensor:
    """The stored moments scaled: about the transducer, or, of a file with centres of pressure, the free moment."""
    if factor == 1.0:
        return wrench
    if plate.corners is not None:
        scale = torch.cat([wrench.new_ones(3), wrench.new_full((3,), factor)])
        return from_plate(in_plate(wrench, plate) * scale, plate)
    force, moment = wrench[:, :3], wrench[:, 3:]
    acting = force[:, 2] != 0.0
    arm = torch.where(acting[:, None], torch.stack([-moment[:, 1], moment[:, 0], 0 * force[:, 2]], dim=1), 0.0)
    arm = arm / torch.where(acting, force[:, 2], 1.0)[:, None]
    lever = torch.linalg.cross(arm, force)
    return torch.cat([force, lever + factor * (moment - lever)], dim=1)


def _scaled(wrench: Tensor, plates: tuple[Plate, ...], file: ForcesAs) -> Tensor:
    each = [_moments(wrench[:, k], plate, file.moment_gain) for k, plate in enumerate(plates)]
    return torch.stack(each, dim=1) * file.gain


def _turned(wrench: Tensor, file: ForcesAs) -> Tensor:
    for _ in range(file.turn_deg // 90):
        fx, fy, fz, mx, my, mz = wrench.unbind(dim=-1)
        wrench = torch.stack([-fy, fx, fz, -my, mx, mz], dim=-1)
    return wrench if file.mirror is None else wrench * _reflection(file.mirror, wrench)


def _shifted(wrench: Tensor, samples: float) -> Tensor:
    """Samples (samples, 6) that were stamped so many samples late, on their right times; NaN where none are."""
    at = torch.arange(len(wrench), dtype=wrench.dtype, device=wrench.device) + samples
    low = at.floor().long()
    inside = (low >= 0) & (low + 1 < len(wrench))
    low = low.clamp(0, max(len(wrench) - 2, 0))
    share = (at - low)[:, None]
    moved = wrench[low] * (1.0 - share) + wrench[(low + 1).clamp_max(len(wrench) - 1)] * share
    return torch.where(inside[:, None], moved, torch.nan)


def turned_up(forces: Forces, file: ForcesAs, axis: str) -> Forces:
    """Forces of a file, in its own axes, in the axes of markers whose vertical is ``axis``.

    Where ``file.up`` names another vertical, they are turned by 90 degrees about X, which takes one into the other.
    """
    if file.up is None or file.up == axis:
        return forces
    times = 1 if axis == "z" else 3
    wrench, corners = forces.wrench, [plate.corners for plate in forces.plates]
    for _ in range(times):
        wrench = torch.cat([y_up_to_z_up(wrench[..., :3]), y_up_to_z_up(wrench[..., 3:])], dim=-1)
        corners = [None if c is None else y_up_to_z_up(c) for c in corners]
    plates = tuple(replace(p, corners=c) for p, c in zip(forces.plates, corners, strict=True))
    return Forces(forces.time, wrench, plates)
