"""What was read of one subject: trials, where they came from, and the model that carries their markers."""

from dataclasses import dataclass

from torchid.config.sections import TrialFile
from torchid.errors import Note
from torchid.geometry.assign import Assignment
from torchid.recording import Trial


@dataclass(frozen=True)
class Session:
    """One subject's trials with forces on the markers' clock, and the model whose bodies carry those markers."""

    trials: dict[str, Trial]
    files: dict[str, TrialFile]
    assignment: Assignment
    notes: tuple[Note, ...]

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
