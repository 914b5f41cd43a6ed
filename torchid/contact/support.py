"""Which plate lies under which foot: soles against plates' corners and centres of pressure."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.options import ContactOptions
from torchid.recording import Forces

OVER_FLOOR_M = 0.05
"""Points of a touching foot this near the lowest that they get may bear, even if they do not touch by themselves."""


def near_plates(
    soles: list[Float[Tensor, "frames points 3"]], forces: Forces, options: ContactOptions
) -> Bool[Tensor, "frames plates feet"]:
    """The plate's centre of pressure lies under the foot."""
    centre = forces.centre_of_pressure(options.loaded_n)
    distance = torch.stack([_to_axis(centre, points) for points in soles], dim=2)
    return torch.nan_to_num(distance, torch.inf) < options.reach_m


def _to_axis(centre: Tensor, points: Tensor) -> Tensor:
    """Horizontal distance of (frames, plates, 3) to the segment from heel to toes."""
    heel, toe = points[:, None, 0, :2], points[:, None, -1, :2]
    along = toe - heel
    share = (((centre[..., :2] - heel) * along).sum(-1) / along.square().sum(-1)).clamp(0.0, 1.0)
    return (centre[..., :2] - heel - share[..., None] * along).norm(dim=-1)


def supported_feet(
    touching: Bool[Tensor, "frames feet"],
    near: Bool[Tensor, "frames plates feet"],
    soles: list[Float[Tensor, "frames points 3"]],
    down: list[Bool[Tensor, "frames points"]],
    forces: Forces,
    options: ContactOptions,
    short: Bool[Tensor, " frames"] | None = None,
) -> Bool[Tensor, "frames feet"]:
    """Every touching foot stands inside a plate with known corners, or has a centre of pressure, its own or shared.

    A foot that reaches over an edge may bear on the plate alone; where it is known whether a part of the weight is
    missing (``short``), that decides.
    """
    corners = [plate.corners for plate in forces.plates]
    if all(c is not None for c in corners) and corners:
        known = [c for c in corners if c is not None]
        over = [over_plates(p, known, options.margin_m) for p in soles]
        bears = [
            d | (p[..., 2] - p[..., 2].quantile(0.02, dim=0) < OVER_FLOOR_M) for p, d in zip(soles, down, strict=True)
        ]
        inside = torch.stack([(o | ~b).all(dim=1) for o, b in zip(over, bears, strict=True)], dim=1)
        if short is not None:
            inside |= (
                torch.stack([(o & d).any(dim=1) for o, d in zip(over, down, strict=True)], dim=1) & ~short[:, None]
            )
        return ~touching | inside
    loaded = torch.isfinite(forces.centre_of_pressure(options.loaded_n)[..., 0])
    # A centre of pressure under no foot's sole alone lies between two feet that share the plate.
    shared = (loaded & ~near.any(dim=2)).any(dim=1)
    return ~touching | near.any(dim=1) | shared[:, None]


def over_plates(
    points: Float[Tensor, "frames points 3"], plates: list[Float[Tensor, "4 3"]], margin: float
) -> Bool[Tensor, "frames points"]:
    """Return which points lie over some plate.

    Args:
        points: in W [m].
        plates: corners of each, in order around it [m].
        margin: that each plate is widened by on every side [m].
    """
    inside = torch.zeros(points.shape[:2], dtype=torch.bool, device=points.device)
    for corners in plates:
        origin = corners[0]
        for_all = torch.ones_like(inside)
        for side in (corners[1] - origin, corners[3] - origin):
            length = side.norm()
            along = (points - origin) @ (side / length)
            for_all &= (along > -margin) & (along < length + margin)
        inside |= for_all
    return inside


def over_each(
    soles: Mapping[str, Float[Tensor, "frames points 3"]], forces: Forces, margin_m: float
) -> tuple[Bool[Tensor, "frames plates feet"], Bool[Tensor, "frames plates feet"]]:
    """Return feet that are over a plate with some of the sole, and with all of it.

    A plate without corners may be anywhere: every foot is over it with some of its sole, and none with all.

    Args:
        soles: points of each foot in W [m].
        margin_m: by which a foot may stand over an edge.
    """
    shape = len(forces.time), len(forces.plates), len(soles)
    some = torch.ones(shape, dtype=torch.bool, device=forces.wrench.device)
    whole = torch.zeros_like(some)
    for p, plate in enumerate(forces.plates):
        if plate.corners is not None and soles:
            inside = [over_plates(sole, [plate.corners], margin_m) for sole in soles.values()]
            some[:, p] = torch.stack([one.any(dim=1) for one in inside], dim=1)
            whole[:, p] = torch.stack([one.all(dim=1) for one in inside], dim=1)
    return some, whole


def assign_plates(
    near: Bool[Tensor, "frames plates feet"],
    touching: Bool[Tensor, "frames feet"],
    loaded: Bool[Tensor, "frames plates"],
) -> Int[Tensor, "frames plates"]:
    """Of the feet over a loaded plate's centre of pressure the one that touches, or the only one (strike, push-off)."""
    standing = near & touching[:, None]
    under = torch.where(standing.any(dim=2, keepdim=True), standing, near)
    foot = torch.where(under.sum(dim=2) == 1, under.to(torch.long).argmax(dim=2), -2)
    return torch.where(loaded, foot, -1)
