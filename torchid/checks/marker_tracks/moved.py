"""Where markers sit on their segment in one trial, against where they sit in others."""

import math
import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.marker_tracks.clusters import SCATTER_M, Clusters
from torchid.checks.marker_tracks.segment_shape import SegmentShape, align, segment_shape
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.recording import Markers

MOVED_M = 0.015
"""Prior. Standard deviation, per axis, of where a marker that was knocked or stuck on anew sits [m]; as far apart as
landmarks that are found anew by hand (Della Croce et al., Gait & Posture 21 (2005))."""
MOVED_SHARE = 0.02
"""Prior. Share of markers that sit elsewhere in a trial: over ten people's recordings as they are, one in fifty."""
NEAR_NATS = 3.0
"""Choice. Evidence behind that of the likeliest marker from which it is another one [nat]: one to twenty."""
RIGID = 1e-6
"""Resolution. Turn that leaves all markers where they are, over one that moves them most: of two, about their line."""


class Verdict(StrEnum):
    """What distances say of the place of a marker."""

    STAYS = "stays"
    """It is where it was."""
    MOVED = "moved"
    """It, and no other of its segment, sits elsewhere."""
    AMBIGUOUS = "ambiguous"
    """Distances of its segment changed, and it may be this marker or another."""
    UNTOLD = "untold"
    """Nothing tells: too few markers on the segment, or not seen in both trials."""


@dataclass(frozen=True)
class MarkerReading:
    """What the distances on a segment say of one marker in one trial."""

    label: str
    """The marker."""
    trial: str
    """The trial."""
    against: str
    """The trial that it is compared with."""
    displacement_mm: float
    """Likeliest distance from its place among the other markers of its segment, if it alone moved [mm]; NaN where
    nothing tells."""
    sd_mm: float
    """Standard deviation of that, along the way that it went: scatter between trials and, in both, over frames [mm]."""
    left_mm: float
    """Largest change of a distance between the others, which it does not explain [mm]."""
    verdict: Verdict
    """What follows."""
    among: tuple[str, ...]
    """Markers one of which moved, where that is ambiguous."""
    nats: float
    """Log Bayes factor of its having moved alone, over nothing or another one of the segment [nat]; zero where nothing
    tells."""


def read_segment(
    trial: str, against: str, own: SegmentShape, other: SegmentShape, scatter: float = SCATTER_M
) -> list[MarkerReading]:
    """Return what the distances of one segment say of each of its markers.

    Args:
        trial: the trial looked at.
        against: the trial that it is compared with.
        own: shape in the trial.
        other: shape in the other.
        scatter: standard deviation of its distances from trial to trial [m].
    """
    labels = tuple(label for label in own.labels if label in other.labels)
    if len(labels) < 2:
        return []
    own, other = own.only(labels), other.only(labels)
    lone = lone_displacements(own, other, scatter)
    alone, moved, sd = lone.nats, lone.shift.norm(dim=1), lone.sd_along
    over = alone - _otherwise(alone)
    change = (_pairs(own.place) - _pairs(other.place)).abs()
    rest = [[j for j in range(len(labels)) if j != k] for k in range(len(labels))]
    left = torch.stack([change[r][:, r].max() for r in rest])
    told = float(alone.logsumexp(0)) + math.log(MOVED_SHARE) > 0.0
    near = [k for k in range(len(labels)) if told and float(alone[k]) > float(alone.max()) - NEAR_NATS]
    several = tuple(labels[k] for k in near) if len(near) > 1 else ()
    verdicts = [
        Verdict.STAYS if k not in near else Verdict.AMBIGUOUS if several else Verdict.MOVED for k in range(len(labels))
    ]
    found = []
    for k, label in enumerate(labels):
        among = several if k in near else ()
        size, scale, others = (1e3 * float(x[k]) for x in (moved, sd, left))
        found.append(MarkerReading(label, trial, against, size, scale, others, verdicts[k], among, float(over[k])))
    return found


@dataclass(frozen=True)
class LoneDisplacements:
    """What a segment's shape in two trials says of each of its markers, if it alone moved between them."""

    nats: Float[Tensor, " markers"]
    """Log Bayes factor over none having moved [nat]."""
    shift: Float[Tensor, "markers 3"]
    """Likeliest displacement, in axes of the other shape [m]."""
    covariance: Float[Tensor, "markers 3 3"]
    """Covariance of that [m^2]."""

    @property
    def sd_along(self) -> Float[Tensor, " markers"]:
        """Return the standard deviation of each displacement along itself [m]."""
        way = torch.nn.functional.normalize(self.shift, dim=1)
        return ((way[:, None] @ self.covariance) @ way[:, :, None])[:, 0, 0].sqrt()


def lone_displacements(own: SegmentShape, other: SegmentShape, scatter: float = SCATTER_M) -> LoneDisplacements:
    """Return the displacement of each marker that alone would have moved.

    Places err by their scatter, per axis, and one of them by MOVED_M besides. Turns and shifts of the segment take
    some of a displacement away: with P the projection beside them, that of marker k is known by A = E_k' P E_k, of two
    markers along their line alone.

    Args:
        own: shape in one trial.
        other: shape of the same markers in another.
        scatter: standard deviation of the segment's distances from trial to trial [m].
    """
    # A distance has two ends.
    sd = torch.sqrt(0.5 * scatter**2 + own.sd.square() + other.sd.square())
    R, t = align(own.place, other.place)
    x = (other.place - other.place.mean(dim=0)) / sd[:, None]
    axes = torch.eye(3).to(x)
    turns = torch.linalg.cross(axes[None], x[:, None], dim=2).mT
    rigid = torch.cat([axes / sd[:, None, None], turns], dim=2)
    U, scale, _ = torch.linalg.svd(rigid.reshape(-1, 6), full_matrices=False)
    U = U[:, scale > RIGID * scale[0]]
    error = ((own.place @ R.mT + t - other.place) / sd[:, None]).reshape(-1)
    b = (error - U @ (U.mT @ error)).reshape(-1, 3)
    U = U.reshape(len(x), 3, -1)
    m = (MOVED_M / sd).square()[:, None, None]
    inverse = torch.linalg.inv(axes + m * (axes - U @ U.mT))
    d = (m * inverse @ b[:, :, None])[:, :, 0]
    nats = 0.5 * ((b * d).sum(dim=1) + torch.logdet(inverse))
    return LoneDisplacements(nats, sd[:, None] * d, MOVED_M**2 * inverse)


def _otherwise(alone: Float[Tensor, " markers"]) -> Float[Tensor, " markers"]:
    """Return, for each marker, the log Bayes factor of another one having moved or none, over none [nat]."""
    n = len(alone)
    others = alone.expand(n, n).clone().fill_diagonal_(-math.inf) + math.log(MOVED_SHARE)
    none = others.new_full((n, 1), (n - 1) * math.log1p(-MOVED_SHARE))
    return torch.cat([none, others], dim=1).logsumexp(dim=1)


def _pairs(place: Tensor) -> Float[Tensor, "markers markers"]:
    """Return the distances between places [m]."""
    return (place[:, None] - place).norm(dim=2)


def marker_readings(
    trials: Mapping[str, Markers], clusters: Clusters, against: Mapping[str, Sequence[str]]
) -> list[MarkerReading]:
    """Return what distances say of the place of every marker in every trial, against each of some other trials.

    Args:
        trials: markers of each trial, bad samples taken out, exchanged ones with their own names.
        clusters: which markers sit on one segment.
        against: by trial, the names of the trials that it is compared with.
    """
    segments = dict.fromkeys(clusters.segments)
    names = {segment: [clusters.labels[k] for k in clusters.on(segment)] for segment in segments}
    scatter = dict(zip(clusters.segments, clusters.scatter, strict=True))
    bodies = {(t, s): segment_shape(markers, names[s]) for t, markers in trials.items() for s in segments}
    found = []
    for trial in trials:
        for other in against[trial]:
            for segment in segments:
                own, theirs = bodies[trial, segment], bodies[other, segment]
                told = (
                    [] if own is None or theirs is None else read_segment(trial, other, own, theirs, scatter[segment])
                )
                known = {one.label for one in told}
                found += told + [_untold(label, trial, other) for label in names[segment] if label not in known]
    return found


def _untold(label: str, trial: str, other: str) -> MarkerReading:
    """Return the reading of a marker of which nothing is known."""
    nan = float("nan")
    return MarkerReading(label, trial, other, nan, nan, nan, Verdict.UNTOLD, (), 0.0)


def moved_markers(readings: Sequence[MarkerReading]) -> list[TrackStatement]:
    """Return the markers that sit elsewhere in a trial than in more than half of those that it is compared with.

    Args:
        readings: of any trials.
    """
    found: dict[tuple[str, tuple[str, ...]], list[MarkerReading]] = {}
    compared: dict[tuple[str, str], int] = {}
    for one in readings:
        if one.verdict is not Verdict.UNTOLD:
            compared[one.trial, one.label] = compared.get((one.trial, one.label), 0) + 1
        if one.verdict is Verdict.MOVED:
            found.setdefault((one.trial, (one.label,)), []).append(one)
        elif one.verdict is Verdict.AMBIGUOUS and one.label == one.among[0]:
            found.setdefault((one.trial, one.among), []).append(one)
    return [
        _statement(some)
        for (trial, labels), some in found.items()
        if 2 * len({one.against for one in some}) > compared[trial, labels[0]]
    ]


def moved_nats(readings: Sequence[MarkerReading], label: str, trials: Collection[str]) -> float:
    """Return the log Bayes factor of a marker sitting elsewhere in some trials than in others [nat].

    Trials that are compared are not independent of each other: the middle one of the comparisons speaks for all, of two
    the lesser; zero where none tells.

    Args:
        readings: of any trials.
        label: the marker.
        trials: those in which it is said to sit elsewhere.
    """
    own = [one for one in readings if one.label == label and one.verdict is not Verdict.UNTOLD]
    across = [one.nats for one in own if (one.trial in trials) is not (one.against in trials)]
    return statistics.median_low(across) if across else 0.0


def _statement(some: Sequence[MarkerReading]) -> TrackStatement:
    """Return the statement that readings of one marker, or of one group, amount to."""
    first = sorted(some, key=lambda one: one.displacement_mm)[len(some) // 2]
    labels = first.among or (first.label,)
    against = tuple(dict.fromkeys(one.against for one in some))
    return TrackStatement(
        TrackFault.MOVED, first.trial, labels, (), first.displacement_mm, first.sd_mm, first.left_mm, against=against
    )
