"""This module tells which segments markers are on whose labels say nothing: by where they stand, then by how they move.

How a person stands among the markers gives landmarks to many of them (``standing``); a body fitted to these tells where
all others are, and whether these are right (``geometry/carriers``). Ways to stand that are nearly as likely are all
fitted, and motion decides: knees bend one way.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError
from torchid.geometry.carriers import JUDGES, SURE, Carriers, Sightings, followed
from torchid.geometry.placing.matching import allowed, bodies, matched_on_bodies
from torchid.geometry.placing.sizes import of_sizes
from torchid.geometry.placing.standing import SCHEDULES, Standing, stand
from torchid.geometry.posture.initial_posture import evenly
from torchid.model.marker_set import MarkerSpec
from torchid.model.model import Model
from torchid.recording import Trial

LIKELY = 0.5
"""Probability from which a marker takes part in a fit, and is put on a landmark; chosen. By places alone even one that
is on its landmark has at most 0.86, since it may be on none."""
NEAR = 20.0
"""Log odds by which another way to stand may be less likely and is fitted nevertheless; chosen."""
MOTION_FRAMES = 5
"""Frames of motion that are looked at where nobody stands still; chosen: in one of them legs are nearly straight."""
LOOKED_AT = 150
"""Resolution. Frames of a trial among which these are chosen."""
FEWEST_LANDMARKS = 8
"""Landmarks of a template below which nobody can be seen to stand; chosen."""
LEAST = 0.0
"""Log evidence of a marker, on average, below which none is placed; chosen: 0.1 to 4 where they are placed rightly, and
-0.2 where a child met a template of another stature. Where most markers are known, these hold the body in place."""
UNDECIDED = 0.02
"""Probability that places leave open even where they are sure; chosen."""
SCATTER = 0.02
"""Scatter of markers about the template's landmarks on a fitted body, beside the landmarks' own [m]; chosen, the last
of ``standing.SCHEDULES``."""
FEWEST_TOLD = 6
"""Markers below which no body is fitted; chosen."""


@dataclass(frozen=True)
class Placed:
    """The segments of markers, as places and motion have it."""

    specs: Mapping[str, MarkerSpec]
    """Markers that are surely on a segment, with the landmark that they are likely on; none of the known ones."""
    told: Carriers
    """Probabilities of all segments for all labels, known ones included."""


def place_markers(
    labels: Sequence[str], model: Model, trials: Sequence[Trial], known: Mapping[str, MarkerSpec] = {}
) -> Placed | None:
    """Return the segments that markers are on; None where no body can be fitted.

    Args:
        labels: of the markers that are asked for.
        model: template of the subject.
        trials: all trials of the session; the same labels are the same markers.
        known: markers whose segments are known.
    """
    every = (*labels, *known)
    if _held(labels, model, known):
        ways: Iterable[_Way] = [_Way(0.0, frozenset(), {}, {})]
    else:
        model, frames = _sized(every, model, trials, known)
        ways = _ways(every, model, frames, known)
    # A first fit asks few segments, and fewer in one way than in another: they are compared by the second.
    found = [
        _again(every, one, model, trials, known) for way in ways if (one := _moved(every, way, model, trials, known))
    ]
    if not found:
        return None
    best = max(found, key=lambda one: one.told.evidence + one.way.score)
    best = _again(every, best, model, trials, known)
    if len(known) < len(labels) and best.told.evidence < LEAST * len(every):
        return None
    specs = best.specs(SURE, model)
    return Placed({label: specs[label] for label in labels if label in specs}, best.told)


def _held(labels: Sequence[str], model: Model, known: Mapping[str, MarkerSpec]) -> bool:
    """Return whether known markers hold the body so well that nobody need be seen to stand: no segment whose parent
    bears none is without them, or too few labels are asked for to tell of one."""
    tree, marked = model.tree, [spec.segment for spec in known.values()]
    loose = [one for one in tree.bodies if not {one.name, tree.names[one.parent]} & {*marked}]
    return marked.count(tree.names[0]) >= JUDGES and (not loose or len(labels) <= JUDGES)


def _sized(
    labels: Sequence[str], model: Model, trials: Sequence[Trial], known: Mapping[str, MarkerSpec]
) -> tuple[Model, Float[Tensor, "frames markers 3"]]:
    """Return the template, where no stature is stated in the size in which a person is seen to stand best, and the
    frames in which; maybe none."""
    frames, rows = _standing_frames(labels, trials), _rows(labels, model, known)
    if len(model.landmarks) < FEWEST_LANDMARKS or not len(frames):
        return model, frames[:0]
    if model.of_stature:
        return model, frames
    sizes = of_sizes(model, frames)
    return max(sizes, key=lambda one: stand(one, frames, rows, SCHEDULES[:1])[0].score), frames


def _rows(labels: Sequence[str], model: Model, known: Mapping[str, MarkerSpec]) -> dict[int, MarkerSpec]:
    """Return what is known of markers, by their rows, as far as the template has it."""
    own = {label: spec for label, spec in known.items() if spec.landmark in (None, *model.landmarks)}
    return {row: own[label] for row, label in enumerate(labels) if label in own}


@dataclass(frozen=True)
class _Way:
    """One way to stand, and what it says of every label."""

    score: float
    absent: frozenset[str]
    segment: Mapping[str, Float[Tensor, " segments"]]
    """Probability of every segment, by places alone."""
    landmark: Mapping[str, Float[Tensor, " landmarks"]]


@dataclass(frozen=True)
class _Moved:
    """A way to stand whose body was followed through all trials."""

    way: _Way
    fitted: Mapping[str, MarkerSpec]
    """Markers that its body was fitted to."""
    told: Carriers

    def specs(self, least: float, model: Model) -> dict[str, MarkerSpec]:
        """Markers that are on a segment with at least this probability."""
        each = {label: self.told.of(label) for label in self.told.labels}
        return {
            label: MarkerSpec(one.segment, _landmark(self.way, label, one.segment, model))
            for label, one in each.items()
            if one.probability >= least
        }


def _ways(
    labels: Sequence[str], model: Model, frames: Float[Tensor, "frames markers 3"], known: Mapping[str, MarkerSpec]
) -> Iterator[_Way]:
    """Return ways to stand that are worth a fit; the one of what is known alone where nobody is seen to stand."""
    if not len(frames):
        yield _Way(0.0, frozenset(), {}, {})
        return
    found = stand(model, frames, _rows(labels, model, known))
    yield from (_way(labels, model, one) for one in found if one.score > found[0].score - NEAR)


def _way(labels: Sequence[str], model: Model, one: Standing) -> _Way:
    """Return what a way to stand says of every label."""
    return _Way(one.score, one.absent, **_shares(labels, model, one.match))


def _shares(labels: Sequence[str], model: Model, match: Float[Tensor, "markers landmarks"]) -> dict[str, dict]:
    """Return a match by label: the shares of segments, and of landmarks."""
    segment = match.new_zeros(len(labels), len(model.tree.names)).index_add_(1, bodies(model), match)
    return {what: dict(zip(labels, x, strict=True)) for what, x in (("segment", segment), ("landmark", match))}


def _standing_frames(labels: Sequence[str], trials: Sequence[Trial]) -> Float[Tensor, "frames markers 3"]:
    """Return a frame of standing in which most markers are seen, or several of motion; none where too few are seen."""
    for some, count in (([t for t in trials if t.role == "static"], 1), (trials, MOTION_FRAMES)):
        parts = [trial.markers.frames(evenly(len(trial.markers.time), LOOKED_AT)) for trial in some]
        position = torch.cat([markers.select(tuple(labels)).position for markers in parts]) if parts else torch.empty(0)
        seen = position.isfinite().all(2).sum(1) if len(position) else position
        if len(seen) and int(seen.max()) >= FEWEST_TOLD:
            whole = (seen >= seen.max() - 1).nonzero()[:, 0]
            return position[whole[evenly(len(whole), count)]]
    return torch.empty(0, len(labels), 3, dtype=torch.float64)


def _moved(
    labels: Sequence[str], way: _Way, model: Model, trials: Sequence[Trial], known: Mapping[str, MarkerSpec],
    before: _Moved | None = None,
) -> _Moved | None:  # fmt: skip
    """Fit a body to the markers that are told so far, and judge all; None where too few are told, or no body fits."""
    told = _first(labels, way, model) if before is None else before.specs(LIKELY, model)
    specs = {**told, **known}
    if len(specs) < FEWEST_TOLD:
        return None
    try:
        seen = followed(labels, specs, model, trials)
    except DataError:
        return None
    if before is not None or not way.segment:
        way = _matched_again(labels, way, model, seen, known)
    return _Moved(way, specs, seen.carriers(_before(labels, way, model), way.absent))


def _again(
    labels: Sequence[str], best: _Moved, model: Model, trials: Sequence[Trial], known: Mapping[str, MarkerSpec]
) -> _Moved:
    """Return what is told when the body is fitted to all that is told; the same where nothing is left to tell."""
    if all(best.told.of(label).sure for label in labels if label not in known):
        return best
    if {**best.specs(LIKELY, model), **known} == best.fitted:
        return best
    return _moved(labels, best.way, model, trials, known, best) or best


def _matched_again(
    labels: Sequence[str], way: _Way, model: Model, seen: Sightings, known: Mapping[str, MarkerSpec]
) -> _Way:
    """Return the way with markers and landmarks matched by where they are on the fitted body."""
    there = torch.tensor([one.segment not in way.absent for one in model.landmarks.values()], dtype=torch.bool)
    may = allowed(model, len(labels), _rows(labels, model, known)) & there
    match = matched_on_bodies(model, seen.place, may, SCATTER)
    return replace(way, **_shares(labels, model, match))


def _first(labels: Sequence[str], way: _Way, model: Model) -> dict[str, MarkerSpec]:
    """Segments that places alone tell."""
    found = {}
    for label in labels if way.segment else ():
        best = int(way.segment[label].argmax())
        if float(way.segment[label][best]) > LIKELY:
            segment = model.tree.names[best]
            found[label] = MarkerSpec(segment, _landmark(way, label, segment, model))
    return found


def _landmark(way: _Way, label: str, segment: str, model: Model) -> str | None:
    """The landmark of a segment that a marker is likely on."""
    each = zip(model.landmarks.items(), way.landmark[label].tolist() if way.landmark else (), strict=False)
    likely = {name: share for (name, one), share in each if one.segment == segment and share > LIKELY}
    return max(likely, key=likely.__getitem__, default=None)


def _before(labels: Sequence[str], way: _Way, model: Model) -> Float[Tensor, "labels segments"]:
    """Probabilities of segments by places; what they leave open is on any of them."""
    by_place = torch.stack([way.segment[label] for label in labels])
    left = (1.0 - by_place.sum(dim=1, keepdim=True)).clamp(min=UNDECIDED)
    return by_place + left / len(model.tree.names)
