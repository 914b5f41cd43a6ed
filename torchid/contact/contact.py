"""Which frames count: every foot that touches the ground is on a plate, and the plates bear the whole weight.

A foot beside the plates takes its frames out; so does a lack of weight where standing has told it. Nothing else does:
what looks wrong in the forces themselves is left to the diagnosis, which judges raw samples.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.options import ContactOptions
from torchid.contact.runs import dilate, lasting
from torchid.contact.support import assign_plates, near_plates, supported_feet
from torchid.contact.touching import belt_velocity, point_speed, touching_points
from torchid.recording import Forces


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
    lacking: Bool[Tensor, " frames"] | None = None
    """Frames in which the plates miss a part of the weight; None where it is not known."""

    def frames(self, part: slice) -> "Contact":
        """Some of the frames."""
        touching, supported, plate = self.touching[part], self.supported[part], self.plate[part]
        lacking = None if self.lacking is None else self.lacking[part]
        return Contact(self.feet, touching, supported, plate, self.measured[part], self.used[part], self.belt, lacking)

    @property
    def excluded(self) -> int:
        """Number of frames taken out for a foot beside the plates."""
        return int((~self.supported.all(dim=1)).sum())

    @property
    def unread(self) -> Bool[Tensor, "frames feet"]:
        """Feet that stand on plates, none of which reads them."""
        feet = torch.arange(len(self.feet), device=self.plate.device)
        read = (self.plate[..., None] == feet).any(dim=1) | (self.plate == -2).any(dim=1, keepdim=True)
        return self.touching & self.supported & ~read

    @property
    def short(self) -> int:
        """Number of frames taken out for a lack of weight alone."""
        return 0 if self.lacking is None else int((self.supported.all(dim=1) & self.lacking).sum())


def find_contact(
    soles: dict[str, Float[Tensor, "frames points 3"]],
    forces: Forces,
    seen: Bool[Tensor, " frames"],
    rate_hz: float,
    spread_s: float,
    options: ContactOptions | None = None,
    short: Bool[Tensor, " frames"] | None = None,
) -> Contact:
    """Judge every frame.

    Args:
        soles: points of the sole of each foot in W, the first at the heel and the last at the tip of the toes.
        forces: on the clock of the markers; NaN outside their overlap.
        seen: frames whose motion is known.
        rate_hz: frames per second.
        spread_s: how far the force filter carries a missing force into the frames beside it.
        options: thresholds.
        short: frames in which the plates miss a part of the weight (``balance.falls_short``), where that is known.
    """
    options = options or ContactOptions()
    feet = tuple(soles)
    known = torch.isfinite(forces.wrench).all(dim=2).all(dim=1)
    whole = known if short is None else known & ~short
    if not feet:
        return _footless(whole, forces, seen, round(spread_s * rate_hz), short)
    points = list(soles.values())
    near = near_plates(points, forces, options)
    # Without plates every low sole is taken to bear, which tells a belt from a floor all the same.
    bears = near.any(dim=1) if forces.plates else torch.ones_like(near.any(dim=1))
    belt = torch.stack([belt_velocity(p, bears[:, k], rate_hz, options) for k, p in enumerate(points)])
    speed = [point_speed(p, v, rate_hz) for p, v in zip(points, belt, strict=True)]
    down = [
        touching_points(p, v, bears[:, k], rate_hz, options) for k, (p, v) in enumerate(zip(points, speed, strict=True))
    ]
    touching = torch.stack([each.any(dim=1) for each in down], dim=1)
    supported = supported_feet(touching, near, points, down, forces, options, short)
    supported = ~lasting(~supported, round(options.shortest_s * rate_hz))
    whole = whole & supported.all(dim=1)
    clean = ~dilate(~whole, round(spread_s * rate_hz))
    loaded = torch.isfinite(forces.centre_of_pressure(options.loaded_n)[..., 0])
    return Contact(feet, touching, supported, assign_plates(near, touching, loaded), whole, clean & seen, belt, short)


def _footless(whole: Tensor, forces: Forces, seen: Tensor, spread: int, short: Tensor | None) -> Contact:
    """A model without soles: every measured frame is taken at its word."""
    none = whole.new_zeros(len(whole), 0)
    plate = torch.full(forces.wrench.shape[:2], -1, device=whole.device)
    belt = forces.wrench.new_zeros(0, 2)
    return Contact((), none, none, plate, whole, ~dilate(~whole, spread) & seen, belt, short)
