"""The shape that the markers of one segment have in a trial, and how one is laid on another."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.marker_tracks.clusters import MAD_SD, evenly
from torchid.recording import Markers

FRAMES = 120
"""Resolution. Frames of a trial that tell the shape of a segment."""
FEWEST = 5
"""Choice. Frames in which all markers of a segment are seen from which its shape is known, if a trial has as many."""


@dataclass(frozen=True)
class SegmentShape:
    """The shape of a segment's markers in one trial, in axes of its own."""

    labels: tuple[str, ...]
    """Markers that the trial shows."""
    place: Float[Tensor, "markers 3"]
    """Median place [m]."""
    sd: Float[Tensor, " markers"]
    """Scatter of each over the frames, per axis [m]."""

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


def segment_shape(markers: Markers, labels: Sequence[str]) -> SegmentShape | None:
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
    sd = MAD_SD * (laid - place).abs().median(dim=0).values.square().mean(dim=1).sqrt()
    return SegmentShape(tuple(labels[k] for k in kept), place, sd)
