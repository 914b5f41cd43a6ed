"""The geometry of contact: a foot that touches the ground beside the plates takes its frames out.

Nothing else does: what looks wrong in the forces themselves is left to the diagnosis, which judges raw samples.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.recording import Forces


@dataclass(frozen=True)
class ContactOptions:
    """What counts as standing, and as standing on a plate."""

    height_m: float = 0.03
    """A point of the sole touches within this height of the lowest it gets."""
    speed_m_s: float = 0.4
    """And below this speed."""
    loaded_n: float = 20.0
    """A plate is loaded above this vertical force."""
    margin_m: float = 0.03
    """A foot may stand over the edge of a plate by this much."""
    reach_m: float = 0.10
    """A centre of pressure belongs to a foot within this distance of its sole's axis."""
    shortest_s: float = 0.06
    """Shorter absences of a plate's reading are the plate's threshold, not a missing plate."""


@dataclass(frozen=True)
class Contact:
    """Support of one trial, on the clock of the markers."""

    feet: tuple[str, ...]
    touching: Bool[Tensor, "frames feet"]
    supported: Bool[Tensor, "frames feet"]
    """The foot's wrench is on plates (or the foot is in the air)."""
    plate: Int[Tensor, "frames plates"]
    """Foot that each plate carries; -1: none or unloaded, -2: more than one."""
    measured: Bool[Tensor, " frames"]
    """Frames whose total wrench is on plates."""
    used: Bool[Tensor, " frames"]
    """Those of them that the filter keeps clear of the others, and whose motion is known."""

    @property
    def excluded(self) -> int:
        """Number of frames taken out for a foot beside the plates."""
        return int((~self.supported.all(dim=1)).sum())


def find_contact(
    soles: dict[str, Float[Tensor, "frames points 3"]],
    forces: Forces,
    seen: Bool[Tensor, " frames"],
    rate_hz: float,
    spread_s: float,
    options: ContactOptions | None = None,
) -> Contact:
    """Judge every frame.

    Args:
        soles: points of the sole of each foot in W, the first at the heel and the last at the toes.
        forces: on the clock of the markers; NaN outside their overlap.
        seen: frames whose motion is known.
        rate_hz: frames per second.
        spread_s: how far the force filter carries a missing force into the frames beside it.
        options: thresholds.
    """
    options = options or ContactOptions()
    feet = tuple(soles)
    touching = torch.stack([_touching(p, rate_hz, options) for p in soles.values()], dim=1)
    measured = torch.isfinite(forces.wrench).all(dim=2).all(dim=1)
    near = _near(list(soles.values()), forces, options)
    supported = _supported(touching, near, list(soles.values()), forces, options)
    supported = ~_lasting(~supported, round(options.shortest_s * rate_hz))
    whole = measured & supported.all(dim=1)
    clean = ~_dilate(~whole, round(spread_s * rate_hz))
    return Contact(feet, touching, supported, _assign(near, touching), whole, clean & seen)


def _touching(points: Tensor, rate_hz: float, options: ContactOptions) -> Tensor:
    """A point of the sole is low and slow."""
    ground = points[..., 2].quantile(0.02, dim=0)
    speed = torch.zeros_like(points[..., 0])
    step = (points[1:] - points[:-1]).norm(dim=2) * rate_hz
    speed[1:-1] = 0.5 * (step[1:] + step[:-1])
    speed[0], speed[-1] = step[0], step[-1]
    return ((points[..., 2] - ground < options.height_m) & (speed < options.speed_m_s)).any(dim=1)


def _near(soles: list[Tensor], forces: Forces, options: ContactOptions) -> Tensor:
    """(frames, plates, feet): the plate's centre of pressure lies under the foot."""
    centre = forces.centre_of_pressure(options.loaded_n)
    distance = torch.stack([_to_axis(centre, points) for points in soles], dim=2)
    return torch.nan_to_num(distance, torch.inf) < options.reach_m


def _to_axis(centre: Tensor, points: Tensor) -> Tensor:
    """Horizontal distance of (frames, plates, 3) to the segment from heel to toes."""
    heel, toe = points[:, None, 0, :2], points[:, None, -1, :2]
    along = toe - heel
    share = (((centre[..., :2] - heel) * along).sum(-1) / along.square().sum(-1)).clamp(0.0, 1.0)
    return (centre[..., :2] - heel - share[..., None] * along).norm(dim=-1)


def _supported(
    touching: Tensor, near: Tensor, soles: list[Tensor], forces: Forces, options: ContactOptions
) -> Tensor:
    """Every touching foot stands inside a plate with known corners, or has a centre of pressure of its own or shared."""
    corners = [plate.corners for plate in forces.plates]
    if all(c is not None for c in corners) and corners:
        inside = [_inside(points, [c for c in corners if c is not None], options.margin_m) for points in soles]
        return ~touching | torch.stack(inside, dim=1)
    loaded = torch.isfinite(forces.centre_of_pressure(options.loaded_n)[..., 0])
    # A centre of pressure under no foot's sole alone lies between two feet that share the plate.
    shared = (loaded & ~near.any(dim=2)).any(dim=1)
    return ~touching | near.any(dim=1) | shared[:, None]


def _inside(points: Tensor, plates: list[Tensor], margin: float) -> Tensor:
    """All points of the sole that are near the ground lie over some plate (union of rectangles, widened)."""
    inside = torch.zeros(points.shape[:2], dtype=torch.bool, device=points.device)
    for corners in plates:
        origin = corners[0]
        for_all = torch.ones_like(inside)
        for side in (corners[1] - origin, corners[3] - origin):
            length = side.norm()
            along = (points - origin) @ (side / length)
            for_all &= (along > -margin) & (along < length + margin)
        inside |= for_all
    low = points[..., 2] - points[..., 2].quantile(0.02, dim=0) < 0.05
    return (inside | ~low).all(dim=1)


def _assign(near: Tensor, touching: Tensor) -> Tensor:
    under = near & touching[:, None]
    count = under.sum(dim=2)
    foot = torch.where(count == 1, under.to(torch.long).argmax(dim=2), -1)
    return torch.where(count > 1, -2, foot)


def _lasting(flag: Tensor, frames: int) -> Tensor:
    """Runs of True along the frames that last longer than ``frames``, or that an end of the trial cuts."""
    if frames < 1:
        return flag
    kept = flag.clone()
    for column in range(flag.shape[1]):
        edges = torch.diff(torch.nn.functional.pad(flag[:, column].long(), (1, 1)))
        starts, stops = (edges == 1).nonzero()[:, 0], (edges == -1).nonzero()[:, 0]
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
            if stop - start <= frames and 0 < start and stop < len(flag):
                kept[start:stop, column] = False
    return kept


def _dilate(flag: Tensor, frames: int) -> Tensor:
    if frames < 1 or not bool(flag.any()):
        return flag
    wide = torch.nn.functional.max_pool1d(flag.double()[None, None], 2 * frames + 1, stride=1, padding=frames)
    return wide[0, 0] > 0
