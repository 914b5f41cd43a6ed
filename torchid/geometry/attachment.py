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


def rigid_scatter(
    position: Float[Tensor, "frames 3"],
    clusters: dict[int, Float[Tensor, "frames markers 3"]],
) -> dict[int, tuple[float, int]]:
    """Tell how rigidly an unassigned marker moves with the markers of each body.

    The criterion is the mean variance of the distances to the body's markers, which needs neither a fit nor axes.
    Bodies with fewer than two markers, or fewer than ten common frames, are passed over.

    Args:
        position: path of the unassigned marker, NaN where missing [m].
        clusters: paths of the markers of each body, by the body's index in the tree, NaN where missing [m].

    Returns:
        By the body's index, the criterion [m^2] and the common frames.
    """
    found = {}
    for body, markers in clusters.items():
        distance = (markers - position[:, None]).norm(dim=2)
        common = torch.isfinite(distance).all(dim=1)
        frames = int(common.sum())
        if markers.shape[1] >= 2 and frames >= 10:
            found[body] = float(distance[common].var(dim=0).mean()), frames
    return found
