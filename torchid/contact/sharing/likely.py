"""What is likely of every foot at every frame: feet that hand over roll, feet that stand press near their middle.

Where feet hand a body over, pressure rolls on with the load, and forces point to the body. Each end of a double support
is known from the single support beside it: where on its sole a foot presses, and how its force leans against the line
to the centre of mass. From there on both change with the share of the load that the leading foot bears, which follows
from the lever between the two centres, so that the two are found by turns.

Reference: Schepers, van Asseldonk, Buurke & Veltink, IEEE Trans Biomed Eng 56(4), 2009 (forces against the centre of
mass); Maus, Lipfert, Gross, Rummel & Seyfarth, Nature Communications 1:70, 2010 (virtual pivot point).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.sharing.expected import CENTRE_SD_M, FAINT_N, LIGHT, Expected
from torchid.contact.sharing.soles import SoleAxes, sole_axes
from torchid.runs import runs

TOE_OFF, TOE_POWER = 0.95, 4.0
"""Derived: place along the sole that a trailing foot's pressure ends at, and how late it goes there, as the power of
the share that the other bears. Fitted, as all constants here, to walks of three subjects (``docs/contact.md``)."""
HEEL_STRIKE = 0.06
"""Derived: place along the sole that a leading foot's pressure begins at."""
MIDDLE = 0.74, 0.30
"""Derived: places at the ends of double support, trailing and leading, where no single support tells them."""
PLACES = (0.5, 0.9), (0.1, 0.6)
"""Chosen: what may be believed of them, trailing and leading."""
UPRIGHT = 0.75, 0.78
"""Derived: lean of a force over that of the line to the centre of mass, trailing and leading, where none tells it."""
LEANS = 0.4, 1.2
"""Chosen: what may be believed of it."""
PUSHED = 0.3
"""Derived: what is added to the trailing one's by the time its load is gone."""
BRAKED = 0.15, 0.5
"""Derived: shares of the load between which the leading foot's force comes to lean backwards; a strike pushes forwards
before it brakes."""
TURNS = 8
"""Chosen: alternations between shares and centres, which contract by a tenth each."""
PASSES = 3
"""Chosen: searches for the frames at which the double support begins and ends."""
BEGUN = 0.02
"""Chosen: share of the load from which on the other foot bears: what plates and soles leave of a lever."""
FEWEST = 3
"""Chosen: a double support of fewer frames is taken as the contacts tell it."""


@dataclass(frozen=True)
class KnownFoot:
    """What a single support tells about a foot: place on the sole, and lean against the line to the body."""

    part: float
    aside: float
    lean: float


@dataclass(frozen=True)
class Handover:
    """Centres, leans and shares of the two feet of a double support, trailing first."""

    centre: Float[Tensor, "frames 2 2"]
    lean: Float[Tensor, "frames 2 2"]
    share: Float[Tensor, "frames 2"]


@dataclass(frozen=True)
class Support:
    """A stretch of frames on one pair of feet, and one more frame at each end where that one is a single support."""

    total: Float[Tensor, "frames 6"]
    com: Float[Tensor, "frames 3"]
    height: float
    axes: tuple[SoleAxes, SoleAxes]
    """Trailing, leading."""
    single: tuple[bool, bool]
    """Whether the first frame has the trailing foot alone, and the last the leading one."""

    @property
    def centre(self) -> Float[Tensor, "frames 2"]:
        """Centre of pressure of the total on the ground [m]."""
        force, moment = self.total[:, :3], self.total[:, 3:]
        x = (-moment[:, 1] + self.height * force[:, 0]) / force[:, 2]
        y = (moment[:, 0] + self.height * force[:, 1]) / force[:, 2]
        return torch.stack([x, y], dim=1)

    def line(self, centre: Float[Tensor, "frames 2"]) -> Float[Tensor, "frames 2"]:
        """Lean of the line from a point on the ground to the centre of mass."""
        return (self.com[:, :2] - centre) / (self.com[:, 2:] - self.height)


def hand_over(support: Support) -> Handover:
    """Return what is likely of both feet at every frame of a support; its own ends tell what they are."""
    first, last = 0, len(support.total) - 1
    sure = support.single
    raw = torch.linspace(0.0, 1.0, last + 1, dtype=support.total.dtype, device=support.total.device)
    centre, known = support.centre, (_untold(0), _untold(1))
    for _ in range(PASSES):
        known = (
            _told(support, 0, first) if sure[0] else _untold(0),
            _told(support, 1, last) if sure[1] else _untold(1),
        )
        raw = _shares(support, centre, known, raw)
        begun, going = raw > BEGUN, raw < 1.0 - BEGUN
        a = max(int(begun.int().argmax()) - 1, 0) if bool(begun.any()) else 0
        b = len(raw) - 1 - max(int(going.flip(0).int().argmax()) - 1, 0) if bool(going.any()) else len(raw) - 1
        if b - a < FEWEST:
            break
        sure = sure[0] or a > first, sure[1] or b < last
        first, last = a, b
    share = raw.clamp(0.0, 1.0)
    centres = _centres(support, known, share)
    gain = torch.stack([known[0].lean + PUSHED * share, known[1].lean * _braked(share)], dim=1)
    lean = torch.stack([support.line(c) for c in centres], dim=1) * gain[..., None]
    return Handover(torch.stack(centres, dim=1), lean, torch.stack([1.0 - share, share], dim=1))


def _braked(share: Tensor) -> Tensor:
    return ((share - BRAKED[0]) / (BRAKED[1] - BRAKED[0])).clamp(0.0, 1.0)


def _told(support: Support, foot: int, frame: int) -> KnownFoot:
    """From a frame in which this foot bears all."""
    centre = support.centre
    part, aside = support.axes[foot].place(centre)
    line, force = support.line(centre)[frame], support.total[frame]
    lean = float((force[:2] / force[2]) @ line / line.square().sum().clamp(min=1e-6))
    low, high = PLACES[foot]
    return KnownFoot(min(max(float(part[frame]), low), high), float(aside[frame]), min(max(lean, LEANS[0]), LEANS[1]))


def _untold(foot: int) -> KnownFoot:
    return KnownFoot(MIDDLE[foot], 0.0, UPRIGHT[foot])


def _centres(support: Support, known: tuple, share: Tensor) -> tuple[Tensor, Tensor]:
    """Where both press, given the leading foot's share: one ends at its toes, the other comes from its heel."""
    trailing, leading = support.axes
    behind = known[0].part + (TOE_OFF - known[0].part) * share.pow(TOE_POWER)
    before = known[1].part + (HEEL_STRIKE - known[1].part) * (1.0 - share)
    aside = torch.full_like(share, known[1].aside)
    return trailing.point(behind, known[0].aside * (1.0 - share)), leading.point(before, aside)


def _shares(support: Support, centre: Tensor, known: tuple, share: Tensor) -> Tensor:
    """The leading foot's, by the lever between the centres; beyond 0 and 1 where the total lies outside them."""
    raw = share
    for _ in range(TURNS):
        behind, before = _centres(support, known, raw.clamp(0.0, 1.0))
        arm = before - behind
        raw = ((centre - behind) * arm).sum(1) / arm.square().sum(1).clamp(min=1e-6)
    return raw


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
