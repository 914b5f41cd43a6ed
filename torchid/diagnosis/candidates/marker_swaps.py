"""Pairs of markers whose labels seem exchanged for a while."""

import math

import torch
from jaxtyping import Bool
from torch import Tensor

from torchid.effects.place import Interval, Place
from torchid.observation.marker_response import MarkerResponse
from torchid.regressor.rows import runs

SWAPPED = 5
"""Frames that a swap lasts at least."""
EVERY, AT_ONCE = 5, 1024
"""Frames of which one is looked at for pairs of markers that come near each other, and that many together."""
CLOSER = 0.5
"""Part of the squared distances that must be left after a swap is undone."""


def propose_swaps(response: MarkerResponse) -> list[Place]:
    """Pairs of markers and when they are closer to each other's places than to their own.

    Where one of them is lost the other tells, and where both are, the frames about: without them half of a swap was
    named, and the other half as a marker that was moved.
    """
    sight, seen = response.sight, response.weight > 0.0
    found: dict[tuple[int, int], list[Interval]] = {}
    trial, time = sight.scene.trial, sight.scene.time
    odds = 1.0 / (math.comb(len(sight.labels), 2) * len(time))
    for a, b in _near(response):
        exchanged = _exchanged(response, a, b)
        if int(exchanged.sum()) < SWAPPED:
            continue
        for start, stop in runs(exchanged | ~(seen[a] | seen[b])):
            inside = start + exchanged[start:stop].nonzero()[:, 0]
            if int((seen[a] & seen[b])[inside].sum()) >= SWAPPED:
                t0, t1 = float(time[inside[0]]), float(time[inside[-1]])
                found.setdefault((a, b), []).append(Interval(trial, t0, t1))
    return [Place((sight.labels[a], sight.labels[b]), tuple(own), odds=odds) for (a, b), own in found.items()]


def _near(response: MarkerResponse) -> list[tuple[int, int]]:
    """Pairs of which one may be where the other is: all others are farther apart than errors reach.

    With e the errors of a pair and D what exchanging adds to them, |e + D|^2 < c |e|^2 wants |D| < (1 + c^0.5) |e|,
    and |D| is the distance at least.
    """
    p, seen = response.sight.p.permute(2, 0, 1), response.weight > 0.0
    error = (seen * torch.linalg.vector_norm(response.error, dim=1)).amax(1)
    # Between the frames that are looked at, a distance shrinks by what both markers stray at most.
    looked = p[::EVERY]
    strays = (p - looked.repeat_interleave(EVERY, 0)[: len(p)]).norm(dim=2).amax(0)
    least = torch.stack([torch.cdist(some, some).amin(0) for some in looked.split(AT_ONCE)]).amin(0)
    reach = (1.0 + math.sqrt(CLOSER)) * torch.hypot(error[:, None], error)
    return [(a, b) for a, b in (least - strays[:, None] - strays < reach).nonzero().tolist() if a < b]


def _exchanged(response: MarkerResponse, a: int, b: int) -> Bool[Tensor, " frames"]:
    """Frames in which what is seen of two markers fits better the other way round."""
    apart, both = response.sight.p[b] - response.sight.p[a], [a, b]
    seen, error = response.weight[both] > 0.0, response.error[both]
    now = (seen * error.square().sum(1)).sum(0)
    undone = (seen * (error + torch.stack([-apart, apart])).square().sum(1)).sum(0)
    return undone < CLOSER * now
