"""Which marker sits on which segment, how well its place is known beforehand, and where unknown labels belong."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Attachment:
    """Markers of a subject on the bodies of a tree."""

    labels: tuple[str, ...]
    body: Int[Tensor, " markers"]
    """Tree index of the segment."""
    mean: Float[Tensor, "markers 3"]
    """Prior mean of p_BM_B [m]."""
    sd: Float[Tensor, "markers 3"]
    """Prior scatter [m]; large for markers that are free on their segment."""
    landmark: tuple[str | None, ...]

    @property
    def known(self) -> Tensor:
        """Markers on a landmark: their template place means something."""
        return torch.tensor([name is not None for name in self.landmark], device=self.body.device)


def rigid_segment(
    position: Float[Tensor, "frames 3"],
    clusters: dict[int, Float[Tensor, "frames markers 3"]],
) -> tuple[int, float]:
    """Body with whose markers an unassigned marker moves most rigidly, and the scatter of its distances [m].

    The criterion is the mean standard deviation of the distances to the body's markers (needs no fit and no axes).
    Bodies with fewer than two markers, or fewer than ten common frames, are passed over.
    """
    best, scatter = -1, float("inf")
    for body, markers in clusters.items():
        if markers.shape[1] < 2:
            continue
        distance = (markers - position[:, None]).norm(dim=2)
        common = torch.isfinite(distance).all(dim=1)
        if int(common.sum()) < 10:
            continue
        found = float(distance[common].std(dim=0).mean())
        if found < scatter:
            best, scatter = body, found
    return best, scatter
