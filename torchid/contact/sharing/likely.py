"""What is likely of every foot at every frame: feet that hand over roll, feet that stand press near their middle."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.sharing.expected import CENTRE_SD_M, FAINT_N, LIGHT, Expected
from torchid.contact.sharing.rolling import Support, hand_over
from torchid.contact.sharing.soles import SoleAxes, sole_axes
from torchid.runs import runs

STANDING = 0.45
"""Chosen: place along the sole that a standing foot presses at: 40 to 50 % of a foot's length before its heel
(Winter, Gait & Posture 3(4), 1995, of quiet standing)."""
STANDING_SD_M = 0.04, 0.015
"""Chosen: how far from there, along the sole and across [m]: half of what a body can lean without a step."""
AHEAD = 0.3
"""Chosen: part of a sole's length by which a foot is before the other if the body is handed over; feet side by side
stand."""


@dataclass(frozen=True)
class FeetOnGround:
    """Feet on a ground of one height, what bears them together, and the body above."""

    soles: tuple[Float[Tensor, "frames points 3"], ...]
    total: Float[Tensor, "frames 6"]
    """Wrench about the world's origin that they bear together [N, N m]."""
    com: Float[Tensor, "frames 3"]
    """Centre of mass of the body in W [m]."""
    bearing: Bool[Tensor, "frames feet"]
    """Feet that may bear."""
    height: float = 0.0
    """Height of the ground [m]."""


def likely(feet: FeetOnGround) -> Expected:
    """Return where every foot presses, how its force leans and what it bears, as far as motion and total tell.

    Args:
        feet: soles, total and centre of mass of all frames; runs with two bearing feet are looked at one by one, with
            the frames beside them in which one foot bears alone.
    """
    axes = [sole_axes(sole) for sole in feet.soles]
    out = _standing(feet, axes)
    loaded = feet.bearing & (feet.total[:, 2:3] > FAINT_N)
    for start, stop in runs(loaded.sum(dim=1) == 2):
        changes = (loaded[start : stop - 1] != loaded[start + 1 : stop]).any(dim=1).nonzero()[:, 0] + start + 1
        cuts = [start, *changes.tolist(), stop]
        for a, b in zip(cuts, cuts[1:], strict=False):
            first, second = loaded[a].nonzero()[:, 0].tolist()
            _hand(feet, axes, loaded, (a, b), (first, second), out)
    return out


def _standing(feet: FeetOnGround, axes: list[SoleAxes]) -> Expected:
    frames, count = feet.bearing.shape
    middle = torch.stack(
        [a.point(torch.full_like(a.length, STANDING), torch.zeros_like(a.length)) for a in axes], dim=1
    )
    centre = torch.cat([middle, torch.full_like(middle[..., :1], feet.height)], dim=2)
    along = torch.stack([a.along for a in axes], dim=1)
    sd = centre.new_tensor(STANDING_SD_M).expand(frames, count, 2).clone()
    vertical = feet.total[:, 2:3].abs()
    load = vertical / feet.bearing.sum(dim=1, keepdim=True).clamp(min=1)
    return Expected(centre, along, sd, torch.zeros_like(along), load.expand(frames, count).clone())


def _hand(
    feet: FeetOnGround,
    axes: list[SoleAxes],
    loaded: Tensor,
    part: tuple[int, int],
    pair: tuple[int, int],
    out: Expected,
) -> None:
    """Fill in one run of frames on one pair of feet, in place, if it is a step.

    A total below the load at which a plate counts as loaded has no centre of pressure, and begins no step.
    """
    a, b = part
    before, after = (_alone(loaded, frame, pair) for frame in (a - 1, b))
    order = _order(axes, slice(a, b), pair, before, after)
    if order is None:
        return
    trailing, leading = order
    single = before == trailing, after == leading
    span = slice(a - int(single[0]), b + int(single[1]))
    support = Support(
        feet.total[span], feet.com[span], feet.height, (axes[trailing].frames(span), axes[leading].frames(span)), single
    )
    found = hand_over(support)
    inner = slice(int(single[0]), int(single[0]) + b - a)
    total = feet.total[a:b, 2]
    for k, foot in enumerate(order):
        out.centre[a:b, foot, :2] = found.centre[inner, k]
        out.centre_sd[a:b, foot] = out.centre_sd.new_tensor(CENTRE_SD_M)
        out.lean[a:b, foot] = found.lean[inner, k]
        out.load[a:b, foot] = total * found.share[inner, k].clamp(min=LIGHT)


def _alone(loaded: Tensor, frame: int, pair: tuple[int, int]) -> int | None:
    """The foot of the pair that bears alone at a frame; None where none does."""
    if not 0 <= frame < len(loaded) or int(loaded[frame].sum()) != 1:
        return None
    foot = int(loaded[frame].int().argmax())
    return foot if foot in pair else None


def _order(
    axes: list[SoleAxes], part: slice, pair: tuple[int, int], before: int | None, after: int | None
) -> tuple[int, int] | None:
    """Trailing and leading foot; None where the feet stand side by side, or the same foot bears before and after."""
    first, second = (axes[k].frames(part) for k in pair)
    way = (first.along + second.along).mean(0)
    ahead = float(((second.heel - first.heel).mean(0) * way / way.norm().clamp(min=1e-6)).sum())
    if abs(ahead) < AHEAD * float(first.length.amax()):
        return None
    trailing, leading = pair if ahead > 0.0 else (pair[1], pair[0])
    return None if before == leading or after == trailing else (trailing, leading)
