"""What is wrong with the tracks of a session's markers, found before any fit and taken out of the fits."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from torchid.checks.marker_tracks.clusters import Clusters
from torchid.checks.marker_tracks.session import look_at_trials, without
from torchid.checks.marker_tracks.statement import TAKEN_OUT, TrackFault, TrackStatement
from torchid.geometry.assign import Assignment
from torchid.recording import Markers, Trial

BENDING = {"thorax": 0.01}
"""Calibrated. Segments whose markers keep their distances less well from trial to trial [m]: the spine bends and
shoulder blades slide; standing against walking, eleven people's chests differed by up to 19 mm."""
ALONE = "acromion"
"""Landmarks that move on their segment by several centimetres when an arm is raised: no distance to them is kept."""


def session_clusters(assignment: Assignment) -> Clusters:
    """Which markers of a session sit on one segment."""
    given, names = assignment.attachment, assignment.model.tree.names
    segments = {
        label: label if (landmark or "").startswith(ALONE) else names[int(body)]
        for label, body, landmark in zip(given.labels, given.body, given.landmark, strict=True)
    }
    return Clusters.of(segments, BENDING)


def look_at_session(trials: Mapping[str, Trial], assignment: Assignment) -> tuple[TrackStatement, ...]:
    """What is wrong with the markers of a session."""
    return look_at_trials(trials, session_clusters(assignment))


def taken_out(
    trials: Mapping[str, Trial], statements: tuple[TrackStatement, ...], keep: Callable[[Trial], Trial]
) -> tuple[dict[str, Trial], dict[str, Markers]]:
    """The trials with gaps where samples say nothing of segments; and the markers before, where labels are exchanged.

    Args:
        statements: what is wrong with their markers.
        keep: where to put a trial.
    """
    found, before = dict(trials), {}
    for name, trial in trials.items():
        own = [one for one in statements if one.trial == name and one.kind in TAKEN_OUT]
        if own:
            found[name] = keep(replace(trial, markers=without(trial.markers, own)))
        if any(one.kind is TrackFault.EXCHANGED for one in own):
            before[name] = trial.markers
    return found, before
