"""The feet of a recording without names or a model: the markers that come low and keep their distances."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.recording import Markers

LOW_M = 0.13
"""Above the floor: heels, toes and malleoli come this low, knees and hands do not."""
FLOOR_MARKERS = 4
"""The floor is where the median of so many lowest markers comes: one that has fallen off cannot lower it."""
OFTEN = 0.05
"""Share of the frames in which a marker is as low as it is said to come."""
SEEN = 0.5
"""A marker that is missing more often is no witness."""
TWO_FEET_M = 0.3
"""Two feet that stand have markers further apart than this; a foot that moves by more is not one that stands."""
FOOT_M, BEND_M = 0.36, 0.03
"""Two markers of one foot are closer than this, and their distance changes by less (standard deviation): the toes of a
foot bend by 10 to 20 mm, the heels of two walking feet part by hundreds."""
OUTLINE = 16
"""So many markers draw the outline of what moves as one foot: eight for each of two that stand still."""
FRAMES = 100
"""Evenly spaced frames that witness; more add nothing to medians."""
STRIDE = 2
"""Frames on either side from which a velocity is taken."""


@dataclass(frozen=True)
class Feet:
    """Low markers at the frames that witness; two feet that never move against each other count as one."""

    frames: Int[Tensor, " n"]
    """Of the recording."""
    position: Float[Tensor, "n markers 3"]
    velocity: Float[Tensor, "n markers 3"]
    foot: Int[Tensor, " markers"]
    """Foot of each marker, counted from 0."""
    centre: Float[Tensor, "n 3"]
    """Mean of all markers: roughly where the body is."""

    @property
    def seen(self) -> Bool[Tensor, " n"]:
        """Frames in which every foot shows two markers."""
        shown = torch.isfinite(self.position[..., 0])
        return torch.stack([shown[:, self.foot == k].sum(dim=1) > 1 for k in range(self.count)]).all(dim=0)

    @property
    def count(self) -> int:
        """Number of feet."""
        return int(self.foot.max()) + 1


def find_feet(markers: Markers, frames: Int[Tensor, " n"] | None = None) -> Feet | None:
    """Feet of a recording in W (Z up), None where no two low markers belong together.

    Args:
        markers: of any set, labelled as they like.
        frames: that witness, by default ``FRAMES`` of them, evenly spaced; none within ``STRIDE`` of an end.
    """
    position, last = markers.position, len(markers.time) - 1 - STRIDE
    if last < STRIDE:
        return None
    spaced = torch.linspace(STRIDE, last, min(FRAMES, last - STRIDE + 1)).round().long()
    frames = spaced if frames is None else frames[(frames >= STRIDE) & (frames <= last)]
    low = _low(position[spaced])
    if len(low) < 2:
        return None
    foot = _outermost(position[spaced][:, low], _joined(position[spaced][:, low]))
    index = low[foot >= 0]
    if not len(index) or not len(frames) or _one_foot(position[spaced][:, index], foot[foot >= 0]):
        return None
    ahead, behind = position[frames + STRIDE][:, index], position[frames - STRIDE][:, index]
    velocity = (ahead - behind) * (markers.rate / (2 * STRIDE))
    centre = position[frames].nanmean(dim=1)
    return Feet(frames, position[frames][:, index], velocity, foot[foot >= 0], centre)


def _one_foot(position: Tensor, foot: Tensor) -> bool:
    """Whether one foot alone is marked: the other's forces would have nothing to agree with."""
    place = position[..., :2].nanmean(dim=0)
    wide = float(torch.cdist(place, place).max()) > TWO_FEET_M
    travels = float((position.nan_to_num() - position.nan_to_num()[:1]).norm(dim=-1).amax()) > TWO_FEET_M
    return int(foot.max()) == 0 and not wide and travels


def _low(position: Tensor) -> Tensor:
    """Indices of the markers that come near the floor."""
    lowest = _lowest(position)
    return (lowest < _floor(lowest) + LOW_M).nonzero()[:, 0]


def _lowest(position: Tensor) -> Tensor:
    """How low each marker comes, infinite for one that is rarely seen."""
    height = position[..., 2]
    if not height.shape[1]:
        return height.new_zeros(0)
    often_seen = torch.isfinite(height).double().mean(dim=0) > SEEN
    return torch.where(often_seen, torch.nanquantile(height, OFTEN, dim=0), torch.inf)


def _floor(lowest: Tensor) -> Tensor:
    return lowest.sort().values[:FLOOR_MARKERS].median() if len(lowest) else lowest.new_tensor(torch.inf)


def floor_height(markers: Markers) -> float:
    """Height in W to which the lowest markers come [m]; infinite without markers."""
    frames = torch.linspace(0, len(markers.time) - 1, min(FRAMES, len(markers.time))).round().long()
    lowest = _lowest(markers.position[frames])
    return float(_floor(lowest))


def _outermost(position: Tensor, foot: Tensor) -> Tensor:
    """The same, with at most ``OUTLINE`` markers of each foot: each the farthest from those before."""
    place, found = position.nanmean(dim=0)[:, :2], torch.full_like(foot, -1)
    for k in range(int(foot.max()) + 1 if len(foot) else 0):
        left = (foot == k).nonzero()[:, 0]
        kept = [int(left[(place[left] - place[left].mean(dim=0)).norm(dim=1).argmax()])]
        while len(kept) < min(OUTLINE, len(left)):
            away = (place[left][:, None] - place[kept][None]).norm(dim=-1).amin(dim=1)
            kept.append(int(left[away.argmax()]))
        found[kept] = k
    return found


def _joined(position: Tensor) -> Tensor:
    """Foot of each marker, -1 for one that belongs to nobody: connected parts of the graph of constant distances."""
    distance = (position[:, :, None] - position[:, None]).norm(dim=-1)
    mean = distance.nanmean(dim=0)
    bend = (distance - mean).square().nanmean(dim=0).sqrt()
    reach = ((mean < FOOT_M) & (bend < BEND_M)).double()
    for _ in range(len(reach).bit_length()):
        reach = ((reach @ reach) > 0).double()
    first = torch.where(reach > 0, torch.arange(len(reach)), len(reach)).amin(dim=1)
    found = torch.full((len(reach),), -1)
    groups = [g for g in first.unique().tolist() if int((first == g).sum()) > 1]
    for k, group in enumerate(groups):
        found[first == group] = k
    return found
