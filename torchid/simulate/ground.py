"""Who carries the wrench: feet and the plates under them."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.recording import Plate
from torchid.simulate.balance import centre_of_pressure
from torchid.simulate.legs import bearing_point
from torchid.simulate.script import Script
from torchid.simulate.subject import SimulatedSubject

LENGTH, WIDTH, GAP = 0.60, 0.45, 0.005
"""Size of a plate along x and y, and the slit between two [m]."""
WEIGHTLESS = 1e-6
"""Vertical force that has no centre of pressure [N]."""


@dataclass(frozen=True)
class FootLoad:
    """Wrenches of both feet (left, right) on the subject and the plate that each stands on."""

    wrench: Float[Tensor, "frames 2 6"]
    """About the origin of W."""
    plate: Int[Tensor, "frames 2"]
    """Index of the plate below the whole foot, -1 beside the plates."""
    pressure: Float[Tensor, "frames 2 3"]
    """Centre of pressure of each foot [m]; arbitrary where it carries nothing."""


def force_plates(count: int) -> tuple[Plate, ...]:
    """Plates left and right of the origin, then left and right in front of them; corners from (+x, +y) round."""
    plates = []
    for k in range(count):
        x, side = (k // 2) * (LENGTH + GAP), 1.0 if k % 2 == 0 else -1.0
        y = side * 0.5 * (WIDTH + GAP)
        corners = [(x + a * 0.5 * LENGTH, y + b * 0.5 * WIDTH, 0.0) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        plates.append(Plate(f"plate {k + 1}", torch.tensor(corners, dtype=torch.float64)))
    return tuple(plates)


def share_load(
    subject: SimulatedSubject, script: Script, wrench: Float[Tensor, "frames 6"], plates: tuple[Plate, ...]
) -> FootLoad:
    """Split the needed wrench between the feet.

    Each foot carries its share of the force and of the free moment where the script wants its centre of pressure;
    what the wanted centres miss moves both by the same millimetres, so that the sum is exact. Feet that both stand
    press apart by the script's ``squeeze``, along the line between them, which leaves the sum as it is.
    """
    share = torch.stack([script.share, 1.0 - script.share], 1)[:, :, None]
    point = torch.stack([bearing_point(path, subject.sole) for path in script.feet], 1)
    point[:, :, 2] = 0.0
    missed = centre_of_pressure(wrench) - (share * point).sum(1)[:, :2]
    missed[wrench[:, 2].abs() < WEIGHTLESS] = 0.0
    point[:, :, :2] += missed[:, None]
    force = share * wrench[:, None, :3]
    apart = torch.nn.functional.normalize(point[:, 0] - point[:, 1], dim=1)
    both = 4.0 * share[:, 0] * share[:, 1]
    squeeze = (script.squeeze[:, None] * both * wrench[:, 2:3]) * apart
    force = force + torch.stack([-squeeze, squeeze], 1)
    moment = torch.linalg.cross(point, force)
    free = wrench[:, 3:] - moment.sum(1)
    moment = moment + share * free[:, None]
    return FootLoad(torch.cat([force, moment], 2), _standing_on(subject, script, plates), point)


def plate_wrenches(load: FootLoad, count: int) -> Float[Tensor, "frames plates 6"]:
    """What the plates measure; the wrench of a foot beside them is lost."""
    out = load.wrench.new_zeros(len(load.wrench), count, 6)
    for k in range(count):
        out[:, k] = (load.wrench * (load.plate == k)[:, :, None]).sum(1)
    return out


def _standing_on(subject: SimulatedSubject, script: Script, plates: tuple[Plate, ...]) -> Int[Tensor, "frames 2"]:
    columns = []
    for path in script.feet:
        found = torch.full((len(script.time),), -1)
        for k, plate in enumerate(plates):
            assert plate.corners is not None
            low, high = plate.corners.amin(0), plate.corners.amax(0)
            inside = torch.ones(len(script.time), dtype=torch.bool)
            for corner in _flat_sole(subject, path.base, path.yaw):
                inside &= ((corner > low[:2]) & (corner < high[:2])).all(1)
            found[inside] = k
        columns.append(found)
    return torch.stack(columns, 1)


def _flat_sole(subject: SimulatedSubject, base: Tensor, yaw: float) -> list[Tensor]:
    c, s = np.cos(yaw), np.sin(yaw)
    return [base[:, :2] + base.new_tensor([c * x - s * y, s * x + c * y]) for x, y, _ in subject.sole.corners()]
