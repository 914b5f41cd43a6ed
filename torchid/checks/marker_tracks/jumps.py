"""Markers that leap between two frames, relative to the markers beside them, and where they are meanwhile."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.checks.marker_tracks.clusters import Clusters, MarkerShape, shape_of
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.recording import Markers
from torchid.runs import runs

BESIDE = 5
"""Choice. Markers beside one: those of its segment, then those to which it keeps its distance best."""
ELSEWHERE_M = 0.02
"""Choice. Scatter [m] that a marker of another segment is charged with when the most rigid neighbours are chosen."""
LEAP_M_S = 3.0
"""Calibrated. Speed against the markers beside it that a marker has for a single frame only if its label changed
[m/s]. On eight recorded sessions of walks, runs and squats at 100 Hz skin made up to 1.5 m/s, landings from a box up to
1.8 m/s, a loose chest marker 2.5 m/s; labels that changed made 5 to 7.5 m/s."""
LEAP_M = 0.02
"""Choice. Leap below which nothing is said at any rate [m]: as far as skin slides."""
STANDS_OUT = 8.0
"""Choice. So many times the median of a marker's own steps beyond those about a leap is at least."""
ABOUT = 3
"""Choice. Frames on either side that tell how fast a marker goes anyhow."""
AWAY_M = 0.005
"""Choice. Change of some distance across a leap from which a marker is at another place afterwards [m]; one that leaps
square to a flat segment changes its distances by little."""
WINDOW = 10
"""Resolution. Frames on either side of a leap that tell the distances there."""
PIECE = 4096
"""Resolution. Frames that are looked at together."""
SCATTER_M = 0.008
"""Calibrated. Standard deviation of such a step where nothing is wrong: a third of the largest on clean recordings."""


def beside(clusters: Clusters, shape: MarkerShape) -> Int[Tensor, "markers few"]:
    """Return the markers whose distance tells most of each one, the best first.

    Args:
        clusters: which markers sit on one segment.
        shape: of the trial itself.
    """
    far = torch.where(clusters.together, 0.0, ELSEWHERE_M).to(shape.sd)
    cost = torch.nan_to_num(shape.sd, nan=torch.inf) + far
    cost.fill_diagonal_(torch.inf)
    return cost.argsort(dim=1)[:, : min(BESIDE, max(len(cost) - 1, 0))]


def find_leaps(
    position: Float[Tensor, "frames markers 3"], rate: float, near: Int[Tensor, "markers few"]
) -> dict[int, dict[int, float]]:
    """Return by marker the frames after which it leaps against the markers beside it, and how far [m].

    Args:
        position: p_WM_W [m].
        rate: frames per second.
        near: markers beside each.
    """
    found: dict[int, dict[int, float]] = {}
    bound = None
    for start in range(0, max(len(position) - 1, 0), PIECE):
        first = max(0, start - ABOUT)
        excess = _excess(position[first : start + PIECE + ABOUT + 1], near)
        if bound is None:
            usual = torch.nan_to_num(excess.nanmedian(dim=0).values)
            bound = (STANDS_OUT * usual).clamp(min=max(LEAP_M, LEAP_M_S / rate))
        own = torch.nan_to_num(excess[start - first : start - first + PIECE])
        for frame, marker in (own > bound).nonzero().tolist():
            found.setdefault(marker, {})[start + frame] = float(own[frame, marker])
    return found


def _excess(position: Tensor, near: Tensor) -> Float[Tensor, "steps markers"]:
    """Return the length of each step beyond the steps about, and beyond the same of the markers beside [m]."""
    step = position.diff(dim=0)
    edge = step.new_full((ABOUT, *step.shape[1:]), torch.nan)
    usual = torch.cat([edge, step, edge]).unfold(0, 2 * ABOUT + 1, 1).nanmedian(dim=-1).values
    sudden = step - usual
    return (sudden - sudden[:, near].nanmedian(dim=2).values).norm(dim=-1)


def find_jumps(
    trial: str, markers: Markers, clusters: Clusters, references: Sequence[MarkerShape]
) -> list[TrackStatement]:
    """Return the markers that are away from their place between two leaps, or from a leap on.

    Args:
        trial: name of the trial.
        markers: its markers, exchanged ones with their own names.
        clusters: which markers sit on one segment.
        references: shapes of other trials, which say on which side of a leap a marker is at its place; without any,
            that is where it is most of the time.
    """
    if len(markers.time) < 2 * ABOUT or len(clusters.labels) < 2:
        return []
    position = markers.select(clusters.labels).position
    own = shape_of(trial, markers, clusters.labels)
    near, found = beside(clusters, own), []
    for marker, leaps in sorted(find_leaps(position, markers.rate, near).items()):
        distance = (position[:, marker, None] - position[:, near[marker]]).norm(dim=2)
        place = _place(marker, near[marker], clusters, own, references)
        mask = _away(distance - place, torch.isfinite(position[:, marker]).all(dim=1), sorted(leaps))
        if bool(mask.any()):
            found.append(_statement(trial, markers, clusters.labels[marker], mask, max(leaps.values()), references))
    return found


def _place(
    marker: int, near: Tensor, clusters: Clusters, own: MarkerShape, references: Sequence[MarkerShape]
) -> Float[Tensor, " few"]:
    """Return the distances that a marker should have to those beside it [m]: on its segment those of other trials, else
    those of its own trial."""
    usual = own.median[marker, near]
    if not references:
        return usual
    others = torch.stack([shape.median[marker, near] for shape in references]).nanmedian(dim=0).values
    return torch.where(clusters.together[marker, near] & torch.isfinite(others), others, usual)


def _away(off: Float[Tensor, "frames few"], seen: Bool[Tensor, " frames"], leaps: list[int]) -> Bool[Tensor, " frames"]:
    """Return the frames in which a marker is away from its place.

    Of the parts between leaps and gaps the longest of those with the least misfit is right. From there on, of two parts
    with a leap between them the one that is less like the right one is wrong, if distances change across it; behind a
    gap a part is wrong if it is more like one that is wrong than like the right one.

    Args:
        off: misfits of its distances [m].
        seen: frames in which it is seen.
        leaps: frames after which it leaps.
    """
    cuts = [0, *(k + 1 for k in leaps), len(off)]
    parts = [(a + i, a + j) for a, b in zip(cuts, cuts[1:], strict=False) for i, j in runs(seen[a:b])]
    middle = torch.stack([torch.nan_to_num(off[a:b].nanmedian(dim=0).values) for a, b in parts])
    right = _right(parts, middle.abs().mean(dim=1).tolist())
    unlike, wrong = (middle - middle[right]).abs().mean(dim=1), set[int]()
    for way in (range(right + 1, len(parts)), range(right - 1, -1, -1)):
        before = right
        for k in way:
            if min(parts[k][1], parts[before][1]) - 1 in leaps and before not in wrong:
                if _changes(off, parts[k], parts[before]) and float((middle[k] - middle[before]).abs().max()) > AWAY_M:
                    wrong.add(k if unlike[k] >= unlike[before] else before)
            elif any(float((middle[k] - middle[one]).abs().mean()) < unlike[k] for one in wrong):
                wrong.add(k)
            before = k
    mask = torch.zeros_like(seen)
    for k in wrong:
        mask[slice(*parts[k])] = True
    return mask


def _right(parts: list[tuple[int, int]], misfit: list[float]) -> int:
    """Return the longest of the parts with the least misfit; short ones may fit by chance."""
    length = [b - a for a, b in parts]
    able = [k for k in range(len(parts)) if length[k] >= min(WINDOW, max(length))]
    least = min(misfit[k] for k in able)
    return max((k for k in able if misfit[k] < least + AWAY_M), key=lambda k: length[k])


def _changes(off: Tensor, one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether distances differ between the ends, at which they meet, of two parts."""
    first, last = sorted((one, other))
    ends = off[max(first[0], first[1] - WINDOW) : first[1]], off[last[0] : min(last[1], last[0] + WINDOW)]
    change = (ends[1].nanmedian(dim=0).values - ends[0].nanmedian(dim=0).values).abs()
    return float(torch.nan_to_num(change).max()) > AWAY_M


def _statement(
    trial: str,
    markers: Markers,
    label: str,
    mask: Bool[Tensor, " frames"],
    size: float,
    references: Sequence[MarkerShape],
) -> TrackStatement:
    """Return what is said of a marker that is away in some frames."""
    time = markers.time
    when = tuple((float(time[a]), float(time[b - 1])) for a, b in runs(mask))
    kind = TrackFault.JUMP if len(when) == 1 else TrackFault.FLIP
    against = tuple(shape.trial for shape in references)
    return TrackStatement(
        kind, trial, (label,), when, 1e3 * size, 1e3 * SCATTER_M, share=float(mask.double().mean()), against=against
    )
