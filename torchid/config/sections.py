"""Sections of the config with their defaults; strict, so that a misspelt key or a quoted number is an error."""

import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, field_validator, model_validator
from pydantic_core import PydanticCustomError

PROJECT_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Where ``${TORCHID_DATA}`` points unless the environment says otherwise: ``shared/data`` beside the project."""

BUILTIN_MODELS = ("whole_body",)
MODEL_SUFFIXES = (".urdf", ".xml", ".osim")
MARKER_SUFFIXES = (".yaml", ".yml", ".json")

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Name = Annotated[str, Field(min_length=1, max_length=200)]


def resolve_path(text: object, info: Any) -> Path:
    """The absolute path that a config means: ``${VAR}`` and ``~`` expanded, relative ones from the folder in ``info``.

    ``info`` is pydantic's ValidationInfo, a protocol that beartype cannot check.
    """
    text = str(text) if isinstance(text, Path) else text
    if not isinstance(text, str) or not text.strip():
        raise PydanticCustomError("path", "must be a path")
    if "\0" in text:
        raise PydanticCustomError("path", "a path cannot hold a NUL character")
    expanded = re.sub(r"\$\{([^}]*)\}", lambda match: _variable(match[1]), text)
    base = Path((info.context or {}).get("base", "."))
    try:
        return Path(os.path.abspath(base / Path(expanded).expanduser()))
    except RuntimeError as error:
        raise PydanticCustomError("path", "no such user's home") from error


def _variable(name: str) -> str:
    value = os.environ.get(name)
    if value is None and name == "TORCHID_DATA" and PROJECT_DATA.is_dir():
        return str(PROJECT_DATA)
    if value is None:
        raise PydanticCustomError("unset_variable", "the environment variable {name} is not set", {"name": name})
    return value


def _model(value: object, info: Any) -> Path | str:
    """A built-in model's name, or the path of a model file."""
    if value in BUILTIN_MODELS:
        return str(value)
    if not isinstance(value, str) or Path(value).suffix.lower() not in MODEL_SUFFIXES:
        known = ", ".join((*BUILTIN_MODELS, *(f"a {suffix} file" for suffix in MODEL_SUFFIXES)))
        raise PydanticCustomError("unknown_name", "must be one of {known}", {"known": known})
    return resolve_path(value, info)


def _markers(value: object, info: Any) -> Path | str:
    """A marker set's name, which is looked up where the sets are, or the path of a YAML or JSON file."""
    if not isinstance(value, str) or not value:
        raise PydanticCustomError("marker_set", "must be the name of a marker set or a path")
    return resolve_path(value, info) if Path(value).suffix.lower() in MARKER_SUFFIXES else value


UserPath = Annotated[Path, PlainValidator(resolve_path)]
ModelSource = Annotated[Path | str, PlainValidator(_model)]
MarkerSource = Annotated[Path | str, PlainValidator(_markers)]


class Section(BaseModel):
    """Base of all sections: frozen, strict types, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Subject(Section):
    """Whom the recordings show."""

    name: Name
    mass_kg: Annotated[float, Field(gt=0, lt=1000)] | None = None
    mass_sd_kg: Positive | None = None
    """Standard deviation of the recorded mass."""
    height_m: Annotated[float, Field(gt=0.3, lt=3)] | None = None
    sex: Literal["male", "female", "unknown"] = "unknown"


class TrialFile(Section):
    """One recording and what it is used for."""

    name: Name
    file: UserPath
    """C3D, or TRC."""
    forces: UserPath | None = None
    """MOT or STO beside a TRC."""
    role: Literal["static", "fit", "heldout"] = "fit"
    subject: str | None = None
    """Prefix of the labels, where a file holds several subjects."""
    up: Literal["y", "z"] | None = None
    units: Literal["mm", "cm", "dm", "m", "in"] | None = None
    allow_truncated: bool = False
    geometry: bool = True
    """Takes part in the fit of the geometry."""
    inertia: bool = True
    """Takes part in the fit of the inertia."""


class Geometry(Section):
    """Fit of joint centres, lengths and marker places with the motion of all frames."""

    solver: Literal["arrow", "adam", "lbfgs"] = "arrow"
    robust: bool = True
    robust_mm: Positive = 30.0
    """Residual beyond which a marker counts as an outlier [mm]."""
    symmetry: Literal["none", "tied"] = "none"
    groups: dict[Name, tuple[Name, ...]] = Field(default_factory=dict)
    """New parameter: the geometric parameters that it replaces."""
    sigma_mm: Positive | dict[Name, Positive] = 10.0
    """Standard deviation of a marker's residual, for all or by label [mm]."""
    iterations: Annotated[int, Field(gt=0, le=100_000)] = 50
    tolerance: Positive = 1e-8
    """Relative decrease of the objective at which the solver stops."""
    max_frames: Annotated[int, Field(gt=0)] = 4000
    """Frames of the joint fit; longer sessions are thinned evenly, and all frames get their motion afterwards."""
    posture: bool = True
    """Weak prior on the joint angles."""
    prior_scale: Positive = 1.0
    """Factor on the standard deviations of the geometric prior."""


class Motion(Section):
    """Filter of kinematics and forces alike."""

    filter: Literal["butterworth", "spline"] = "butterworth"
    cutoff_hz: Positive | Literal["auto"] = "auto"


class Contact(Section):
    """When all contact is on the plates."""

    threshold_n: Positive = 20.0
    """Vertical force above which a plate is loaded [N]."""
    margin_mm: NonNegative = 50.0
    """How far beyond a plate's edge a foot may stand before its frame is left out [mm]."""


class Inertia(Section):
    """Fit of mass, centre of mass and inertia tensor of every segment."""

    lmi: bool = True
    """Physically consistent by linear matrix inequalities."""
    prior: Literal["quadratic", "entropic"] = "quadratic"
    prior_weight: Literal["evidence", "cross_validation"] | Positive = "evidence"
    known_mass: bool = False
    """Hold the total mass at ``subject.mass_kg``."""
    com_boxes: bool = False
    """Keep each centre of mass inside its segment's box."""


class Diagnosis(Section):
    """What the identified model still gets wrong."""

    enabled: bool = False
    max_effects: Annotated[int, Field(ge=0, le=20)] = 3
    include: tuple[Name, ...] = ()
    """Effects to try; empty means the whole catalogue."""
    exclude: tuple[Name, ...] = ()


class SimulatedSubject(Section):
    """Body of the synthetic subject."""

    mass_kg: Annotated[float, Field(gt=0, lt=1000)] = 70.0
    height_m: Annotated[float, Field(gt=0.3, lt=3)] = 1.75
    sex: Literal["male", "female", "unknown"] = "unknown"
    scatter: NonNegative = 1.0
    """How far it is drawn from the prior's mean, in prior standard deviations."""


class PlantedEffect(Section):
    """An effect of the catalogue, planted on purpose."""

    effect: Name
    where: tuple[Name, ...] = ()
    when: tuple[dict[Name, float | Name], ...] | None = None
    parameters: dict[Name, float | tuple[float, ...] | tuple[tuple[float, ...], ...]] = Field(default_factory=dict)


class Simulate(Section):
    """A synthetic recording session."""

    subject: SimulatedSubject = SimulatedSubject()
    seed: Annotated[int, Field(ge=0)] = 0
    motions: tuple[Name, ...] = ("static", "squat", "walk")
    duration_s: Annotated[float, Field(gt=0, le=3600)] = 10.0
    rate_hz: Annotated[float, Field(gt=0, le=10_000)] = 100.0
    marker_noise_mm: NonNegative = 1.0
    force_noise_n: NonNegative = 1.0
    skin_motion_mm: NonNegative = 0.0
    gap_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.0
    effects: tuple[PlantedEffect, ...] = ()


class Config(Section):
    """Everything that a run does; relative paths have been resolved against the config's folder."""

    subject: Subject
    model: ModelSource = "whole_body"
    markers: MarkerSource
    trials: tuple[TrialFile, ...] = ()
    geometry: Geometry = Geometry()
    motion: Motion = Motion()
    contact: Contact = Contact()
    inertia: Inertia = Inertia()
    diagnosis: Diagnosis = Diagnosis()
    simulate: Simulate | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    threads: Annotated[int, Field(gt=0, le=1024)] | None = None
    """Threads of torch; absent: its own choice."""
    out: UserPath = Field(default=Path("out"), validate_default=True)
    """Folder of the results."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0

    @field_validator("trials")
    @classmethod
    def _distinct(cls, trials: tuple[TrialFile, ...]) -> tuple[TrialFile, ...]:
        names = [trial.name for trial in trials]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise PydanticCustomError("duplicate_trial", "two trials are named {names}", {"names": ", ".join(twice)})
        return trials

    @model_validator(mode="after")
    def _consistent(self) -> "Config":
        if not self.trials and self.simulate is None:
            raise PydanticCustomError("no_trials", "no trials are listed and nothing is simulated")
        if self.inertia.known_mass and self.subject.mass_kg is None:
            raise PydanticCustomError("no_mass", "inertia.known_mass needs subject.mass_kg")
        return self
