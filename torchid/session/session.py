"""What was read of one subject: trials, where they came from, and the model that carries their markers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from torchid.checks.marker_tracks.clusters import Clusters
from torchid.checks.marker_tracks.session import look_at_trials, renamed, without
from torchid.checks.marker_tracks.statement import TAKEN_OUT, TrackFault, TrackStatement
from torchid.config.sections import TrialFile
from torchid.errors import Note
from torchid.geometry.assign import Assignment
from torchid.recording import Markers, Trial


@dataclass(frozen=True)
class Session:
    """One subject's trials with forces on the markers' clock, and the model whose bodies carry those markers."""

    trials: dict[str, Trial]
    files: dict[str, TrialFile]
    assignment: Assignment
    notes: tuple[Note, ...]
    tracking: tuple[TrackStatement, ...] = ()
    """What is wrong with the markers; ``trials`` have gaps there."""
    as_read: dict[str, Markers] = field(default_factory=dict)
    """Markers before that, of trials in which labels are exchanged."""

    def with_names(self, exchanged: Sequence[TrackStatement]) -> "Session":
        """Return the session in which exchanged labels, which were gaps, are there under their own names.

        Args:
            exchanged: those of ``tracking`` that are to be undone.
        """
        trials = dict(self.trials)
        for name in dict.fromkeys(one.trial for one in exchanged):
            own = [one for one in self.tracking if one.trial == name]
            undone = [one for one in own if one in exchanged]
            markers = renamed(self.as_read[name], [one for one in own if one.kind is TrackFault.EXCHANGED])
            left = [one for one in own if one not in undone]
            trials[name] = replace(trials[name], markers=without(markers, left))
        return replace(self, trials=trials, tracking=tuple(one for one in self.tracking if one not in exchanged))

    @property
    def static(self) -> Trial | None:
        """The first static trial."""
        return next((trial for trial in self.trials.values() if trial.role == "static"), None)

    def fit(self, stage: str) -> dict[str, Trial]:
        """Fit trials that take part in ``stage`` (geometry or inertia)."""
        return self.part("fit", stage)

    def part(self, role: str, stage: str) -> dict[str, Trial]:
        """Trials of a role that take part in ``stage`` (held-out ones: that are judged by it)."""
        return {n: t for n, t in self.role(role).items() if getattr(self.files[n], stage)}

    def role(self, role: str) -> dict[str, Trial]:
        """Trials of a role."""
        return {name: trial for name, trial in self.trials.items() if trial.role == role}


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
