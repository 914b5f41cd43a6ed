"""All that is wrong with the markers of a session's trials, and the markers without it."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import torch

from torchid.checks.marker_tracks.clusters import Clusters, MarkerShape, shape_of
from torchid.checks.marker_tracks.exchanges import exchanged_jumps, find_exchanges
from torchid.checks.marker_tracks.frozen import find_frozen
from torchid.checks.marker_tracks.jumps import beside, find_jumps
from torchid.checks.marker_tracks.moved import MarkerReading, marker_readings, moved_markers
from torchid.checks.marker_tracks.statement import TAKEN_OUT, TrackFault, TrackStatement
from torchid.checks.marker_tracks.turned import find_turned
from torchid.recording import Markers, Trial

MOST_OTHERS = 2
"""Choice. Trials beside the static one that a trial is compared with: three can outvote one."""


def look_at_trials(trials: Mapping[str, Trial], clusters: Clusters) -> tuple[TrackStatement, ...]:
    """Return what is wrong with the markers of trials, found before any fit.

    Args:
        trials: of one subject, by name.
        clusters: which markers sit on one segment.
    """
    shapes = {name: shape_of(name, trial.markers, clusters.labels) for name, trial in trials.items()}
    against = compared(trials)
    found: list[TrackStatement] = []
    for name, trial in trials.items():
        others = [shapes[other] for other in against[name]]
        found += look_at_trial(trial, clusters, others, shapes[name])
    return (*found, *moved_markers(readings_of(trials, clusters, found)))


def look_at_trial(
    trial: Trial, clusters: Clusters, others: list[MarkerShape], own: MarkerShape | None = None
) -> list[TrackStatement]:
    """Return what is wrong with the markers of one trial: exchanged, leaping and frozen ones.

    Args:
        trial: the trial.
        clusters: which markers sit on one segment.
        others: shapes of trials that it is compared with.
        own: its own shape, if that is known already.
    """
    if not len(trial.markers.time):
        return []
    own = shape_of(trial.name, trial.markers, clusters.labels) if own is None else own
    near = beside(clusters, own)
    frozen = find_frozen(trial.name, trial.markers, clusters.labels, near)
    moving = without(trial.markers, frozen)
    exchanged = find_exchanges(trial.name, moving, clusters, others or [own])
    exchanged += [] if exchanged else find_turned(own, clusters, others)
    jumps = find_jumps(trial.name, renamed(moving, exchanged), clusters, others)
    swapped = exchanged_jumps(moving, jumps)
    known = {label for one in swapped for label in one.labels}
    return [*exchanged, *swapped, *(one for one in jumps if not known.intersection(one.labels)), *frozen]


def readings_of(
    trials: Mapping[str, Trial], clusters: Clusters, known: Iterable[TrackStatement] = ()
) -> list[MarkerReading]:
    """Return where every marker sits in every trial, against the static one and others.

    Args:
        trials: of one subject, by name, as read.
        clusters: which markers sit on one segment.
        known: what is wrong with their markers: exchanged ones get their names back, bad samples are left out.
    """
    known = tuple(known)
    markers = {}
    for name, trial in trials.items():
        own = [one for one in known if one.trial == name]
        markers[name] = without(
            renamed(trial.markers, own), [one for one in own if one.kind is not TrackFault.EXCHANGED]
        )
    return marker_readings(markers, clusters, compared(trials))


def compared(trials: Mapping[str, Trial]) -> dict[str, tuple[str, ...]]:
    """Return by trial the others that it is compared with: the static one, and the next ones.

    Of two trials only one is judged by the other: not a static one, nor the first.

    Args:
        trials: of one subject, by name.
    """
    names = list(trials)
    static = [name for name in names if trials[name].role == "static"][:1]
    if len(names) == 2:
        first = static[0] if static else names[0]
        return {name: () if name == first else (first,) for name in names}
    found = {}
    for k, name in enumerate(names):
        moving = [other for other in (*names[k + 1 :], *names[:k]) if trials[other].role != "static"]
        found[name] = (*(one for one in static if one != name), *moving[:MOST_OTHERS])
    return found


def renamed(markers: Markers, statements: Iterable[TrackStatement]) -> Markers:
    """Return the markers with exchanged ones under their own names.

    Args:
        markers: of the trial that the statements are of.
        statements: those of other kinds change nothing.
    """
    exchanged = [one for one in statements if one.kind is TrackFault.EXCHANGED]
    if not exchanged:
        return markers
    markers = markers.having(label for one in exchanged for label in one.labels)
    position = markers.position.clone()
    for one in exchanged:
        pair = torch.tensor([markers.labels.index(label) for label in one.labels])
        inside = one.inside(markers.time).nonzero()
        position[inside, pair] = position[inside, pair.flip(0)]
    return replace(markers, position=position)


def without(markers: Markers, statements: Iterable[TrackStatement]) -> Markers:
    """Return the markers with gaps where a statement says that samples tell nothing of the segment.

    Args:
        markers: of the trial that the statements are of.
        statements: those of a marker that moved leave it as it is.
    """
    bad = [one for one in statements if one.kind in TAKEN_OUT]
    if not bad:
        return markers
    position = markers.position.clone()
    for one in bad:
        inside = one.inside(markers.time)
        for label in (own for own in one.labels if own in markers.labels):
            position[inside, markers.labels.index(label)] = torch.nan
    return replace(markers, position=position)
