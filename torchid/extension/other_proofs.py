"""What other proof than forces says of an experiment: distances between markers, and how quickly they still move."""

import math

import torch

from torchid.checks.marker_tracks.moved import MarkerReading, lone_displacements, moved_nats
from torchid.checks.marker_tracks.segment_shape import align, segment_shape
from torchid.checks.marker_tracks.session import readings_of
from torchid.checks.marker_tracks.statement import TrackFault
from torchid.diagnosis.candidates.marker_faults import MarkerFault, exchanged_markers, moved_marker
from torchid.diagnosis.evidence.other_proof import Told, borne_out
from torchid.effects.place import Interval, Place
from torchid.effects.traits import Proof
from torchid.model_free.smoothness import smooth
from torchid.session import Outcome
from torchid.session.session import session_clusters

ENOUGH = 3
"""Derived. Markers of a segment from which it has axes."""
EVEN = 0.5
"""Derived. Probability from which distances alone name a marker."""


def told(outcome: Outcome) -> Told:
    """What other proof than forces says of places: of two markers, whether their names are exchanged, of one, if it
    moved between trials, of the session, whether its markers were filtered."""
    session, readings = outcome.session, _readings(outcome)
    fits = session.role("static").keys() | session.role("fit").keys()
    exchanged = {label for one in session.tracking if one.trial in fits for label in one.labels}
    moving = [trial.markers for trial in session.role("fit").values()]
    filtered = bool(moving) and all(smooth(one) for one in moving)

    def distances(place: Place) -> float:
        if len(place.where) == 1:
            return moved_nats(readings, place.where[0], [one.trial for one in place.when or ()])
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


def _readings(outcome: Outcome) -> list[MarkerReading]:
    """Where markers sit in all trials but those held out."""
    session = outcome.session
    trials = session.role("static") | session.role("fit")
    return readings_of(trials, session_clusters(session.assignment))


def _moved(outcome: Outcome) -> list[MarkerFault]:
    """Markers that sit elsewhere in all fitted motion than when the subject stood.

    A marker that moved in some of that motion alone is a candidate of the search.
    """
    static, fits = outcome.session.static, outcome.session.role("fit")
    if static is None or not fits:
        return []
    readings = _readings(outcome)
    found = []
    for label in outcome.fit.attachment.labels:
        nats = moved_nats(readings, label, fits)
        one = _fault(outcome, label, nats) if nats > 0.0 else None
        if one is not None and one.confidence > EVEN:
            found.append(one)
    return found


def _fault(outcome: Outcome, label: str, nats: float) -> MarkerFault | None:
    """A marker with its displacement in axes of its segment; None where too few markers give it axes.

    The mean over the trials: they share what standing errs by.
    """
    static, fits = outcome.session.static, outcome.session.role("fit")
    assert static is not None
    clusters = session_clusters(outcome.session.assignment)
    segment = clusters.segments[clusters.labels.index(label)]
    beside = [clusters.labels[k] for k in clusters.on(segment)]
    stood = segment_shape(static.markers, beside)
    if stood is None:
        return None
    places = dict(zip(outcome.fit.attachment.labels, outcome.fit.place, strict=True))
    shifts, covariances, when = [], [], []
    for trial in fits.values():
        own = segment_shape(trial.markers, beside)
        both = () if own is None else tuple(one for one in own.labels if one in stood.labels and one in places)
        if own is None or label not in both or len(both) < ENOUGH:
            continue
        lone = lone_displacements(own.only(both), stood.only(both), clusters.scatter[clusters.labels.index(label)])
        R_BW, _ = align(stood.only(both).place, torch.stack([places[one] for one in both]))
        k = both.index(label)
        shifts.append(R_BW @ lone.shift[k])
        covariances.append(R_BW @ lone.covariance[k] @ R_BW.mT)
        when.append(Interval(trial.name, float(trial.markers.time[0]), float(trial.markers.time[-1])))
    if not shifts:
        return None
    shift, covariance = torch.stack(shifts).mean(dim=0), torch.stack(covariances).mean(dim=0)
    worth = borne_out(nats, Proof.DISTANCES)
    return moved_marker(Place((label,), tuple(when)), nats, worth, shift, covariance)
