"""This module tells which segment a marker moves with: markers of one keep their distances, whatever the posture.

Of two segments, the one to which the distances scatter less is likelier: by the power of a variance ratio that as many
independent postures give as a session has. A neighbour of the best that too few markers show cannot be asked, and may
carry the marker just as well, unless nobody puts markers on it: it has no landmark.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float

from torchid.model.marker_set import MarkerSpec
from torchid.model.model import Model
from torchid.model.tree import Tree
from torchid.recording import Markers, Trial

ELSEWHERE = 0.015
"""Scatter of the distances to some segment's markers that what is on none that could be asked may have by chance [m];
chosen. In a walk, an elbow keeps its distance from the pelvis to 20 mm."""
NOISE = 0.003
"""Distances on one segment scatter by so much for cameras and skin alone [m]; chosen."""
POSTURES = 6.0
"""Independent postures that a session shows: frames of one motion resemble each other. Chosen on eleven recordings with
half of their markers unlisted (``python -m batteries.unlisted``, seeds 77 and 78, as the other bounds here)."""
SURE = 0.9
"""Probability from which a marker is given to a segment; chosen, the one below which a verdict is not told either."""
JUDGES = 2
"""Markers by which a segment can be asked: by one alone, every marker on a sphere about it would keep its distance."""
REACH = 0.4
"""Mean distance from a segment's other markers at which none of it sits any more [m]; chosen, a thigh's length. In a
walk, an elbow keeps its distance from the head."""


@dataclass(frozen=True)
class Carrier:
    """The segment that a marker most likely moves with."""

    segment: str
    probability: float
    """Probability among all segments that could be asked, neighbours that could not, and none of them."""
    scatter: float
    """Scatter of the distances to the segment's markers [m]."""
    other: str
    """The segment that is likeliest but for this one; empty where there is none."""

    @property
    def sure(self) -> bool:
        """True if it is a segment's marker beyond doubt."""
        return self.probability >= SURE


def rigid_scatter(
    position: Float[torch.Tensor, "frames 3"],
    clusters: dict[int, Float[torch.Tensor, "frames markers 3"]],
) -> dict[int, tuple[float, int]]:
    """Tell how rigidly an unassigned marker moves with the markers of each body.

    The criterion is the mean variance of the distances to the body's markers, which needs neither a fit nor axes.
    Bodies with fewer than ``JUDGES`` markers, or fewer than ten common frames, are passed over; to one out of reach it
    is infinite.

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
        if markers.shape[1] >= JUDGES and frames >= 10:
            near = float(distance[common].mean()) <= REACH
            found[body] = float(distance[common].var(dim=0).mean()) if near else math.inf, frames
    return found


def carrier_of(label: str, known: Mapping[str, MarkerSpec], model: Model, trials: tuple[Trial, ...]) -> Carrier | None:
    """Return the segment that a marker most likely moves with; None where no segment can be asked.

    All trials that move are asked together: in one alone the joint between two segments may hardly turn.

    Args:
        label: the marker's.
        known: segments of the markers that are told.
        model: template of the subject.
        trials: all trials of the session.
    """
    tree, variance = model.tree, _variances(label, known, model.tree, trials)
    best = min(variance, key=variance.__getitem__, default=None)
    if best is None or not math.isfinite(variance[best]):
        return None
    marked = {tree.index(one.segment) for one in model.landmarks.values()}
    beside = [k for k in marked if k not in variance and _neighbours(tree, k, best)]
    asked = variance | dict.fromkeys(beside, variance[best])
    weight = {k: ((v + NOISE**2) / (ELSEWHERE**2 + NOISE**2)) ** (-0.5 * POSTURES) for k, v in asked.items()}
    other = max((k for k in weight if k != best), key=weight.__getitem__, default=None)
    name = "" if other is None else tree.names[other]
    return Carrier(tree.names[best], weight[best] / (1.0 + sum(weight.values())), math.sqrt(variance[best]), name)


def _variances(label: str, known: Mapping[str, MarkerSpec], tree: Tree, trials: tuple[Trial, ...]) -> dict[int, float]:
    """Return the variance of the distances to the markers of each body that can be asked [m^2]."""
    squares: dict[int, list[tuple[float, int]]] = {}
    moving = [t for t in trials if t.role != "static"] or list(trials)
    for markers in (t.markers for t in moving if label in t.markers.labels):
        path = markers.select((label,)).position[:, 0]
        for body, found in rigid_scatter(path, _clusters(markers, known, tree)).items():
            squares.setdefault(body, []).append(found)
    return {k: sum(v * n for v, n in each) / sum(n for _, n in each) for k, each in squares.items()}


def _neighbours(tree: Tree, one: int, other: int) -> bool:
    """Return whether a joint links two bodies."""
    return tree.bodies[one].parent == other or tree.bodies[other].parent == one


def _clusters(markers: Markers, known: Mapping[str, MarkerSpec], tree: Tree) -> dict[int, torch.Tensor]:
    """Return the positions of the known markers of each body that are seen in most frames, by the body's index."""
    often = torch.isfinite(markers.position[..., 0]).double().mean(0) > 0.5
    seen = [label for label, one in zip(markers.labels, often.tolist(), strict=True) if one]
    found = {}
    for k, name in enumerate(tree.names):
        own = (label for label in seen if label in known and known[label].segment == name)
        if labels := tuple(own):
            found[k] = markers.select(labels).position
    return found
