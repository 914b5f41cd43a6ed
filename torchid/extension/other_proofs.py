"""What other proof than forces says of an experiment: distances between markers, and how quickly they still move."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.marker_tracks.moved import lone_displacements, moved_nats, read_segment
from torchid.checks.marker_tracks.segment_shape import SegmentShape, align, segment_shape
from torchid.checks.marker_tracks.session import readings_of
from torchid.checks.marker_tracks.statement import TrackFault
from torchid.diagnosis.candidates.marker_faults import MarkerFault, exchanged_markers, moved_marker
from torchid.diagnosis.evidence.other_proof import Told, borne_out
from torchid.effects.place import Interval, Place
from torchid.effects.traits import Proof
from torchid.model_free.smoothness import smooth
from torchid.recording import Trial
from torchid.session import Outcome
from torchid.session.session import session_clusters

ENOUGH = 3
"""Derived. Markers of a segment from which it has axes."""
EVEN = 0.5
"""Derived. Probability from which distances alone name a marker."""
LEAPS = (TrackFault.EXCHANGED, TrackFault.JUMP, TrackFault.FLIP)
"""Derived. Faults of tracks that exchanged labels show as."""


def told(outcome: Outcome) -> Told:
    """What other proof than forces says of places: of two markers, whether their names are exchanged, of one, if it
    moved between trials, of the session, whether its markers were filtered."""
    session = outcome.session
    trials = session.role("static") | session.role("fit")
    readings = readings_of(trials, session_clusters(session.assignment))
    by_label = {label: [one for one in readings if one.label == label] for label in outcome.fit.attachment.labels}
    exchanged = {label for one in session.tracking if one.kind in LEAPS and one.trial in trials for label in one.labels}
    moving = [trial.markers for trial in session.role("fit").values()]
    filtered = bool(moving) and all(smooth(one) for one in moving)

    @cache
    def moved(label: str, where: frozenset[str]) -> float:
        return moved_nats(by_label[label], label, where)

    def distances(place: Place) -> float:
        if len(place.where) == 1:
            return moved(place.where[0], frozenset(one.trial for one in place.when or ()))
        return math.inf if exchanged.intersection(place.where) else -math.inf

    return {Proof.DISTANCES: distances, Proof.SMOOTHNESS: lambda _: math.inf if filtered else -math.inf}


def marker_faults(outcome: Outcome) -> list[MarkerFault]:
    """Labels of the fit that distances show to be exchanged, and markers that moved between standing and all motion."""
    session, known = outcome.session, set(outcome.fit.attachment.labels)
    exchanged = [
        exchanged_markers(one, session.trials[one.trial].markers.time)
        for one in session.tracking
        if one.kind is TrackFault.EXCHANGED and known.issuperset(one.labels)
    ]
    return exchanged + _moved(outcome)


def _moved(outcome: Outcome) -> list[MarkerFault]:
    """Markers that sit elsewhere in each trial of the fitted motion than when the subject stood.

    A marker that moved in some of that motion alone is a candidate of the search. Held-out trials have no say; those
    that show the same of a marker that is named are put right as well.
    """
    static, session = outcome.session.static, outcome.session
    if static is None:
        return []
    clusters, found = session_clusters(session.assignment), []
    for segment, scatter in dict(zip(clusters.segments, clusters.scatter, strict=True)).items():
        labels = [clusters.labels[k] for k in clusters.on(segment)]
        stood = segment_shape(static.markers, labels)
        if stood is None:
            continue
        looks = {trial.name: _look(trial, labels, stood, scatter) for trial in session.trials.values()}
        for label in set(labels).intersection(outcome.fit.attachment.labels):
            own = {name: look[label] for name, look in looks.items() if label in look}
            one = _fault(outcome, label, own, stood)
            found += [] if one is None else [one]
    return found


@dataclass(frozen=True)
class _Look:
    """A marker in one trial, against standing."""

    nats: float
    """Log Bayes factor of its having moved alone [nat]."""
    shift: Float[Tensor, "3"]
    """Displacement, in axes of the shape that stood [m]."""
    covariance: Float[Tensor, "3 3"]
    """Covariance of that [m^2]."""


def _look(trial: Trial, labels: Sequence[str], stood: SegmentShape, scatter: float) -> dict[str, _Look]:
    """What a trial says of the markers of a segment; nothing where too few give it axes."""
    own = None if trial.role == "static" else segment_shape(trial.markers, labels)
    both = () if own is None else tuple(label for label in own.labels if label in stood.labels)
    if own is None or len(both) < ENOUGH:
        return {}
    said = read_segment(trial.name, "", own.only(both), stood.only(both), scatter)
    lone = lone_displacements(own.only(both), stood.only(both), scatter)
    return {one.label: _Look(one.nats, lone.shift[k], lone.covariance[k]) for k, one in enumerate(said)}


def _fault(outcome: Outcome, label: str, looks: Mapping[str, _Look], stood: SegmentShape) -> MarkerFault | None:
    """A marker with its displacement in axes of its segment, if each fitted trial that shows it says that it moved.

    Evidence is the least, shift and covariance the mean over these trials, which share what standing errs by.
    """
    session = outcome.session
    fits = [look for name, look in looks.items() if name in session.role("fit")]
    nats = min((look.nats for look in fits), default=0.0)
    places = dict(zip(outcome.fit.attachment.labels, outcome.fit.place, strict=True))
    known = tuple(one for one in stood.labels if one in places)
    if nats <= 0.0 or len(known) < ENOUGH:
        return None
    R_BW, _ = align(stood.only(known).place, torch.stack([places[one] for one in known]))
    shift, covariance = (
        torch.stack([getattr(look, part) for look in fits]).mean(0) for part in ("shift", "covariance")
    )
    when = [session.trials[name] for name, look in looks.items() if look.nats > 0.0]
    place = Place((label,), tuple(Interval(t.name, float(t.markers.time[0]), float(t.markers.time[-1])) for t in when))
    one = moved_marker(place, borne_out(nats, Proof.DISTANCES), R_BW @ shift, R_BW @ covariance @ R_BW.mT)
    return one if one.confidence > EVEN else None
