"""Markers that stand still while those beside them move."""

import torch
from jaxtyping import Int
from torch import Tensor

from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.recording import Markers
from torchid.runs import runs

STILL_M = 2e-5
"""Choice. Step from frame to frame of a marker that nobody measures [m]: a tenth of the noise of the best cameras."""
SHORTEST_S = 0.1
"""Choice. Time from which a stretch counts [s]: nobody's foot rests for less."""
WAY_M = 0.02
"""Choice. Way of the markers beside it meanwhile [m], as far as skin slides."""


def find_frozen(
    trial: str, markers: Markers, labels: tuple[str, ...], near: Int[Tensor, "markers few"]
) -> list[TrackStatement]:
    """Return the markers that stand still while at least half of those beside them go on.

    Args:
        trial: name of the trial.
        markers: its markers.
        labels: markers to look at.
        near: markers beside each (``jumps.beside``).
    """
    if len(markers.time) < 2:
        return []
    position = markers.select(labels).position
    still = position.diff(dim=0).norm(dim=2) < STILL_M
    found = []
    for k in still.any(dim=0).nonzero()[:, 0].tolist():
        parts = [(a, b) for a, b in runs(still[:, k]) if b - a >= SHORTEST_S * markers.rate]
        ways = {part: _way(position[:, near[k]], part) for part in parts}
        bad = [part for part in parts if ways[part] > WAY_M]
        if bad:
            when = tuple((float(markers.time[a]), float(markers.time[b])) for a, b in bad)
            share = sum(b - a for a, b in bad) / len(markers.time)
            size = 1e3 * max(ways[part] for part in bad)
            found.append(TrackStatement(TrackFault.FROZEN, trial, (labels[k],), when, size, 1e3 * STILL_M, share=share))
    return found


def _way(beside: Tensor, part: tuple[int, int]) -> float:
    """Return the way of the median marker beside from the first to the last frame of a stretch [m]."""
    way = (beside[part[1]] - beside[part[0]]).norm(dim=1)
    return float(torch.nan_to_num(way.nanmedian()))
