"""Markers that one segment carries, their distances, and the shape that they have in a trial."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.recording import Markers

MAD_SD = 1.4826
"""Derived. Standard deviation of normal values over their median absolute deviation."""
SAMPLED = 400
"""Resolution. Frames that tell the shape of a trial: more change a median by less than a tenth of its scatter."""
SCATTER_M = 0.0035
"""Measured. Standard deviation of distances on one segment from trial to trial, over eleven people [m]."""
FEWEST = 5
"""Choice. Frames in which a distance is seen from which it is known, if a trial has as many."""


@dataclass(frozen=True)
class Clusters:
    """Which markers sit on one segment."""

    labels: tuple[str, ...]
    """All markers."""
    segments: tuple[str, ...]
    """Segment of each."""
    scatter: tuple[float, ...]
    """Standard deviation of the distances to it from trial to trial [m]."""

    @staticmethod
    def of(segments: Mapping[str, str], scatter: Mapping[str, float] | None = None) -> "Clusters":
        """Return the clusters of markers.

        Args:
            segments: segment of each label.
            scatter: standard deviation of distances from trial to trial on segments that are less rigid than most [m].
        """
        given = scatter or {}
        own = tuple(given.get(segment, SCATTER_M) for segment in segments.values())
        return Clusters(tuple(segments), tuple(segments.values()), own)

    @staticmethod
    def unknown(labels: Iterable[str]) -> "Clusters":
        """Return markers of which nobody knows the segments: each is alone.

        Args:
            labels: the markers.
        """
        return Clusters.of({label: label for label in labels})

    @property
    def together(self) -> Bool[Tensor, "markers markers"]:
        """Return the pairs of different markers on one segment."""
        names = {name: k for k, name in enumerate(dict.fromkeys(self.segments))}
        number = torch.tensor([names[name] for name in self.segments])
        return (number[:, None] == number) & ~torch.eye(len(number), dtype=torch.bool)

    def on(self, segment: str) -> tuple[int, ...]:
        """Return the indices of the markers of a segment.

        Args:
            segment: its name.
        """
        return tuple(k for k, name in enumerate(self.segments) if name == segment)


@dataclass(frozen=True)
class MarkerShape:
    """Distances between the markers of a trial."""

    trial: str
    """Name of the trial."""
    median: Float[Tensor, "markers markers"]
    """Median over the frames [m]; NaN where a pair is hardly ever seen."""
    sd: Float[Tensor, "markers markers"]
    """Scatter over the frames, from the median absolute deviation [m]; NaN as above."""


def pair_distances(position: Float[Tensor, "frames markers 3"]) -> Float[Tensor, "frames markers markers"]:
    """Return all distances between markers in each frame [m], NaN where one is not seen.

    Args:
        position: p_WM_W [m].
    """
    return (position[:, :, None] - position[:, None]).norm(dim=-1)


def evenly(frames: int, most: int) -> Int[Tensor, " picked"]:
    """Return indices of at most so many frames, spread over all.

    Args:
        frames: how many there are.
        most: how many are wanted.
    """
    return torch.linspace(0, frames - 1, min(frames, most), dtype=torch.float64).round().long()


def shape_of(trial: str, markers: Markers, labels: tuple[str, ...]) -> MarkerShape:
    """Return the shape of a trial's markers.

    Args:
        trial: name of the trial.
        markers: its markers.
        labels: markers to look at; those that the trial lacks have no distances.
    """
    if not len(markers.time):
        nothing = torch.full((len(labels), len(labels)), torch.nan, dtype=torch.float64)
        return MarkerShape(trial, nothing, nothing)
    distance = pair_distances(markers.frames(evenly(len(markers.time), SAMPLED)).select(labels).position)
    median = distance.nanmedian(dim=0).values
    sd = MAD_SD * (distance - median).abs().nanmedian(dim=0).values
    known = torch.isfinite(distance).sum(dim=0) >= min(FEWEST, len(distance))
    return MarkerShape(trial, torch.where(known, median, torch.nan), torch.where(known, sd, torch.nan))
