"""Markers that leap between two frames, relative to the markers beside them, and where they are meanwhile."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.recording import Markers
from torchid.tracking.clusters import MAD_SD, Clusters, Shape, runs_of, shape_of
from torchid.tracking.statement import Kind, Statement

BESIDE = 5
"""Choice. Markers beside one that its distance is taken to: those of its segment, then those to which it keeps its
distance best."""
ELSEWHERE_M = 0.02
"""Choice. Scatter [m] that a marker of another segment is charged with when the most rigid neighbours are chosen."""
LEAP_M = 0.02
"""Calibrated. Change of a distance from one frame to the next, beyond that of the frames about, that skin does not
make [m]. On eight recorded sessions of walks, runs and squats no marker passed 12 mm but for labels that had changed;
landings from a box reached 17 mm."""
LEAP_M_S2 = 200.0
"""Calibrated. The same where frames are far apart, as an acceleration against the markers beside [m/s^2]: what made
the landings' 17 mm at 100 Hz."""
STANDS_OUT = 8.0
"""Choice. So many times the robust scatter of a pair's own changes a leap is at least."""
ABOUT = 3
"""Choice. Frames on either side that tell how fast a distance changes anyhow."""
OFF_PART = 0.5
"""Choice. Part of the leap by which a marker must be off its place on one side for that side to be wrong."""
PLACE_M = 0.015
"""Choice. Stretches whose distances agree within this [m] are at one and the same other place."""
PIECE = 4096
"""Resolution. Frames that are looked at together."""
SCATTER_M = 0.004
"""Calibrated. Scatter of such changes in landings, the worst of clean recordings: a quarter of their largest [m]."""


@dataclass(frozen=True)
class Leaps:
    """Steps between frames in which markers leap."""

    at: dict[int, list[int]]
    """By marker: indices of the frames after which it leaps."""
    size: dict[tuple[int, int], float]
    """Largest change of a distance [m], by marker and frame."""


def beside(clusters: Clusters, shape: Shape) -> Int[Tensor, "markers few"]:
    """Return the markers whose distance tells most of each one, the best first.

    Args:
        clusters: which markers sit on one segment.
        shape: of the trial itself.
    """
    far = torch.where(clusters.together, 0.0, ELSEWHERE_M).to(shape.sd)
    cost = torch.nan_to_num(shape.sd, nan=torch.inf) + far
    cost.fill_diagonal_(torch.inf)
    return cost.argsort(dim=1)[:, : min(BESIDE, max(len(cost) - 1, 0))]


def find_leaps(position: Float[Tensor, "frames markers 3"], rate: float, near: Int[Tensor, "markers few"]) -> Leaps:
    """Return the steps in which the distances of a marker to at least two others leap.

    Where several leap together, the one with most of it is taken out first, and the others are looked at without it.

    Args:
        position: p_WM_W [m].
        rate: frames per second.
        near: markers beside each.
    """
    at: dict[int, list[int]] = {}
    size: dict[tuple[int, int], float] = {}
    bound = None
    for start in range(0, max(len(position) - 1, 0), PIECE):
        first = max(0, start - ABOUT)
        excess = _excess(position[first : start + PIECE + ABOUT + 1], near)
        if bound is None:
            bound = _bounds(excess, rate)
        own = excess[start - first : start - first + PIECE]
        over = torch.nan_to_num(own) / bound
        for frame in ((over > 1.0).sum(dim=2) >= 2).any(dim=1).nonzero()[:, 0].tolist():
            for marker in _culprits(over[frame], near):
                at.setdefault(marker, []).append(start + frame)
                size[marker, start + frame] = float(torch.nan_to_num(own[frame, marker]).max())
    return Leaps(at, size)


def _excess(position: Tensor, near: Tensor) -> Float[Tensor, "steps markers few"]:
    """Return by how much each distance changes from frame to frame beyond the median of the changes about."""
    to = position[:, near]
    change = (position[:, :, None] - to).norm(dim=3).diff(dim=0)
    edge = change.new_full((ABOUT, *change.shape[1:]), torch.nan)
    about = torch.cat([edge, change, edge]).unfold(0, 2 * ABOUT + 1, 1)
    return (change - about.nanmedian(dim=-1).values).abs()


def _bounds(excess: Tensor, rate: float) -> Float[Tensor, "markers few"]:
    """Return what a distance may change by in excess [m]."""
    least = max(LEAP_M, LEAP_M_S2 / rate**2)
    own = STANDS_OUT * MAD_SD * torch.nan_to_num(excess.nanmedian(dim=0).values)
    return own.clamp(min=least)


def _culprits(over: Float[Tensor, "markers few"], near: Int[Tensor, "markers few"]) -> list[int]:
    """Return the markers that leapt in one step: those with two leaping distances, the largest first, alone."""
    left, found = over.clone(), []
    while True:
        many = (left > 1.0).sum(dim=1) >= 2
        if not bool(many.any()):
            return found
        worst = int((left.clamp(max=10.0).sum(dim=1) * many).argmax())
        found.append(worst)
        left[worst] = 0.0
        left[near == worst] = 0.0


def find_jumps(trial: str, markers: Markers, clusters: Clusters, references: Sequence[Shape]) -> list[Statement]:
    """Return the markers that are away from their place between two leaps, or between a leap and a gap.

    Args:
        trial: name of the trial.
        markers: its markers, exchanged ones with their own names.
        clusters: which markers sit on one segment.
        references: shapes of other trials, which say on which side of a leap a marker is at its place; without any,
            that is where it is most of the time.
    """
    if len(markers.time) < 2 * ABOUT:
        return []
    position = markers.select(clusters.labels).position
    own = shape_of(trial, markers, clusters.labels)
    near = beside(clusters, own)
    leaps = find_leaps(position, markers.rate, near)
    found = []
    for marker, at in sorted(leaps.at.items()):
        place = _place(marker, near[marker], clusters, own, references)
        bad, off = _away(position, marker, near[marker], place, at, [leaps.size[marker, k] for k in at])
        if bad:
            mask = torch.zeros(len(position), dtype=torch.bool)
            for a, b in bad:
                mask[a:b] = True
            found.append(_statement(trial, markers, clusters.labels[marker], mask, off, references))
    return found


def _place(
    marker: int, near: Tensor, clusters: Clusters, own: Shape, references: Sequence[Shape]
) -> Float[Tensor, " few"]:
    """Return the distances that a marker should have to those beside it: of other trials on its segment, else its own
    trial's."""
    usual = own.median[marker, near].clone()
    if references:
        others = torch.stack([shape.median[marker, near] for shape in references]).nanmedian(dim=0).values
        told = clusters.together[marker, near] & torch.isfinite(others)
        if int(told.sum()) >= 2:
            usual = torch.where(told, others, torch.nan)
    return usual


def _away(
    position: Tensor, marker: int, near: Tensor, place: Tensor, at: list[int], sizes: list[float]
) -> tuple[list[tuple[int, int]], float]:
    """Return stretches between leaps and gaps in which a marker is off its place, and by how much at most [m]."""
    seen = torch.isfinite(position[:, marker]).all(dim=1)
    distance = (position[:, marker, None] - position[:, near]).norm(dim=2)
    cuts = sorted({0, len(position), *(k + 1 for k in at)})
    stretches = [
        (a + first, a + last) for a, b in zip(cuts, cuts[1:], strict=False) for first, last in runs_of(seen[a:b])
    ]
    edges = {k + 1: size for k, size in zip(at, sizes, strict=True)}
    off = {stretch: _second_largest(distance[slice(*stretch)] - place) for stretch in stretches}
    bad = []
    for a, b in stretches:
        size = max(edges.get(a, 0.0), edges.get(b, 0.0))
        beside_it = [off[other] for other in stretches if other[1] == a or other[0] == b]
        if size and off[a, b] > max(OFF_PART * size, LEAP_M / 2) and off[a, b] > max(beside_it, default=0.0) / 2:
            bad.append((a, b))
    good = [one for one in stretches if one not in bad]
    return (bad, max(off[one] for one in bad)) if bad and good else ([], 0.0)


def _second_largest(misfit: Float[Tensor, "frames few"]) -> float:
    """Return the second largest of the median misfits over frames: one alone is another marker's [m]."""
    middle = misfit.nanmedian(dim=0).values.abs()
    known = middle[torch.isfinite(middle)].sort(descending=True).values
    return float(known[1]) if len(known) > 1 else 0.0


def _statement(
    trial: str, markers: Markers, label: str, mask: Bool[Tensor, " frames"], off: float, references: Sequence[Shape]
) -> Statement:
    time = markers.time
    when = tuple((float(time[a]), float(time[b - 1])) for a, b in runs_of(mask))
    kind = Kind.JUMP if len(when) == 1 else Kind.FLIP
    against = tuple(shape.trial for shape in references)
    return Statement(
        kind, trial, (label,), when, 1e3 * off, 1e3 * SCATTER_M, share=float(mask.double().mean()), against=against
    )
