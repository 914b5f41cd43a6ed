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
    """Fit of joint centres, lengths and marker places; the fields of ``GeometryOptions``."""

    solver: Literal["arrow", "adam", "lbfgs"] = "arrow"
    symmetry: Literal["none", "tied"] = "none"
    groups: dict[Name, tuple[Name, ...]] = Field(default_factory=dict)
    sigma_mm: Positive | dict[Name, Positive] = 5.0
    reestimate_sigma: bool = True
    robust: Positive | None = 4.0
    static_posture_sd: Positive = 0.2
    limit_sd: Positive = 0.05
    temporal: bool = True
    max_frames: Annotated[int, Field(gt=0)] = 1000
    static_frames: Annotated[int, Field(gt=0)] = 30
    iterations: Annotated[int, Field(gt=0, le=100_000)] = 60
    gradient_iterations: Annotated[int, Field(gt=0, le=1_000_000)] = 2000
    tolerance: Positive = 1e-6


class Motion(Section):
    """Filter of kinematics and forces alike; the fields of ``MotionOptions``."""

    filter: Literal["spline", "butterworth"] = "spline"
    cutoff_hz: Positive | Literal["auto"] = "auto"


class Contact(Section):
    """When all contact is on the plates; the fields of ``ContactOptions``."""

    height_m: Positive = 0.03
    speed_m_s: Positive = 0.4
    loaded_n: Positive = 20.0
    margin_m: NonNegative = 0.03
    reach_m: Positive = 0.10
    shortest_s: NonNegative = 0.06


class Inertia(Section):
    """Fit of mass, centre of mass and inertia tensor of every segment; fields of ``InertiaOptions`` and two more."""

    enabled: bool = True
    lmi: bool = True
    prior: Literal["quadratic", "entropic"] = "quadratic"
    prior_weight: Literal["evidence", "cross_validation"] | Positive = "evidence"
    prior_weight_range: tuple[Positive, Positive] = (1.0, 1e3)
    refuse: bool = True
    known_mass: bool = False
    """Hold the total mass at ``subject.mass_kg`` (within ``mass_sd_kg``, or 0.1 %)."""
    com_boxes: bool = False
    """Keep each centre of mass within three prior standard deviations of the template's."""


class Diagnosis(Section):
    """What the identified model still gets wrong."""

    enabled: bool = False
    max_effects: Annotated[int, Field(ge=0, le=20)] = 3
    include: tuple[Name, ...] = ()
    """Effects to try; empty means the whole catalogue."""
    exclude: tuple[Name, ...] = ()


class Simulate(Section):
    """A synthetic recording session; the fields of ``SimulateOptions`` and the effects to plant."""

    fit: tuple[Name, ...] = ("squats", "hip_rom", "arms", "trunk")
    heldout: tuple[Name, ...] = ("sway_steps", "walk")
    duration_s: Positive = 10.0
    rate_hz: Positive = 100.0
    plates: Annotated[int, Field(ge=1, le=4)] = 4
    marker_noise_mm: NonNegative = 1.0
    force_noise_n: NonNegative = 2.0
    skin_motion_mm: NonNegative = 0.0
    gap_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.0
    mass_kg: Positive | None = None
    height_m: Positive | None = None
    sex: Literal["male", "female"] | None = None
    scatter: NonNegative = 1.0


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
