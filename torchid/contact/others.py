"""Contacts that are no feet, frame by frame: which of them bear, and which plate measures them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.options import ContactOptions, NearPlace, OtherContact
from torchid.contact.support import LOWEST, OVER_FLOOR_M, REST, over_plates
from torchid.io.mend import number_of
from torchid.recording import Forces, Plate
from torchid.runs import runs


@dataclass(frozen=True)
class Others:
    """Contacts other than feet in one trial."""

    names: tuple[str, ...]
    bodies: tuple[str, ...]
    """Segment of each."""
    bearing: Bool[Tensor, "frames others"]
    column: tuple[int, ...]
    """Index of the plate that measures each, -1 for none."""

    @property
    def unmeasured(self) -> Bool[Tensor, " frames"]:
        """Frames in which one bears that no plate measures."""
        free = [k for k, plate in enumerate(self.column) if plate < 0]
        return self.bearing[:, free].any(dim=1)

    @property
    def beside_plates(self) -> tuple[str, ...]:
        """Names of those that bear in some frame and that no plate measures."""
        bears = self.bearing.any(dim=0).tolist()
        return tuple(n for n, k, some in zip(self.names, self.column, bears, strict=True) if k < 0 and some)

    def frames(self, part: slice) -> "Others":
        """Some of the frames."""
        return Others(self.names, self.bodies, self.bearing[part], self.column)


def find_others(
    options: ContactOptions,
    middles: Mapping[str, Float[Tensor, "frames 3"]],
    trial: str,
    time: Float[Tensor, " frames"],
    forces: Forces | None,
) -> Others | None:
    """Tell when the contacts of a trial bear; None where the options name none.

    Args:
        middles: middle of each contact's points in W [m].
        time: of the frames [s].
        forces: on the clock of the frames; None where nothing was measured.
    """
    if not options.others:
        return None
    column = tuple(plate_of(one, forces) for one in options.others.values())
    bearing = [
        _bears(one, middles[name], trial, time, forces, k, options.loaded_n)
        for (name, one), k in zip(options.others.items(), column, strict=True)
    ]
    bodies = tuple(one.segment for one in options.others.values())
    return Others(tuple(options.others), bodies, torch.stack(bearing, dim=1), column)


def plate_of(one: OtherContact, forces: Forces | None) -> int:
    """Return the index of the plate that measures a contact, -1 where the trial has none."""
    numbers = [] if forces is None else [number_of(plate, k) for k, plate in enumerate(forces.plates)]
    return numbers.index(one.plate) if one.plate in numbers else -1


def _bears(
    one: OtherContact, middle: Tensor, trial: str, time: Tensor, forces: Forces | None, column: int, loaded_n: float
) -> Bool[Tensor, " frames"]:
    if isinstance(one.when, dict):
        return inside(one.when.get(trial, ()), time)
    if isinstance(one.when, NearPlace):
        near = (middle - middle.new_tensor(one.when.at_m)).norm(dim=1) < one.when.within_m
        shortest = REST[1] / float(time[1] - time[0]) if len(time) > 1 else 0.0
        found = torch.zeros_like(near)
        for start, stop in runs(near):
            found[start:stop] = stop - start > shortest  # a hand that passes the place is no contact
        return found
    if one.when == "always":
        return torch.ones_like(time, dtype=torch.bool)
    if forces is None or column < 0:
        return torch.zeros_like(time, dtype=torch.bool)
    return torch.nan_to_num(forces.wrench[:, column, :3]).norm(dim=1) > loaded_n


def inside(parts: tuple[tuple[float, float], ...], time: Float[Tensor, " frames"]) -> Bool[Tensor, " frames"]:
    """Return frames within some interval.

    Args:
        parts: begin and end of each [s].
        time: of the frames [s].
    """
    found = torch.zeros_like(time, dtype=torch.bool)
    for t0, t1 in parts:
        found |= (time >= t0) & (time <= t1)
    return found


def floor_plates(
    soles: Mapping[str, Float[Tensor, "frames points 3"]], forces: Forces, others: Others | None, margin_m: float
) -> tuple[int, ...]:
    """Return the plates on which feet may stand: a seat's or a handle's only if a sole comes to lie on it.

    Args:
        soles: points of each foot in W [m].
        others: contacts that name plates.
        margin_m: by which a foot may stand over an edge.
    """
    named = set() if others is None else set(others.column)
    return tuple(
        p for p, plate in enumerate(forces.plates)
        if p not in named or any(_comes_to_lie(sole, plate, margin_m) for sole in soles.values())
    )  # fmt: skip


def _comes_to_lie(sole: Tensor, plate: Plate, margin_m: float) -> bool:
    """Whether a sole is over a plate at its height; nobody knows where a plate without corners is."""
    if plate.corners is None:
        return False
    lowest = sole[..., 2].amin(dim=1).quantile(LOWEST)
    at_height = abs(float(lowest - plate.corners[:, 2].mean())) < OVER_FLOOR_M
    return at_height and bool(over_plates(sole, [plate.corners], margin_m).any())


def assign_others(
    plate: Int[Tensor, "frames plates"], others: Others, feet: int, on: Bool[Tensor, "frames plates feet"]
) -> Int[Tensor, "frames plates"]:
    """Return which contact each plate carries, contacts other than feet counted behind the feet.

    A plate that one of them has for itself carries it in all frames: what it reads is on that segment.

    Args:
        plate: foot that each plate carries, as of ``Contact.plate``.
        on: feet that touch over each plate.
    """
    found = plate.clone()
    for p in sorted({k for k in others.column if k >= 0}):
        own = [k for k, column in enumerate(others.column) if column == p]
        bearing, standing = others.bearing[:, own], on[:, p].any(dim=1)
        if len(own) == 1 and not bool(on[:, p].any()):
            found[:, p] = feet + own[0]
            continue
        alone = (bearing.sum(dim=1) == 1) & ~standing
        which = feet + torch.tensor(own, device=plate.device)[bearing.long().argmax(dim=1)]
        found[:, p] = torch.where(alone, which, torch.where(bearing.any(dim=1), -2, found[:, p]))
    return found


def feet_alone(options: ContactOptions, trial: str, forces: Forces) -> Forces | None:
    """Return forces as far as feet must answer for them: without plates of other contacts, and without the frames in
    which one is known to bear that no plate measures; None where nothing is left.
    """
    named = {plate_of(one, forces) for one in options.others.values()}
    kept = [p for p in range(len(forces.plates)) if p not in named]
    if not kept:
        return None
    left = forces.of(kept)
    wrench = left.wrench  # a copy already
    for one in options.others.values():
        if plate_of(one, forces) < 0 and one.when == "always":
            return None
        if plate_of(one, forces) < 0 and isinstance(one.when, dict):
            wrench[inside(one.when.get(trial, ()), forces.time)] = torch.nan
    if not bool(torch.isfinite(wrench).any()):
        return None
    return replace(left, wrench=wrench)
