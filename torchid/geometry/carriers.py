"""This module tells which segments markers are on: where they stay in a segment's axes, and near its bones.

A body is fitted to the markers whose segments are known. Seen from its own segment a marker stays where it is in every
posture; seen from others it wanders as the joints between them turn. Where few postures tell two segments apart, the
distance from their bones does, and where neither does, no segment is sure.
"""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.geometry.attachment import attach, settle_bare
from torchid.geometry.fit import fit_geometry, joint_frames
from torchid.geometry.options import GeometryOptions
from torchid.geometry.result import GeometryFit
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import poses
from torchid.model.marker_set import MarkerSpec
from torchid.model.model import Model
from torchid.recording import Markers, Trial

ELSEWHERE = 0.020
"""Scatter along an axis of its segment that what is on none that could be asked may have by chance [m]; chosen."""
NOISE = 0.004
"""Scatter that skin, cameras and the template's joints alone make [m]; chosen."""
POSTURES = 4.0
"""Independent postures that a session shows: frames of one motion resemble each other. Chosen on eleven recordings, as
the other bounds here (``python -m batteries.unlisted --seed 77``)."""
FLESH = 0.05
"""Distance of markers from the lines between joints and landmarks, as their standard deviation [m]; chosen."""
NOWHERE = 0.02
"""Probability, before it is seen to move, that a marker is on no segment; chosen."""
JUDGES = 2
"""Other markers by which a segment can be asked: one or two markers would go wherever the marker itself puts them."""
WITHIN = 0.9
"""Share of the frames whose scatter counts: the rest may be a swap or a slip."""
FRAMES, STEPS = 90, 25
"""Resolution. Frames of all trials that the body is fitted to and markers are looked at in, and most steps of the
fit."""
STILL = 5
"""Frames of standing among them; chosen: nothing turns there, and more would hide motion."""
LOOKED_AT = 6
"""Recordings that are looked at, the longest; chosen. In one alone, the joint between two segments may hardly turn."""
LOST = -20.0
"""Least log evidence of a marker; chosen: one that is lost in every hypothesis shall not decide between them."""


@dataclass(frozen=True)
class Sightings:
    """Markers as they are seen from every body of a subject who is followed through all trials."""

    labels: tuple[str, ...]
    segments: tuple[str, ...]
    place: Float[Tensor, "segments labels 3"]
    """Usual place of each marker in the axes of every body [m]; NaN where it is never seen."""
    scatter: Float[Tensor, "segments labels"]
    """Scatter about that place, along an axis [m]."""
    weight: Float[Tensor, "segments labels"]
    """Log likelihood by motion and by the distance from bones; minus infinity of bodies that bear no markers."""

    def carriers(self, before: Float[Tensor, "labels segments"], absent: Set[str] = frozenset()) -> "Carriers":
        """Return how likely markers are on the segments.

        Args:
            before: probability of every segment before motion is looked at.
            absent: segments that nobody has put markers on.
        """
        weight = self.weight + before.T.clamp(min=1e-12).log().to(self.weight)
        weight[[name in absent for name in self.segments]] = -torch.inf
        nowhere = weight.new_full((1, len(self.labels)), math.log(NOWHERE / len(self.segments)))
        every = torch.cat([weight, nowhere])
        evidence = float(every.logsumexp(0).clamp(min=LOST).sum())
        return Carriers(self.labels, self.segments, every.softmax(0)[:-1].T, self.scatter.T, evidence)


@dataclass(frozen=True)
class Carriers:
    """The probability of every segment for every marker."""

    labels: tuple[str, ...]
    segments: tuple[str, ...]
    probability: Float[Tensor, "labels segments"]
    """Probability by marker and segment; what is missing from 1 is on none of them."""
    scatter: Float[Tensor, "labels segments"]
    """Along an axis of each segment [m]."""
    evidence: float
    """Log evidence of the markers, up to a constant of the session; it compares hypotheses about the known ones."""

    def of(self, label: str) -> "Carrier":
        """Return the segment that a marker is most likely on."""
        row = self.labels.index(label)
        best, other = self.probability[row].topk(2).indices.tolist()
        name, rival = self.segments[best], self.segments[other]
        return Carrier(name, float(self.probability[row, best]), float(self.scatter[row, best]), rival)


SURE = 0.9
"""Probability from which a marker is given to a segment; chosen, the one below which a verdict is not told either."""


@dataclass(frozen=True)
class Carrier:
    """The segment that a marker is most likely on."""

    segment: str
    probability: float
    scatter: float
    """Along an axis of the segment [m]."""
    other: str
    """The segment that is likeliest but for this one."""

    @property
    def sure(self) -> bool:
        """True if it is a segment's marker beyond doubt."""
        return self.probability >= SURE


def followed(
    labels: Sequence[str], known: Mapping[str, MarkerSpec], model: Model, trials: Sequence[Trial]
) -> Sightings:
    """Fit a body to markers whose segments are known, and return how all look from it.

    Args:
        labels: of the markers that are asked for; those among the known ones are judged like any other.
        known: markers that the body is fitted to, three of them on the root.
        model: template of the subject.
        trials: all trials of the session.

    Raises:
        DataError: as ``fit_geometry``.
    """
    tree = model.tree
    fit, frames = _fitted(model, known, trials)
    paths = _seen_from(fit, frames, labels)
    place = paths.nanmedian(dim=3).values
    scatter = _scatter(paths, place)
    motion = -0.5 * POSTURES * torch.log((scatter.square() + NOISE**2) / (ELSEWHERE**2 + NOISE**2))
    motion = _asked(motion.nan_to_num(0.0), _others(labels, known, model))
    flesh = -0.5 * (_from_bones(fit, model, place) / FLESH).square()
    weight = motion + flesh.nan_to_num(-torch.inf)
    marked = {spec.segment for spec in known.values()}
    weight[[name not in marked and not _bears_markers(model, k) for k, name in enumerate(tree.names)]] = -torch.inf
    return Sightings(tuple(labels), tree.names, place, scatter, weight)


def _fitted(
    model: Model, known: Mapping[str, MarkerSpec], trials: Sequence[Trial]
) -> tuple[GeometryFit, list[Markers]]:
    """The body fitted to the known markers, roughly, and the frames that it was fitted to."""
    settled_model, _ = settle_bare(model, {spec.segment for spec in known.values()})
    static = next((trial.markers for trial in trials if trial.role == "static"), None)
    moving = {trial.name: trial.markers for trial in trials if trial.role != "static"}
    longest = sorted(moving, key=lambda name: -_seconds(moving[name]))[:LOOKED_AT]
    every = {name: moving[name] for name in longest} or {trial.name: trial.markers for trial in trials}
    options = GeometryOptions(max_frames=FRAMES, static_frames=STILL, iterations=STEPS)
    fit = fit_geometry(settled_model, attach(settled_model, known), every, static, options)
    return fit, joint_frames(every, static, options)


def _seconds(markers: Markers) -> float:
    return float(markers.time[-1] - markers.time[0])


def _seen_from(
    fit: GeometryFit, frames: Sequence[Markers], labels: Sequence[str]
) -> Float[Tensor, "bodies labels 3 frames"]:
    """Places of markers in the axes of every body, in the frames that it was fitted to [m]."""
    assert fit.solution is not None
    at = poses(plan_tree(fit.model.tree), fit.solution.q, fit.geometry)
    each = [markers.select(tuple(labels)).position for markers in frames]
    p_WM_W = torch.cat(each).to(fit.xi).permute(1, 2, 0)
    order = _in_tree_order(fit, at.p)
    return torch.einsum("baxt,mbxt->bmat", at.R[order], p_WM_W[:, None] - at.p[order])  # R's columns come first


def _in_tree_order(fit: GeometryFit, like: Tensor) -> Int[Tensor, " bodies"]:
    return torch.tensor(plan_tree(fit.model.tree).position, device=like.device)


def _scatter(
    paths: Float[Tensor, "bodies labels 3 frames"], place: Float[Tensor, "bodies labels 3"]
) -> Float[Tensor, "bodies labels"]:
    """Return how far markers are from their places, along an axis, in all but the worst frames [m]."""
    away = (paths - place[..., None]).square().sum(dim=2)
    return (away.nanquantile(WITHIN, dim=2) / 3.0).sqrt()


def _others(labels: Sequence[str], known: Mapping[str, MarkerSpec], model: Model) -> Int[Tensor, "bodies labels"]:
    """Number of other known markers on every body."""
    count = torch.zeros(len(model.tree.names), len(labels), dtype=torch.long)
    for label, spec in known.items():
        row = model.tree.index(spec.segment)
        count[row] += torch.tensor([label != other for other in labels])
    return count


def _asked(motion: Float[Tensor, "bodies labels"], others: Int[Tensor, "bodies labels"]) -> Tensor:
    """Log likelihoods, those of bodies that cannot be asked at most as good as of the best that can, or of chance."""
    can = others >= JUDGES
    best = torch.where(can, motion, -torch.inf).amax(dim=0).clamp(min=0.0)
    return torch.where(can, motion, torch.minimum(motion, best))


def _bears_markers(model: Model, body: int) -> bool:
    """Return whether people put markers on a body: not on one between others that has no landmark."""
    tree = model.tree
    if not model.landmarks or any(one.segment == tree.names[body] for one in model.landmarks.values()):
        return True
    return not any(one.parent == body for one in tree.bodies)


def _from_bones(fit: GeometryFit, model: Model, place: Float[Tensor, "bodies labels 3"]) -> Tensor:
    """Distances (bodies, labels) from the lines between each body's joint and its next joints and landmarks [m]."""
    offset, mean = fit.geometry.offset, model.inertia.mean
    found = []
    for body, name in enumerate(model.tree.names):
        ends = [offset[k] for k, one in enumerate(model.tree.bodies) if one.parent == body]
        ends += [offset.new_tensor(one.p_BM_B) for one in model.landmarks.values() if one.segment == name]
        ends = ends or [2.0 * mean[body, 1:4] / mean[body, 0]]  # as far beyond the centre of mass as it is away
        found.append(torch.stack([_from_line(place[body], end) for end in ends]).amin(dim=0))
    return torch.stack(found)


def _from_line(p: Float[Tensor, "labels 3"], end: Float[Tensor, "3"]) -> Float[Tensor, " labels"]:
    """Distance of points from the line between the origin and its end [m]."""
    along = (p @ end / end.square().sum().clamp(min=1e-12)).clamp(0.0, 1.0)
    return (p - along[:, None] * end).norm(dim=1)
