"""When a sole touches the ground, from its motion: low, and slow as seen from the ground, or resting on a box.

Low and slow are taken from the subject's own stances: a point is low near the height that it has while its foot bears a
plate, be it above the lowest that it ever gets (a sprinter's toes in swing), and the ground moves where both feet do.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.options import ContactOptions
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
