"""Which points of a sole touch the ground, and which plate lies under which foot.

Soles touch where they are low, and slow as seen from the ground, or rest on a box; both are taken from the subject's
own stances: a point is low near the height that it has while its foot bears a plate, be it above the lowest that it
ever gets (a sprinter's toes in swing), and the ground moves where both feet do. Plates are told by corners and
centres of pressure.
"""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.options import ContactOptions
from torchid.recording import Forces
from torchid.runs import lasting, runs

REST = 0.05, 0.2
"""A foot above the ground rests on something, such as a box, when it is flat and slower than this [m/s] for that long
[s]. A foot held in the air is neither: in 12 s of leg circles none is found."""
LOWEST = 0.02
"""Share of the frames in which a point is as low as it is said to get."""
STEADY = 0.25
"""A belt moves a loaded foot with speeds within this share of their median most of the time; a foot that swings
past the other's pressure does not."""
BELT_S = 0.25
"""And for this long in all [s]; a swinging foot passes a pressure in a tenth of a second."""


def low_points(
    points: Float[Tensor, "frames points 3"], bearing: Bool[Tensor, "frames points"], options: ContactOptions
) -> Bool[Tensor, "frames points"]:
    """Points within reach of the ground.

    Args:
        points: of one sole in W.
        bearing: points that stand still while their foot bears a plate.
    """
    height = points[..., 2]
    stance = torch.where(bearing, height, torch.nan).nanquantile(0.5, dim=0)
    level = torch.maximum(height.quantile(LOWEST, dim=0), stance.nan_to_num(-torch.inf))
    return height < level + options.height_m


def belt_velocity(
    points: Float[Tensor, "frames points 3"], loaded: Bool[Tensor, " frames"], rate_hz: float, options: ContactOptions
) -> Float[Tensor, " 2"]:
    """Velocity of the ground: the median of the sole's low points while a plate is loaded under it.

    It is zero where it is slower than half the speed at which a point still counts as standing, which is a foot that
    rolls, and where it is not steady, which is a foot that swings past.
    """
    velocity = torch.diff(points[..., :2], dim=0) * rate_hz
    low = points[..., 2] - points[..., 2].quantile(LOWEST, dim=0) < options.height_m
    down = low & loaded[:, None]
    held = velocity[down[1:] & down[:-1]]
    if not len(held):
        return points.new_zeros(2)
    median = held.median(dim=0).values
    steady = ((held - median).norm(dim=1) < STEADY * median.norm()).double().mean()
    seconds = (down[1:] & down[:-1]).any(dim=1).sum() / rate_hz
    fast = float(median.norm()) > 0.5 * options.speed_m_s
    return median if fast and float(steady) > 0.5 and float(seconds) > BELT_S else torch.zeros_like(median)


def point_speed(
    points: Float[Tensor, "frames points 3"], belt: Float[Tensor, " 2"], rate_hz: float
) -> Float[Tensor, "frames points"]:
    """Speed of each point as seen from the ground [m/s]."""
    speed = torch.zeros_like(points[..., 0])
    step = (torch.diff(points, dim=0) * rate_hz - torch.nn.functional.pad(belt, (0, 1))).norm(dim=2)
    speed[1:-1] = 0.5 * (step[1:] + step[:-1])
    speed[0], speed[-1] = step[0], step[-1]
    return speed


def touching_points(
    points: Float[Tensor, "frames points 3"],
    speed: Float[Tensor, "frames points"],
    loaded: Bool[Tensor, " frames"],
    rate_hz: float,
    options: ContactOptions,
) -> Bool[Tensor, "frames points"]:
    """Low, and slow until it leaves; or still where it rested on a box.

    Args:
        points: of one sole in W.
        speed: as seen from the ground [m/s].
        loaded: frames in which the foot bears a plate.
    """
    slow = speed < options.speed_m_s
    low = low_points(points, slow & loaded[:, None], options)
    return _held(low & slow, low & (speed < options.leaving_m_s)) | _raised(points, speed, rate_hz, options)


def _held(down: Tensor, near: Tensor) -> Tensor:
    """(frames, points): from each frame that is down for as long as the frames behind it are near."""
    time = torch.arange(len(down), device=down.device)[:, None]
    last, away = (torch.where(flag, time, -1).cummax(dim=0).values for flag in (down, ~near))
    return last > away


def _raised(points: Tensor, speed: Tensor, rate_hz: float, options: ContactOptions) -> Tensor:
    """(frames, points): on something above the ground, from before a rest until the sole leaves that height.

    A foot rolls off a box as fast as it likes, so that no speed ends the contact.
    """
    over = points[..., 2] - points[..., 2].quantile(LOWEST, dim=0)
    flat = over.amax(dim=1) - over.amin(dim=1) < options.height_m
    rests = (speed < REST[0]).all(dim=1) & flat & (over.amin(dim=1) > options.height_m)
    found = torch.zeros_like(over, dtype=torch.bool)
    for start, stop in runs(lasting(rests[:, None], round(REST[1] * rate_hz))[:, 0]):
        level = points[start:stop, :, 2].median(dim=0).values
        on = (points[..., 2] - level).abs() < options.height_m
        for first, last in runs(on.any(dim=1)):
            if first < stop and start < last:
                found[first:last] |= on[first:last]
    return found


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
