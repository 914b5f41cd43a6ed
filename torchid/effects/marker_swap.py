"""Markers that carry each other's name for a while."""

import math
from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.effects.evidence import MarkerErrors, TrialEvidence
from torchid.effects.kinds import SlidingMarkers
from torchid.effects.marker_scene import Sight, Slid, View
from torchid.effects.parameter import Parameter
from torchid.effects.place import Interval, Place, within
from torchid.effects.quantities import NamedEffect
from torchid.effects.traits import Correction, Occurrence, Proof, Site
from torchid.kinematics.recursion import lengths
from torchid.runs import runs

SWAPPED = 5
"""Proposal. Frames that a swap lasts at least."""
EVERY, AT_ONCE = 5, 1024
"""Resolution. Every how many frames pairs of markers that come near each other are looked for, and in how many frames
together."""
CLOSER = 0.5
"""Proposal. Part of the squared distances that may be left after a swap is undone."""


@final
class MarkerSwap(SlidingMarkers):
    """Two labels are exchanged for a while. The parameter is how much of the swap is there: one, or nothing."""

    name = "marker_swap"
    mistaken = 0.0
    """No marker is half another: it is there in full or not at all."""
    proof = Proof.DISTANCES
    occurrence = Occurrence.INTERVALS
    correction = Correction.LABELS
    site = Site.MARKER
    parameters = (Parameter("share", 1.0, positive=True, source="by construction: one where labels are exchanged"),)
    noun = "exchanged markers"
    advice = "the labels of these frames, checked by eye"

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """None without data: of all pairs at all times, hardly any is worth a column."""
        return ()

    def propose(self, observed: Sequence[TrialEvidence]) -> tuple[Place, ...]:
        """Pairs that fit better the other way round, and when."""
        return tuple(place for one in observed if one.markers is not None for place in propose_swaps(one.markers))

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        a, b = (sight.labels.index(label) for label in place.where)
        apart = theta * within(place, sight.scene.trial, sight.scene.time, 0.0) * (sight.p[b] - sight.p[a])
        return Slid((a, b), torch.stack([apart, -apart]))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return torch.ones(1, dtype=torch.float64)

    def sentence(self, finding: NamedEffect) -> str:
        return f"{self.located(finding.where)} carry each other's name"


def propose_swaps(markers: MarkerErrors) -> list[Place]:
    """Pairs of markers of one trial, and when they are closer to each other's places than to their own.

    Where one of them is lost the other tells, and where both are, the frames about: so that a swap is proposed whole.
    """
    sight, seen = markers.sight, markers.weight > 0.0
    found: dict[tuple[int, int], list[Interval]] = {}
    trial, time = sight.scene.trial, sight.scene.time
    odds = 1.0 / (math.comb(len(sight.labels), 2) * len(time))
    for a, b in _near(markers):
        exchanged = _exchanged(markers, a, b)
        if int(exchanged.sum()) < SWAPPED:
            continue
        for start, stop in runs(exchanged | ~(seen[a] | seen[b])):
            inside = start + exchanged[start:stop].nonzero()[:, 0]
            if int((seen[a] & seen[b])[inside].sum()) >= SWAPPED:
                t0, t1 = float(time[inside[0]]), float(time[inside[-1]])
                found.setdefault((a, b), []).append(Interval(trial, t0, t1))
    return [Place((sight.labels[a], sight.labels[b]), tuple(own), odds=odds) for (a, b), own in found.items()]


def _near(markers: MarkerErrors) -> list[tuple[int, int]]:
    """Pairs of which one may be where the other is: all others are farther apart than errors reach.

    With e the errors of a pair and D what exchanging adds to them, |e + D|^2 < c |e|^2 wants |D| < (1 + c^0.5) |e|,
    and |D| is the distance at least.
    """
    p, seen = markers.sight.p.permute(2, 0, 1), markers.weight > 0.0
    error = (seen * lengths(markers.error)).amax(1)
    # Between the frames that are looked at, a distance shrinks by what both markers stray at most.
    looked = p[::EVERY]
    strays = (p - looked.repeat_interleave(EVERY, 0)[: len(p)]).norm(dim=2).amax(0)
    least = torch.stack([torch.cdist(some, some).amin(0) for some in looked.split(AT_ONCE)]).amin(0)
    reach = (1.0 + math.sqrt(CLOSER)) * torch.hypot(error[:, None], error)
    return [(a, b) for a, b in (least - strays[:, None] - strays < reach).nonzero().tolist() if a < b]


def _exchanged(markers: MarkerErrors, a: int, b: int) -> Bool[Tensor, " frames"]:
    """Frames in which what is seen of two markers fits better the other way round."""
    apart, both = markers.sight.p[b] - markers.sight.p[a], [a, b]
    seen, error = markers.weight[both] > 0.0, markers.error[both]
    now = (seen * error.square().sum(1)).sum(0)
    undone = (seen * (error + torch.stack([-apart, apart])).square().sum(1)).sum(0)
    return undone < CLOSER * now
