"""Where markers sit on their segment in one trial, against where they sit in others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.marker_tracks.clusters import MAD_SD, SCATTER_M, Clusters, evenly
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.recording import Markers

ENOUGH = 4
"""Derived. Markers of a segment from which one can be told from the others: of three, each distance has two ends."""
MOVED_SD = 3.0
"""Derived. Standard deviations from which a displacement is no chance: one in 400."""
MOVED_M = 0.015
"""Calibrated. Displacement from which it is said [m]. Below, one in twenty segments of eleven recorded sessions
differed between postures; 12 of 16 markers that were moved by 15 to 25 mm outside the chest were named."""
AGREE_PART = 0.5
"""Choice. Part of the displacement within which the other distances of the segment must agree without the marker."""
FRAMES = 120
"""Resolution. Frames of a trial that tell the shape of a segment."""
FEWEST = 5
"""Choice. Frames in which all markers of a segment are seen from which its shape is known, if a trial has as many."""


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
    """Distance from its place among the other markers of its segment [mm]; of two or three markers the largest change
    of a distance to it; NaN where nothing tells."""
    sd_mm: float
    """Standard deviation of that where nothing moved: scatter between trials and, in both, over frames [mm]."""
    left_mm: float
    """Largest change of a distance between the others, which it does not explain [mm]."""
    verdict: Verdict
    """What follows."""
    among: tuple[str, ...]
    """Markers one of which moved, where that is ambiguous."""

    @property
    def z(self) -> float:
        """Return the displacement in standard deviations."""
        return self.displacement_mm / self.sd_mm


@dataclass(frozen=True)
class SegmentShape:
    """The shape of a segment's markers in one trial, in axes of its own."""

    labels: tuple[str, ...]
    """Markers that the trial shows."""
    place: Float[Tensor, "markers 3"]
    """Median place [m]."""
    sd: Float[Tensor, " markers"]
    """Scatter of each over the frames [m]."""

    def only(self, labels: Sequence[str]) -> "SegmentShape":
        """Return some of the markers.

        Args:
            labels: their names.
        """
        index = [self.labels.index(label) for label in labels]
        return SegmentShape(tuple(labels), self.place[index], self.sd[index])


def align(
    source: Float[Tensor, "*batch markers 3"], target: Float[Tensor, "*batch markers 3"]
) -> tuple[Float[Tensor, "*batch 3 3"], Float[Tensor, "*batch 3"]]:
    """Return rotation R and shift t for which R source + t is nearest to target (Kabsch 1976).

    Args:
        source: points [m].
        target: the same points elsewhere [m].
    """
    a, b = source.mean(dim=-2, keepdim=True), target.mean(dim=-2, keepdim=True)
    U, _, Vh = torch.linalg.svd((target - b).mT @ (source - a))
    flip = torch.ones_like(source[..., 0, :])
    flip[..., 2] = torch.linalg.det(U @ Vh)
    R = U @ (flip[..., None] * Vh)
    return R, (b - a @ R.mT)[..., 0, :]


def body_of(markers: Markers, labels: Sequence[str]) -> SegmentShape | None:
    """Return the shape of a segment in a trial; None where no two of its markers are seen together.

    A marker that is lost in more than half of the frames is left out, so that it does not hide the others.

    Args:
        markers: of the trial.
        labels: markers of the segment.
    """
    some = markers.frames(evenly(len(markers.time), 4 * FRAMES)).select(tuple(labels))
    seen = torch.isfinite(some.position).all(dim=2)
    kept = [k for k in range(len(labels)) if 2 * int(seen[:, k].sum()) > len(seen)]
    whole = seen[:, kept].all(dim=1).nonzero()[:, 0]
    if len(kept) < 2 or len(whole) < min(FEWEST, len(seen)):
        return None
    p = some.position[whole[evenly(len(whole), FRAMES)]][:, kept]
    distance = (p[:, :, None] - p[:, None]).norm(dim=3)
    typical = p[int((distance - distance.median(dim=0).values).abs().sum(dim=(1, 2)).argmin())]
    R, t = align(p, typical.expand_as(p))
    laid = p @ R.mT + t[:, None]
    place = laid.median(dim=0).values
    sd = MAD_SD * (laid - place).norm(dim=2).median(dim=0).values
    return SegmentShape(tuple(labels[k] for k in kept), place, sd)


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
    change = (_pairs(own.place) - _pairs(other.place)).abs()
    sd = torch.sqrt(scatter**2 + own.sd.square() + other.sd.square())
    rest = [[j for j in range(len(labels)) if j != k] for k in range(len(labels))]
    left = torch.stack([change[r][:, r].max() for r in rest])
    if len(labels) >= ENOUGH:
        moved = torch.stack([_displacement(own.place, other.place, k, r) for k, r in enumerate(rest)])
    else:
        moved = change.max(dim=1).values
    told = (moved > MOVED_SD * sd) & (moved > MOVED_M)
    culprit = int(left.argmin())
    alone = len(labels) >= ENOUGH and bool(told[culprit]) and bool(left[culprit] < AGREE_PART * moved[culprit])
    pairs = (change > MOVED_M) & (change > MOVED_SD * torch.maximum(sd[:, None], sd))
    among = (
        () if alone else tuple(label for label, own_pairs in zip(labels, pairs, strict=True) if bool(own_pairs.any()))
    )
    found = []
    for k, label in enumerate(labels):
        verdict = Verdict.AMBIGUOUS if label in among else Verdict.MOVED if alone and k == culprit else Verdict.STAYS
        size, scale, rest_mm = (1e3 * float(x[k]) for x in (moved, sd, left))
        others = among if label in among else ()
        found.append(MarkerReading(label, trial, against, size, scale, rest_mm, verdict, others))
    return found


def _pairs(place: Tensor) -> Float[Tensor, "markers markers"]:
    """Return the distances between places [m]."""
    return (place[:, None] - place).norm(dim=2)


def _displacement(own: Tensor, other: Tensor, marker: int, rest: list[int]) -> Float[Tensor, ""]:
    """Return how far a marker is from its place once the rest of its segment is laid on the rest of the other [m]."""
    R, t = align(own[rest], other[rest])
    return (R @ own[marker] + t - other[marker]).norm()


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
    bodies = {(t, s): body_of(markers, names[s]) for t, markers in trials.items() for s in segments}
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
    return MarkerReading(label, trial, other, nan, nan, nan, Verdict.UNTOLD, ())


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


def _statement(some: Sequence[MarkerReading]) -> TrackStatement:
    """Return the statement that readings of one marker, or of one group, amount to."""
    first = sorted(some, key=lambda one: one.displacement_mm)[len(some) // 2]
    labels = first.among or (first.label,)
    against = tuple(dict.fromkeys(one.against for one in some))
    return TrackStatement(
        TrackFault.MOVED, first.trial, labels, (), first.displacement_mm, first.sd_mm, first.left_mm, against=against
    )
