"""This module says which marker sits on which segment, how well its place is known, and where a new label belongs."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Attachment:
    """The markers of a subject on the bodies of a tree, with the prior of their places."""

    labels: tuple[str, ...]
    body: Int[Tensor, " markers"]
    """Each marker's segment as its index in the tree."""
    mean: Float[Tensor, "markers 3"]
    """Prior mean of p_BM_B [m]."""
    sd: Float[Tensor, "markers 3"]
    """Prior scatter [m]; large for markers that are free on their segment."""
    landmark: tuple[str | None, ...]
    """Each marker's landmark on the template; None for markers that are free on their segment."""

    @property
    def known(self) -> Tensor:
        """Return the mask of the markers on a landmark, whose places on the template are known (markers,)."""
        return torch.tensor([name is not None for name in self.landmark], device=self.body.device)


def rigid_segment(
    position: Float[Tensor, "frames 3"],
    clusters: dict[int, Float[Tensor, "frames markers 3"]],
) -> tuple[int, float]:
    """Find the body with whose markers an unassigned marker moves most rigidly.

    The criterion is the mean standard deviation of the distances to the body's markers, which needs neither a fit nor
    axes. Bodies with fewer than two markers, or fewer than ten common frames, are passed over.

    Args:
        position: path of the unassigned marker, NaN where missing [m].
        clusters: paths of the markers of each body, by the body's index in the tree, NaN where missing [m].

    Returns:
        The body's index, -1 if no body qualifies, and the criterion [m], infinite if no body qualifies.
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
