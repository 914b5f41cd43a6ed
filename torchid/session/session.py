"""What was read of one subject: trials, where they came from, and the model that carries their markers."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from torchid.checks.marker_tracks.session import renamed, without
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
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
