"""Recordings and model of a config, ready for the fits."""

from dataclasses import dataclass

from torchid.config import Config
from torchid.config.sections import TrialFile
from torchid.contact import ContactOptions
from torchid.errors import Note
from torchid.geometry.assign import Assignment, assign_markers
from torchid.geometry.options import GeometryOptions
from torchid.inertia.options import InertiaOptions
from torchid.io import ReadOptions, read_trial
from torchid.io.resample import synchronise
from torchid.model.files import load_model
from torchid.model.marker_set import load_marker_set
from torchid.model.model import Model
from torchid.model.whole_body import whole_body
from torchid.motion import MotionOptions
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
        return {n: t for n, t in self.trials.items() if t.role == "fit" and getattr(self.files[n], stage)}

    def role(self, role: str) -> dict[str, Trial]:
        """Trials of a role."""
        return {name: trial for name, trial in self.trials.items() if trial.role == role}


def read_session(config: Config) -> Session:
    """Read all trials of the config and assign their markers to the model.

    Raises:
        TorchidError: a file, the model or the marker set is at fault.
    """
    files = {file.name: file for file in config.trials}
    trials = {name: synchronise(_read(file)) for name, file in files.items()}
    model, said = _model(config)
    markers = load_marker_set(config.markers, model.tree.names, tuple(model.landmarks))
    assignment = assign_markers(model, markers, tuple(trials.values()))
    notes = tuple(note for trial in trials.values() for note in trial.notes)
    return Session(trials, files, assignment, (*notes, *said, *assignment.notes))


def _read(file: TrialFile) -> Trial:
    options = ReadOptions(file.subject, file.up, file.units, file.allow_truncated)
    return read_trial(file.name, file.file, file.forces, file.role, options)


def _model(config: Config) -> tuple[Model, tuple[Note, ...]]:
    if config.model == "whole_body":
        who = config.subject
        return whole_body(who.height_m, who.mass_kg, who.sex, who.mass_sd_kg), ()
    return load_model(config.model)


def geometry_options(config: Config) -> GeometryOptions:
    """Options of the geometric fit."""
    return GeometryOptions(**dict(config.geometry))


def motion_options(config: Config) -> MotionOptions:
    """Options of the filter."""
    return MotionOptions(**dict(config.motion))


def contact_options(config: Config) -> ContactOptions:
    """Options of the contact stage."""
    return ContactOptions(**dict(config.contact))


def inertia_options(config: Config) -> InertiaOptions:
    """Options of the inertial fit."""
    outside = {"enabled", "known_mass", "com_boxes"}
    return InertiaOptions(**{key: value for key, value in dict(config.inertia).items() if key not in outside})
