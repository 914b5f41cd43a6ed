"""How well the readings of a plate agree with the feet: pressure under a sole, forces that aim at the body, a foot that
stands still while it is loaded, and a free moment that a foot can give."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.checks.plates_against_feet.feet import Feet
from torchid.conventions import SAMPLE_LOADED_N

PRESSURE_M = 0.015
"""Usual distance of a centre of pressure from the nearest line between two markers of a foot: medians of 52 public
recordings are 0 to 22 mm, one of 48 mm apart."""
AIM_M = 0.08
"""Usual distance of a single foot's force line from the middle of the markers, at its height: 20 to 150 mm there."""
SLIP_M_S, SLIP_OF_BELT = 0.1, 0.1
"""Usual speed of the slowest marker of a loaded foot [m/s], and share of a treadmill's speed: 0.01 to 0.11 walking,
0.12 of the belt's speed running."""
FREE_M = 0.012
"""Usual free moment over vertical force [m]: the largest 5 % are at 2 to 42 mm there."""
PRESSURE_MOST_M, AIM_MOST_M, FREE_MOST_M = 0.07, 0.22, 0.06
"""What a foot can do: no recording of 52 goes beyond 48, 151 and 42 mm; 20 mm are 30 N m under a runner's 1500 N."""
ALONE = 0.8
"""Share of all vertical force from which on a plate bears the body alone."""
MOSTLY_ALONE = 0.2
"""Of a plate's loaded frames: a walk is on one foot for most of a stance, a landing only while it tips over."""
STANDS_M_S = 0.3
"""A foot slower than this stands; the pressure of one plate may lie anywhere between two feet that do."""
BELT_M_S = 0.3
"""Median speed of a loaded foot above which the ground is a moving belt."""
UNLOADED = 6.0
"""Disagreement of a frame that another reading of the plate shows loaded and this one does not: that of two witnesses
at four times their usual values, more than a right reading has and less than a wrong one."""


@dataclass(frozen=True)
class Evidence:
    """Witnesses of several readings of one plate, medians over its loaded frames weighted by force; NaN: no load."""

    pressure: Float[Tensor, " readings"]
    """Distance of the centre of pressure from the nearest foot [m]."""
    aim: Float[Tensor, " readings"]
    """Distance of the force's line from the middle of the body [m]."""
    slip: Float[Tensor, " readings"]
    """Speed of the loaded foot against the ground [m/s]."""
    free: Float[Tensor, " readings"]
    """Free moment over vertical force [m], 95 % quantile."""
    belt: Float[Tensor, " readings"]
    """Speed of the ground [m/s]."""
    loaded: Float[Tensor, " readings"]
    """Share of the frames that are loaded."""
    gain: Float[Tensor, " readings"]
    """How much better than the first reading: mean difference, over the frames that either shows loaded, of the sum of
    log(1 + (witness / usual)^2), as of Cauchy errors."""


@dataclass(frozen=True)
class FrameWitnesses:
    """Witnesses of several readings of one plate, frame by frame."""

    loaded: Bool[Tensor, "readings n"]
    weight: Float[Tensor, "readings n"]
    """Vertical force [N]; 0 without load."""
    pressure: Float[Tensor, "readings n"]
    """Distance of the centre of pressure from the nearest foot [m]."""
    aim: Float[Tensor, "readings n"]
    """Distance of the force's line from the middle of the body [m]; NaN where others bear the body too."""
    slip: Float[Tensor, "readings n"]
    """Speed of the loaded foot against the ground [m/s]."""
    free: Float[Tensor, "readings n"]
    """Free moment over vertical force [m]."""
    belt: Float[Tensor, " readings"]
    """Speed of the ground [m/s]."""


def gather(
    feet: Feet, wrench: Float[Tensor, "readings n 6"], height: float, others: Float[Tensor, " n"] | None = None
) -> Evidence:
    """Witnesses of one plate under several readings of it, in frames in which all feet are seen.

    Args:
        feet: at the n frames.
        wrench: on the subject about the origin of W [N, N m]; the first reading is the one to compare with.
        height: of the plate's surface in W [m].
        others: vertical force that the other plates bear, without sign [N]: only who stands on one plate alone has its
            force aim at the body.
    """
    return _summary(by_frame(feet, wrench, height, others))


def by_frame(
    feet: Feet, wrench: Float[Tensor, "readings n 6"], height: float, others: Float[Tensor, " n"] | None = None
) -> FrameWitnesses:
    """The same before any mean over frames; arguments as of ``gather``."""
    force, moment = wrench[..., :3].nan_to_num(), wrench[..., 3:].nan_to_num()
    loaded = (force[..., 2] > SAMPLE_LOADED_N) & feet.seen
    fz, centre = torch.where(loaded, force[..., 2], 1.0), _pressure(force, moment, loaded, wrench.new_tensor(height))
    pressure, foot = _to_feet(centre, feet)
    arm = feet.centre[:, 2] - height
    aim = (feet.centre[:, :2] - centre - force[..., :2] / fz[..., None] * arm[..., None]).norm(dim=-1)
    if others is not None:
        alone = loaded & (fz > ALONE * (fz + others))
        mostly = alone.sum(dim=1) > MOSTLY_ALONE * loaded.sum(dim=1)
        aim = torch.where(alone & mostly[:, None], aim, torch.nan)
    turning = centre[..., 0] * force[..., 1] - centre[..., 1] * force[..., 0]
    free = ((moment[..., 2] - turning) / fz).abs()
    weight = torch.where(loaded, force[..., 2], 0.0)
    slip, belt = _slip(foot, feet, weight)
    return FrameWitnesses(loaded, weight, pressure, aim, slip, free, belt)


def agrees(evidence: Evidence) -> Bool[Tensor, " readings"]:
    """Readings that show load, and nothing that a foot cannot do."""
    aims = (evidence.aim < AIM_MOST_M) | torch.isnan(evidence.aim)
    return (evidence.pressure < PRESSURE_MOST_M) & aims & (evidence.free < FREE_MOST_M) & (evidence.loaded > 0)


def carries_foot(feet: Feet, wrench: Float[Tensor, "n 6"], height: float) -> bool:
    """Whether a plate with these readings agrees with the feet."""
    return bool(agrees(gather(feet, wrench[None], height))[0])


def _pressure(force: Tensor, moment: Tensor, loaded: Tensor, height: Tensor) -> Tensor:
    """Centres of pressure (..., 2) at a height; of frames without load a number without meaning."""
    fz = torch.where(loaded, force[..., 2], 1.0)
    x, y = -moment[..., 1] + height * force[..., 0], moment[..., 0] + height * force[..., 1]
    return torch.stack([x / fz, y / fz], dim=-1)


def pressure_centre(wrench: Float[Tensor, "n 6"], height: float) -> Float[Tensor, "n 2"]:
    """Centre of pressure of a plate whose surface lies at ``height`` [m]; without load a number without meaning."""
    force, moment = wrench[:, :3].nan_to_num(), wrench[:, 3:].nan_to_num()
    return _pressure(force, moment, force[:, 2] > SAMPLE_LOADED_N, wrench.new_tensor(height))


def _summary(one: FrameWitnesses) -> Evidence:
    usual = SLIP_M_S + SLIP_OF_BELT * one.belt[:, None]
    parts = (one.pressure / PRESSURE_M, one.aim / AIM_M, one.slip / usual, one.free / FREE_M)
    disagreement = torch.stack([torch.log1p(part.nan_to_num(0.0, posinf=1e6).square()) for part in parts]).sum(dim=0)
    disagreement = torch.where(one.loaded, disagreement, UNLOADED)
    either = (one.loaded | one.loaded[:1]).double()
    gain = ((disagreement[:1] - disagreement) * either).sum(dim=1) / either.sum(dim=1).clamp_min(1.0)
    slowly = torch.where(torch.isfinite(one.slip), one.weight, 0.0)
    return Evidence(
        weighted_quantile(one.pressure, one.weight, 0.5), weighted_quantile(one.aim, one.weight, 0.5),
        weighted_quantile(one.slip, slowly, 0.5), weighted_quantile(one.free, one.weight, 0.95), one.belt,
        one.loaded.double().mean(dim=1), gain,
    )  # fmt: skip


def _to_feet(point: Tensor, feet: Feet) -> tuple[Tensor, Tensor]:
    """Distance of points (readings, n, 2) to the nearest line between two markers of a foot, or of two feet that stand,
    and the nearest foot."""
    place, belongs = feet.position[..., :2], feet.foot
    a, b = torch.triu_indices(len(belongs), len(belongs), 1)
    start, along = place[:, a], place[:, b] - place[:, a]
    away = point[..., None, :] - start
    share = ((away * along).sum(-1) / along.square().sum(-1).clamp_min(1e-9)).clamp(0.0, 1.0)
    distance = (away - share[..., None] * along).norm(dim=-1).nan_to_num(torch.inf)
    own = [distance[..., (belongs[a] == k) & (belongs[b] == k)].amin(dim=-1) for k in range(feet.count)]
    nearest = torch.stack(own, dim=-1).min(dim=-1)
    stands = (slowest_point(feet).norm(dim=-1) < STANDS_M_S)[:, belongs]
    between = distance.masked_fill(~(stands[:, a] & stands[:, b]), torch.inf).amin(dim=-1)
    return torch.minimum(nearest.values, between), nearest.indices


def _slip(foot: Tensor, feet: Feet, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Speed (readings, n) against the ground of the foot under the pressure, and the ground's speed (readings)."""
    slowest = slowest_point(feet)
    velocity = slowest[torch.arange(len(slowest)), foot]
    ground = torch.stack([weighted_quantile(velocity[..., k], weight, 0.5) for k in range(2)], dim=-1)
    belt = ground.norm(dim=-1).nan_to_num()
    ground = torch.where((belt > BELT_M_S)[:, None], ground, 0.0)
    return (velocity - ground[:, None]).norm(dim=-1), torch.where(belt > BELT_M_S, belt, 0.0)


def slowest_point(feet: Feet) -> Float[Tensor, "n feet 2"]:
    """Horizontal velocity of the slowest marker of each foot [m/s]."""
    found = []
    for k in range(feet.count):
        velocity = feet.velocity[:, feet.foot == k]
        slowest = velocity.norm(dim=-1).nan_to_num(torch.inf).argmin(dim=1)
        found.append(velocity[torch.arange(len(velocity)), slowest, :2])
    return torch.stack(found, dim=1)


def weighted_quantile(
    value: Float[Tensor, "readings n"], weight: Float[Tensor, "readings n"], level: float
) -> Float[Tensor, " readings"]:
    """The value below which this share of the weight lies; NaN where nothing weighs."""
    weight = torch.where(torch.isfinite(value), weight, 0.0)
    order = value.nan_to_num(torch.inf).argsort(dim=1)
    sums = weight.gather(1, order).cumsum(dim=1)
    at = (sums < level * sums[:, -1:]).sum(dim=1).clamp_max(value.shape[1] - 1)
    found = value.gather(1, order).gather(1, at[:, None])[:, 0]
    return torch.where(sums[:, -1] > 0, found, torch.nan)
