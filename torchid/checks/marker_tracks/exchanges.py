"""Labels that carry each other's marker: distances to the markers beside them, or their paths, fit better exchanged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.checks.marker_tracks.clusters import SCATTER_M, Clusters, MarkerShape
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.recording import Markers
from torchid.runs import runs

SUSPECT_M = 0.02
"""Choice. A marker is looked at where a distance to another of its segment is off by this [m]: exchanged markers that
are nearer to each other bend a posture less than skin does."""
UNDONE = 0.4
"""Calibrated. Part of the misfit of distances that may be left with the names exchanged. Toes that bend brought a wrong
pair of eight recorded sessions to 0.4 for a tenth of a second; exchanged markers leave 0.1."""
UNDONE_ALONE = 0.25
"""Choice. The same where only one of the two markers is seen, or all is told by one marker beside them, which may be
the one that is wrong."""
SAVED_M = 0.01
"""Calibrated. Mean misfit of distances that exchanging must take away [m]: three times what distances on one segment
scatter by from trial to trial (3.5 mm)."""
SHORTEST = 5
"""Choice. Frames from which an exchange counts; the effect ``marker_swap`` asks for as many."""
BRIDGED_S = 0.1
"""Choice. An exchange goes on through frames that do not tell, for this long [s]."""
THROUGHOUT = 0.9
"""Choice. Share of the frames that tell from which an exchange lasts throughout: static postures at the ends of a walk
or a marker that is lost for a while leave a tenth open."""


@dataclass(frozen=True)
class ExchangeMisfit:
    """How two markers of one trial fit a shape, as labelled and exchanged."""

    now: Float[Tensor, " frames"]
    """Mean misfit of distances as labelled [m]; NaN where nothing tells."""
    undone: Float[Tensor, " frames"]
    """The same with the names exchanged [m]."""
    twice: Bool[Tensor, " frames"]
    """Both markers are seen, and there are two beside them."""

    @property
    def exchanged(self) -> Bool[Tensor, " frames"]:
        """Return the frames that fit better the other way round."""
        part = torch.where(self.twice, UNDONE, UNDONE_ALONE)
        return (self.undone < part * self.now) & (self.now - self.undone > SAVED_M)


def suspects(
    position: Float[Tensor, "frames markers 3"], together: Bool[Tensor, "markers markers"], shape: MarkerShape
) -> Bool[Tensor, "frames markers"]:
    """Return where some distance of a marker on its segment is plainly not that of the shape.

    Args:
        position: p_WM_W [m].
        together: pairs on one segment.
        shape: of another trial.
    """
    known = together & torch.isfinite(shape.median)
    found = torch.zeros(position.shape[:2], dtype=torch.bool)
    for a, b in known.triu().nonzero().tolist():
        off = ((position[:, a] - position[:, b]).norm(dim=1) - shape.median[a, b]).abs() > SUSPECT_M
        found[:, a] |= off
        found[:, b] |= off
    return found


@dataclass(frozen=True)
class PairDistances:
    """Distances of two markers from those beside them, one row for each of either's."""

    own: list[int]
    """Which of the two the row is of."""
    beside: list[int]
    """The marker beside it."""
    now: Float[Tensor, "distances frames"]
    """As labelled [m]."""
    undone: Float[Tensor, "distances frames"]
    """With the names exchanged [m]."""
    twice: Bool[Tensor, " frames"]
    """As in ``ExchangeMisfit``."""

    def misfit(self, shape: MarkerShape) -> ExchangeMisfit:
        """Return how the two fit a shape, as labelled and exchanged.

        Where one of them is not seen the other tells. Fewer than two distances tell nothing.

        Args:
            shape: of another trial.
        """
        usual = shape.median[self.own, self.beside][:, None]
        return ExchangeMisfit(_mean((self.now - usual).abs()), _mean((self.undone - usual).abs()), self.twice)


def distances_of(
    place: Float[Tensor, "markers frames 3"], together: Bool[Tensor, "markers markers"], pair: tuple[int, int]
) -> PairDistances:
    """Return the distances of two markers from those on their segment.

    Args:
        place: p_WM_W [m].
        together: pairs on one segment.
        pair: indices of the markers.
    """
    each = [
        (own, other, k)
        for own, other in (pair, pair[::-1])
        for k in together[own].nonzero()[:, 0].tolist()
        if k not in pair
    ]
    own, other, beside = ([one[n] for one in each] for n in range(3))
    to = place[beside]
    now, undone = ((place[some] - to).norm(dim=2) for some in (own, other))
    both = torch.isfinite(place[list(pair)]).all(dim=2).all(dim=0)
    return PairDistances(own, beside, now, undone, both & (len(set(beside)) > 1))


def _mean(misfits: Float[Tensor, "distances frames"]) -> Float[Tensor, " frames"]:
    """Return the mean of those that are known; NaN where fewer than two are."""
    known = torch.isfinite(misfits).sum(dim=0)
    return torch.where(known >= 2, misfits.nansum(dim=0) / known, torch.nan)


def find_exchanges(
    trial: str, markers: Markers, clusters: Clusters, shapes: Sequence[MarkerShape]
) -> list[TrackStatement]:
    """Return the exchanges of labels in a trial that more than half of the other shapes tell.

    Args:
        trial: name of the trial.
        markers: its markers.
        clusters: which markers sit on one segment.
        shapes: of other trials; of the trial itself where there are none.
    """
    position = markers.select(clusters.labels).position.clone()
    told = _told(position, clusters.together, shapes, _candidates(position, clusters, shapes))
    against = tuple(shape.trial for shape in shapes if shape.trial != trial)
    taken = torch.zeros(position.shape[:2], dtype=torch.bool)
    rate = markers.rate if len(markers.time) > 1 else 1.0
    statements = []
    # One by one, the plainest first and put right before the others are asked: exchanged markers contradict those
    # beside them too.
    while told:
        free = [replace(one, at=one.at & ~taken[:, list(one.pair)].any(dim=1)) for one in told]
        lasting = [replace(one, at=_lasting(one, rate)) for one in free]
        best = max((one for one in lasting if one.at.any()), key=lambda one: one.saved, default=None)
        if best is None:
            break
        statements.append(_statement(trial, markers, clusters, best, against))
        rows, pair = best.at.nonzero(), torch.tensor(best.pair)
        taken[rows, pair] = True
        position[rows, pair] = position[rows, pair.flip(0)]
        told = _told(position, clusters.together, shapes, [one.pair for one in told if one.pair != best.pair])
    return statements


@dataclass(frozen=True)
class Told:
    """Two markers whose exchange most shapes tell."""

    pair: tuple[int, int]
    at: Bool[Tensor, " frames"]
    """Frames in which they do."""
    now: Float[Tensor, " frames"]
    """Mean misfit as labelled, the median over the shapes [m]."""
    undone: Float[Tensor, " frames"]
    """The same with the names exchanged [m]."""

    @property
    def saved(self) -> float:
        """Return the misfit that exchanging takes away, summed over the frames [m]."""
        return float(((self.now - self.undone) * self.at).nansum())


def _candidates(position: Tensor, clusters: Clusters, shapes: Sequence[MarkerShape]) -> list[tuple[int, int]]:
    """Return the pairs of markers that most shapes find doubtful in the same frames."""
    doubtful = [suspects(position, clusters.together, shape) for shape in shapes]
    if not doubtful:
        return []
    most = torch.stack(doubtful).sum(dim=0) * 2 > len(doubtful)
    either = (most | ~torch.isfinite(position).all(dim=2)).double()
    both = most.double().T @ either
    both = torch.maximum(both, both.T)
    known = clusters.together.any(dim=1)
    pairs = (both.triu(1) >= min(SHORTEST, len(position))).nonzero().tolist()
    return [(a, b) for a, b in pairs if known[a] and known[b]]


def _told(
    position: Tensor, together: Tensor, shapes: Sequence[MarkerShape], pairs: Sequence[tuple[int, int]]
) -> list[Told]:
    """Return the pairs whose exchange most shapes tell in some frames."""
    found, place = [], position.transpose(0, 1).contiguous()
    for pair in pairs:
        apart = distances_of(place, together, pair)
        each = [apart.misfit(shape) for shape in shapes]
        votes = torch.stack([one.exchanged for one in each]).sum(dim=0)
        told = torch.stack([torch.isfinite(one.now) & torch.isfinite(one.undone) for one in each]).sum(dim=0)
        at = (2 * votes > told) & (votes > 0)
        if int(at.sum()) >= min(SHORTEST, len(position)):
            middle = [torch.stack([getattr(one, name) for one in each]).nanmedian(dim=0).values for name in _MISFITS]
            found.append(Told(pair, at, *middle))
    return found


_MISFITS = ("now", "undone")


def _lasting(one: Told, rate: float) -> Bool[Tensor, " frames"]:
    """Return the runs of an exchange that last, through frames that do not tell for a moment.

    Where nearly all that tell, tell an exchange, it goes on wherever they do not tell the contrary.
    """
    at, told = one.at, torch.isfinite(one.now) & torch.isfinite(one.undone)
    if int((at & told).sum()) >= THROUGHOUT * max(int(told.sum()), 1):
        return ~(told & (one.now < one.undone))
    filled = at.clone()
    for start, stop in runs(~at):
        if 0 < start and stop < len(at) and stop - start <= BRIDGED_S * rate:
            filled[start:stop] = True
    out = torch.zeros_like(at)
    for start, stop in runs(filled):
        if int(at[start:stop].sum()) >= SHORTEST:
            out[start:stop] = True
    return out


def exchanged_jumps(markers: Markers, jumps: Sequence[TrackStatement]) -> list[TrackStatement]:
    """Return the exchanges among markers that leap in the same frames: each goes on where the other was.

    On a segment with two markers no distance tells them, but both paths do.

    Args:
        markers: of the trial that the statements are of.
        jumps: what is said of markers that leap.
    """
    found, left = [], list(jumps)
    while left:
        one = left.pop(0)
        steps = {k: _goes_on(markers, one, other) for k, other in enumerate(left) if other.when == one.when}
        told = [
            (undone, now, k) for k, (now, undone) in steps.items() if undone < UNDONE * now and now - undone > SAVED_M
        ]
        if told:
            undone, now, k = min(told)
            labels = (*one.labels, *left.pop(k).labels)
            size, rest = 1e3 * now, 1e3 * undone
            found.append(replace(one, kind=TrackFault.EXCHANGED, labels=labels, size_mm=size, left_mm=rest))
    return found


def _goes_on(markers: Markers, one: TrackStatement, other: TrackStatement) -> tuple[float, float]:
    """Return the mean steps of two paths at the ends of their times, as labelled and exchanged [m]; NaN where no step
    is seen."""
    index = [markers.labels.index(label) for label in (*one.labels, *other.labels)]
    pair = markers.position[:, index]
    seen = torch.isfinite(pair).all(dim=2).all(dim=1).nonzero()[:, 0]
    inside = one.inside(markers.time)[seen]
    edges = ((inside[1:] != inside[:-1]) & (seen.diff() <= max(1.0, BRIDGED_S * markers.rate))).nonzero()[:, 0]
    before, after = pair[seen[edges]], pair[seen[edges + 1]]
    return float((after - before).norm(dim=-1).mean()), float((after.flip(1) - before).norm(dim=-1).mean())


def _statement(
    trial: str, markers: Markers, clusters: Clusters, one: Told, against: tuple[str, ...]
) -> TrackStatement:  # fmt: skip
    at, time, told = one.at, markers.time, torch.isfinite(one.now)
    when = () if bool(at.all()) else tuple((float(time[a]), float(time[b - 1])) for a, b in runs(at))
    labels = tuple(clusters.labels[k] for k in one.pair)
    share = float((at & told).sum()) / max(float(told.sum()), 1.0)
    size, left = (1e3 * float(x[at].nanmedian()) for x in (one.now, one.undone))
    return TrackStatement(TrackFault.EXCHANGED, trial, labels, when, size, 1e3 * SCATTER_M, left, share, against)
