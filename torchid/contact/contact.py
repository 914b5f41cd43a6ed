"""The geometry of contact: a foot that touches the ground beside the plates takes its frames out.

Nothing else does: what looks wrong in the forces themselves is left to the diagnosis, which judges raw samples.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.options import ContactOptions
from torchid.recording import Forces

REST = 0.05, 0.2
"""A foot above the ground rests on something, such as a box, when it is flat and slower than this [m/s] for that long
[s]. A foot held in the air is neither: in 12 s of leg circles none is found."""


@dataclass(frozen=True)
class Contact:
    """Support of one trial, on the clock of the markers."""

    feet: tuple[str, ...]
    touching: Bool[Tensor, "frames feet"]
    supported: Bool[Tensor, "frames feet"]
    """The foot's wrench is on plates (or the foot is in the air)."""
    plate: Int[Tensor, "frames plates"]
    """Foot that each plate carries; -1: unloaded, -2: more than one, or none that can be told."""
    measured: Bool[Tensor, " frames"]
    """Frames whose total wrench is on plates."""
    used: Bool[Tensor, " frames"]
    """Those of them that the filter keeps clear of the others, and whose motion is known."""
    belt: Float[Tensor, "feet 2"]
    """Horizontal velocity of the ground under each foot [m/s], zero where nothing moves: a treadmill's belts."""

    def frames(self, part: slice) -> "Contact":
        """Some of the frames."""
        touching, supported, plate = self.touching[part], self.supported[part], self.plate[part]
        return Contact(self.feet, touching, supported, plate, self.measured[part], self.used[part], self.belt)

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
    measured = torch.isfinite(forces.wrench).all(dim=2).all(dim=1)
    if not feet:
        return _footless(measured, forces, seen, round(spread_s * rate_hz))
    near = _near(list(soles.values()), forces, options)
    belt = torch.stack([_belt(p, near[..., k].any(dim=1), rate_hz, options) for k, p in enumerate(soles.values())])
    pairs = zip(soles.values(), belt, strict=True)
    down = [_touching(points, v, rate_hz, options) for points, v in pairs]
    touching = torch.stack([points.any(dim=1) for points in down], dim=1)
    supported = _supported(touching, near, list(soles.values()), down, forces, options)
    supported = ~_lasting(~supported, round(options.shortest_s * rate_hz))
    whole = measured & supported.all(dim=1)
    clean = ~_dilate(~whole, round(spread_s * rate_hz))
    loaded = torch.isfinite(forces.centre_of_pressure(options.loaded_n)[..., 0])
    return Contact(feet, touching, supported, _assign(near, touching, loaded), whole, clean & seen, belt)


def _footless(measured: Tensor, forces: Forces, seen: Tensor, spread: int) -> Contact:
    """A model without soles: every measured frame is taken at its word."""
    none = measured.new_zeros(len(measured), 0)
    plate = torch.full(forces.wrench.shape[:2], -1, device=measured.device)
    belt = forces.wrench.new_zeros(0, 2)
    return Contact((), none, none, plate, measured, ~_dilate(~measured, spread) & seen, belt)


def _low(points: Tensor, options: ContactOptions) -> Tensor:
    """(frames, points): within reach of the ground, taken from the lowest that each point gets."""
    return points[..., 2] - points[..., 2].quantile(0.02, dim=0) < options.height_m


def _belt(points: Tensor, loaded: Tensor, rate_hz: float, options: ContactOptions) -> Tensor:
    """Velocity of the ground (2): the median of the sole's low points while a plate is loaded under it.

    Slower than half the speed at which a point still counts as standing, it is that of a foot that rolls: zero.
    """
    velocity = torch.diff(points[..., :2], dim=0) * rate_hz
    down = _low(points, options) & loaded[:, None]
    held = velocity[down[1:] & down[:-1]]
    median = held.median(dim=0).values if len(held) else points.new_zeros(2)
    return torch.where(median.norm() > 0.5 * options.speed_m_s, median, 0.0)


def _touching(points: Tensor, belt: Tensor, rate_hz: float, options: ContactOptions) -> Tensor:
    """(frames, points): low, and slow as seen from the ground until it leaves; or still where it rested on a box."""
    speed = torch.zeros_like(points[..., 0])
    step = (torch.diff(points, dim=0) * rate_hz - torch.nn.functional.pad(belt, (0, 1))).norm(dim=2)
    speed[1:-1] = 0.5 * (step[1:] + step[:-1])
    speed[0], speed[-1] = step[0], step[-1]
    low = _low(points, options)
    down = low & (speed < options.speed_m_s)
    return _held(down, low & (speed < options.leaving_m_s)) | _raised(points, speed, rate_hz, options)


def _held(down: Tensor, near: Tensor) -> Tensor:
    """(frames, points): from each frame that is down for as long as the frames behind it are near."""
    time = torch.arange(len(down), device=down.device)[:, None]
    last, away = (torch.where(flag, time, -1).cummax(dim=0).values for flag in (down, ~near))
    return last > away


def _raised(points: Tensor, speed: Tensor, rate_hz: float, options: ContactOptions) -> Tensor:
    """(frames, points): on something above the ground, from before a rest until the sole leaves that height.

    A foot rolls off a box as fast as it likes, so that no speed ends the contact.
    """
    over = points[..., 2] - points[..., 2].quantile(0.02, dim=0)
    flat = over.amax(dim=1) - over.amin(dim=1) < options.height_m
    rests = (speed < REST[0]).all(dim=1) & flat & (over.amin(dim=1) > options.height_m)
    found = torch.zeros_like(over, dtype=torch.bool)
    for start, stop in _runs(_lasting(rests[:, None], round(REST[1] * rate_hz))[:, 0]):
        level = points[start:stop, :, 2].median(dim=0).values
        on = (points[..., 2] - level).abs() < options.height_m
        for first, last in _runs(on.any(dim=1)):
            if first < stop and start < last:
                found[first:last] |= on[first:last]
    return found


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
    touching: Tensor, near: Tensor, soles: list[Tensor], down: list[Tensor], forces: Forces, options: ContactOptions
) -> Tensor:
    """Every touching foot stands inside a plate with known corners, or has a centre of pressure, its own or shared."""
    corners = [plate.corners for plate in forces.plates]
    if all(c is not None for c in corners) and corners:
        known = [c for c in corners if c is not None]
        inside = [_inside(p, d, known, options.margin_m) for p, d in zip(soles, down, strict=True)]
        return ~touching | torch.stack(inside, dim=1)
    loaded = torch.isfinite(forces.centre_of_pressure(options.loaded_n)[..., 0])
    # A centre of pressure under no foot's sole alone lies between two feet that share the plate.
    shared = (loaded & ~near.any(dim=2)).any(dim=1)
    return ~touching | near.any(dim=1) | shared[:, None]


def _inside(points: Tensor, down: Tensor, plates: list[Tensor], margin: float) -> Tensor:
    """All points of the sole that are near the ground, or down, lie over some plate (union of widened rectangles)."""
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
    return (inside | ~(low | down)).all(dim=1)


def _assign(near: Tensor, touching: Tensor, loaded: Tensor) -> Tensor:
    """Of the feet over a loaded plate's centre of pressure the one that touches, or the only one (strike, push-off)."""
    standing = near & touching[:, None]
    under = torch.where(standing.any(dim=2, keepdim=True), standing, near)
    foot = torch.where(under.sum(dim=2) == 1, under.to(torch.long).argmax(dim=2), -2)
    return torch.where(loaded, foot, -1)


def _lasting(flag: Tensor, frames: int) -> Tensor:
    """Runs of True along the frames that last longer than ``frames``, or that an end of the trial cuts."""
    if frames < 1:
        return flag
    kept = flag.clone()
    for column in range(flag.shape[1]):
        for start, stop in _runs(flag[:, column]):
            if stop - start <= frames and 0 < start and stop < len(flag):
                kept[start:stop, column] = False
    return kept


def _runs(flag: Tensor) -> list[tuple[int, int]]:
    """Start and end (exclusive) of every run of True."""
    edges = torch.diff(torch.nn.functional.pad(flag.long(), (1, 1)))
    return list(zip(*((edges == sign).nonzero()[:, 0].tolist() for sign in (1, -1)), strict=True))


def _dilate(flag: Tensor, frames: int) -> Tensor:
    if frames < 1 or not bool(flag.any()):
        return flag
    wide = torch.nn.functional.max_pool1d(flag.double()[None, None], 2 * frames + 1, stride=1, padding=frames)
    return wide[0, 0] > 0
