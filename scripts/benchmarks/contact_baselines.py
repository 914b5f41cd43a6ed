"""Two older ways to split a double support, to be printed beside the shares: the lever rule and a smooth transition."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.equations_of_motion import wrench_about

STRIKE_PEAK = 2.0 / 3.0
"""Cited: time at which the trailing foot's fore-aft force peaks, over half the double support (Ren et al. 2008)."""


def lever_rule(
    soles: tuple[Float[Tensor, "frames points 3"], Float[Tensor, "frames points 3"]],
    total: Float[Tensor, "frames 6"],
    height: float = 0.0,
) -> Float[Tensor, "frames 2 6"]:
    """Return the total split in inverse proportion to the distances of two feet from its centre of pressure.

    The centre of pressure is projected on the line between the middles of the soles; each foot's force is its part of
    the total force, at the middle of its sole. The moments do not sum to the total's.

    Args:
        soles: points of both feet in W [m].
        total: wrench about the world's origin [N, N m].
        height: of the ground [m].
    """
    first, second = (sole[..., :2].mean(dim=1) for sole in soles)
    centre = torch.stack([-total[:, 4] + height * total[:, 0], total[:, 3] + height * total[:, 1]], 1) / total[:, 2:3]
    arm = second - first
    part = (((centre - first) * arm).sum(1) / arm.square().sum(1)).clamp(0.0, 1.0)
    both = []
    for middle, own in ((first, 1.0 - part), (second, part)):
        force = total[:, :3] * own[:, None]
        place = torch.cat([middle, torch.full_like(middle[:, :1], height)], dim=1)
        both.append(torch.cat([force, torch.linalg.cross(place, force)], dim=1))
    return torch.stack(both, dim=1)


def smooth_transition(
    total: Float[Tensor, "frames 6"], com: Float[Tensor, "frames 3"], forward: Float[Tensor, "2"]
) -> Float[Tensor, "frames 2 6"]:
    """Return the wrenches of the trailing and of the leading foot by the smooth transition assumption.

    With t from the leading foot's strike and T half the double support, all components of the trailing foot's wrench
    about the centre of mass fall as exp(-(t/T)^3) from their values at the strike, but the fore-aft force, which falls
    as k1 exp(-(t/T - 2/3)^2) - k2 t/T with k1 = exp(4/9) and k2 = k1 exp(-16/9) / 2; the leading foot has the rest.

    Args:
        total: wrench about the world's origin of one double support, its first frame the strike, its last the toe-off.
        com: centre of mass in W [m].
        forward: horizontal direction of progression.

    Reference:
        Ren, Jones & Howard, J Biomech 41(12):2750-2759, 2008, equations 8 and 9.
    """
    phase = torch.linspace(0.0, 2.0, len(total), dtype=total.dtype, device=total.device)
    fall = torch.exp(-(phase**3))
    k1 = math.exp(4.0 / 9.0)
    push = k1 * torch.exp(-((phase - STRIKE_PEAK) ** 2)) - 0.5 * k1 * math.exp(-16.0 / 9.0) * phase
    start = wrench_about(total, com)[0]
    trailing = fall[:, None] * start
    way = torch.cat([forward / forward.norm(), forward.new_zeros(4)])
    trailing = trailing + ((push - fall) * (start @ way))[:, None] * way
    trailing = wrench_about(trailing, -com)
    return torch.stack([trailing, total - trailing], dim=1)
