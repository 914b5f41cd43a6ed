"""Which frames count: every foot that touches the ground is on a plate, and the plates bear the whole weight.

A foot beside the plates takes its frames out; so does another contact that no plate measures, and a lack of weight
where standing has told it. Nothing else does: what looks wrong in the forces themselves is left to the diagnosis, which
judges raw samples.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.options import ContactOptions
from torchid.contact.others import Others, assign_others, floor_plates
from torchid.contact.support import (
    assign_plates,
    belt_velocity,
    near_plates,
    over_each,
    point_speed,
    supported_feet,
    touching_points,
)
from torchid.recording import Forces
from torchid.runs import dilate, lasting


@dataclass(frozen=True)
class Contact:
    """Support of one trial, on the clock of the markers."""

    feet: tuple[str, ...]
    touching: Bool[Tensor, "frames feet"]
    supported: Bool[Tensor, "frames feet"]
    """The foot's wrench is on plates (or the foot is in the air)."""
    plate: Int[Tensor, "frames plates"]
    """Contact that each plate carries, feet first; -1: unloaded, -2: more than one, or none that can be told."""
    measured: Bool[Tensor, " frames"]
    """Frames whose total wrench is on plates."""
    used: Bool[Tensor, " frames"]
    """Those of them that the filter keeps clear of the others, and whose motion is known."""
    belt: Float[Tensor, "feet 2"]
    """Horizontal velocity of the ground under each foot [m/s], zero where nothing moves: a treadmill's belts."""
    lacking: Bool[Tensor, " frames"] | None = None
    """Frames in which the plates miss a part of the weight; None where it is not known."""
    others: Others | None = None
    """Contacts other than feet; None where the config names none."""
    floor: tuple[int, ...] | None = None
    """Plates on which feet may stand, whose load is shared as one; None for all."""

    def frames(self, part: slice) -> "Contact":
        """Some of the frames."""
        some = {name: getattr(self, name)[part] for name in ("touching", "supported", "plate", "measured", "used")}
        lacking = None if self.lacking is None else self.lacking[part]
        others = None if self.others is None else self.others.frames(part)
        return replace(self, **some, lacking=lacking, others=others)

    @property
    def contacts(self) -> tuple[str, ...]:
        """Names of all contacts, feet first; those of feet are their bodies'."""
        return self.feet if self.others is None else (*self.feet, *self.others.names)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Body of every contact."""
        return self.feet if self.others is None else (*self.feet, *self.others.bodies)

    @property
    def bearing(self) -> Bool[Tensor, "frames contacts"]:
        """Which contacts touch or bear."""
        return self.touching if self.others is None else torch.cat([self.touching, self.others.bearing], dim=1)

    @property
    def beside(self) -> Bool[Tensor, "frames contacts"]:
        """Contacts that bear where no plate is."""
        feet = self.touching & ~self.supported
        if self.others is None:
            return feet
        free = torch.tensor([k < 0 for k in self.others.column], device=feet.device)
        return torch.cat([feet, self.others.bearing & free], dim=1)

    @property
    def untold(self) -> Bool[Tensor, "frames contacts"]:
        """Contacts that bear while a plate that they may be on does not tell whose its load is."""
        vague = self.plate == -2
        floor = vague if self.floor is None else vague[:, list(self.floor)]
        feet = self.touching & floor.any(dim=1, keepdim=True)
        if self.others is None:
            return feet
        own = torch.zeros_like(self.others.bearing)
        for k, p in enumerate(self.others.column):
            if p >= 0:
                own[:, k] = self.others.bearing[:, k] & vague[:, p]
        return torch.cat([feet, own], dim=1)

    @property
    def unmeasured(self) -> Bool[Tensor, " frames"]:
        """Frames in which a contact other than a foot bears that no plate measures."""
        nowhere = torch.zeros_like(self.measured)
        return nowhere if self.others is None else self.others.unmeasured

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
        if self.lacking is None:
            return 0
        return int((self.supported.all(dim=1) & self.lacking & ~self.unmeasured).sum())


def find_contact(
    soles: dict[str, Float[Tensor, "frames points 3"]],
    forces: Forces,
    seen: Bool[Tensor, " frames"],
    rate_hz: float,
    spread_s: float,
    options: ContactOptions | None = None,
    short: Bool[Tensor, " frames"] | None = None,
    others: Others | None = None,
) -> Contact:
    """Judge every frame.

    Args:
        soles: points of the sole of each foot in W, the first at the heel and the last at the tip of the toes.
        forces: on the clock of the markers; NaN outside their overlap.
        seen: frames whose motion is known.
        spread_s: how far the force filter carries a missing force into the frames beside it.
        short: frames in which the plates miss a part of the weight (``standing.falls_short``), where that is known.
        others: contacts other than feet.
    """
    options = options or ContactOptions()
    feet = tuple(soles)
    known = torch.isfinite(forces.wrench).all(dim=2).all(dim=1)
    if others is not None:
        known = known & ~others.unmeasured
    whole = known if short is None else known & ~short
    margin = round(spread_s * rate_hz)
    if not feet:
        return _footless(whole, forces, seen, margin, short, others)
    floor = floor_plates(soles, forces, others, options.margin_m)
    ground = forces.of(floor)
    lacking = short if short is None or others is None else short & ~others.bearing.any(dim=1)
    belt, touching, supported, own = _on_ground(soles, ground, rate_hz, options, lacking)
    plate = own.new_full((len(own), len(forces.plates)), -1)
    plate[:, list(floor)] = own
    if others is not None:
        over = over_each(soles, forces, options.margin_m)[0] & touching[:, None]
        over[:, [p for p in range(len(forces.plates)) if p not in floor]] = False
        plate = assign_others(plate, others, len(feet), over)
    whole = whole & supported.all(dim=1)
    used = ~dilate(~whole, margin) & seen
    return Contact(feet, touching, supported, plate, whole, used, belt, short, others, floor)


def _on_ground(
    soles: dict[str, Tensor], ground: Forces, rate_hz: float, options: ContactOptions, short: Tensor | None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Velocity of the ground under each foot, which feet touch and which are supported, and the foot on each plate."""
    points = list(soles.values())
    near = near_plates(points, ground, options)
    # Without plates every low sole is taken to bear, which tells a belt from a floor all the same.
    bears = near.any(dim=1) if ground.plates else torch.ones_like(near.any(dim=1))
    belt = torch.stack([belt_velocity(p, bears[:, k], rate_hz, options) for k, p in enumerate(points)])
    speed = [point_speed(p, v, rate_hz) for p, v in zip(points, belt, strict=True)]
    down = [
        touching_points(p, v, bears[:, k], rate_hz, options) for k, (p, v) in enumerate(zip(points, speed, strict=True))
    ]
    touching = torch.stack([each.any(dim=1) for each in down], dim=1)
    supported = supported_feet(touching, near, points, down, ground, options, short)
    supported = ~lasting(~supported, round(options.shortest_s * rate_hz))
    loaded = torch.isfinite(ground.centre_of_pressure(options.loaded_n)[..., 0])
    return belt, touching, supported, assign_plates(near, touching, loaded)


def _footless(
    whole: Tensor, forces: Forces, seen: Tensor, spread: int, short: Tensor | None, others: Others | None
) -> Contact:
    """A model without soles: every measured frame is taken at its word."""
    none = whole.new_zeros(len(whole), 0)
    plate = torch.full(forces.wrench.shape[:2], -1, device=whole.device)
    if others is not None:
        plate = assign_others(plate, others, 0, whole.new_zeros(*plate.shape, 0))
    belt, used = forces.wrench.new_zeros(0, 2), ~dilate(~whole, spread) & seen
    return Contact((), none, none, plate, whole, used, belt, short, others, None if others is None else ())
