"""Sections of the config with their defaults; strict, so that a misspelt key or a quoted number is an error.

The sections of stages are the stages' own options: pydantic validates a dataclass under the strictness of
``ConfigSection``.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, field_validator, model_validator
from pydantic_core import PydanticCustomError

from torchid.config.conditions import Condition, EvaluateOptions, faults
from torchid.config.paths import PROJECT_DATA as PROJECT_DATA
from torchid.config.paths import UserPath, resolve_path
from torchid.contact.options import ContactOptions
from torchid.conventions import Count, Name, Positive
from torchid.diagnosis.options import DiagnosisOptions
from torchid.geometry.options import GeometryOptions
from torchid.inertia.options import IdentifyOptions
from torchid.io.mend import ForcesAs, PlateAs
from torchid.model.tree_of_links import FileScatter
from torchid.simulate.options import SimulateOptions
from torchid.storage.table_forms import Form

BUILTIN_MODELS = ("whole_body",)
MODEL_SUFFIXES = (".urdf", ".xml", ".osim", ".b3d")
MARKER_SUFFIXES = (".yaml", ".yml", ".json")


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


ModelSource = Annotated[Path | str, PlainValidator(_model)]
MarkerSource = Annotated[Path | str, PlainValidator(_markers)]


class ConfigSection(BaseModel):
    """Base of all sections: frozen, strict types, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Subject(ConfigSection):
    """Whom the recordings show."""

    name: Name
    """Name in the report and in the files."""
    mass_kg: Annotated[float, Field(gt=0, lt=1000)] | None = None
    """Mass on a scale; absent: a body mass index of 23 +- 4 kg/m^2, and what standing on plates says."""
    mass_sd_kg: Positive | None = None
    """Standard deviation of the recorded mass; absent: 1 %."""
    height_m: Annotated[float, Field(gt=0.3, lt=3)] | None = None
    """Standing height, which scales the template; absent: the mean of adults, or of children of ``age_years``."""
    sex: Literal["male", "female", "unknown"] = "unknown"
    """Chooses the tables of proportions and inertia; unknown: the mean of both."""
    age_years: Annotated[float, Field(gt=0, lt=120)] | None = None
    """Changes the shares of mass for children and old people; absent: an adult's, unless the stature is a child's."""
    people: UserPath | None = None
    """Whom the subject is like: a cohort's `people.nc`, by which the tables of inertia are changed (docs/cohort.md)."""

    @property
    def known(self) -> tuple[float | None, float | None, float | None, str, float | None]:
        """Height, mass and its standard deviation, sex and age, in the order of ``inertial_prior``."""
        return self.height_m, self.mass_kg, self.mass_sd_kg, self.sex, self.age_years


class TrialFile(ConfigSection):
    """One recording and what it is used for."""

    name: Name
    """Name in all files of results."""
    file: UserPath
    """C3D, TRC, ``_motion.tsv`` of BIDS, or a trial of a .b3d as if that were a folder: ``S1.b3d/walk``."""
    forces: UserPath | None = None
    """MOT or STO beside a TRC or ``_motion.tsv``, or instead of the plates of a C3D or .b3d."""
    role: Literal["static", "fit", "heldout"] = "fit"
    """Standing still, used to identify the body, or held out to test predictions."""
    subject: Name | tuple[Name, ...] | None = None
    """Prefix of the labels, where a file holds several subjects; a list, where one is stored as several bodies."""
    up: Literal["y", "z"] | None = None
    """Vertical axis of the file; absent: told from the recording."""
    units: Literal["mm", "cm", "dm", "m", "in"] | None = None
    """Unit of the markers; absent: what the file says."""
    allow_truncated: bool = False
    """True reads the frames of a file that ends before its header says."""
    forces_as: ForcesAs | None = None
    """What is wrong with its forces; absent: what the config says for all trials."""
    plates: dict[int, PlateAs] | None = None
    """What is wrong with single force plates, by number; absent: what the config says for all trials."""
    condition: Name | None = None
    """Name of the condition under which it was recorded (``conditions``)."""
    channels: UserPath | None = None
    """What the device recorded meanwhile: a MOT, STO or CSV file with a column of times [s] first."""
    geometry: bool = True
    """Takes part in the fit of the geometry."""
    inertia: bool = True
    """Takes part in the fit of the inertia."""


class MotionOptions(ConfigSection):
    """Filter of kinematics and forces alike."""

    filter: Literal["spline", "butterworth"] = "spline"
    """Smoothing spline (default), or a Butterworth filter run forwards and backwards."""
    cutoff_hz: Positive | Literal["auto"] = "auto"
    """Frequency above which motion and forces are filtered out; auto: chosen from the recordings."""
    consistent: bool = False
    """True finds for every moving trial whose contacts plates measure the motion that obeys them, too, once the inertia
    is identified (docs/torques.md)."""


@dataclass(frozen=True)
class Inertia(IdentifyOptions):
    """Fit of mass, centre of mass and inertia tensor of every segment: the stage's options and three more."""

    enabled: bool = True
    """False ends the run after geometry and motion."""
    known_mass: bool = False
    """Hold the total mass at ``subject.mass_kg`` (within ``mass_sd_kg``, or 0.1 %)."""
    com_boxes: bool = False
    """Keep each centre of mass within three prior standard deviations of the template's."""


class Torques(ConfigSection):
    """How far joint torques can be trusted."""

    draws: Annotated[int, Field(ge=0, le=4096)] = 0
    """Bodies, plates and errors of markers that are drawn for the standard deviations of torques (docs/torques.md), and
    errors of markers alone for those of motion that obeys its forces; 0: none, which saves some seconds for every
    minute of motion. Thirty know a standard deviation to 13 %."""


class DiagnosisSection(ConfigSection):
    """What the identified model still gets wrong."""

    enabled: bool = True
    """False leaves the diagnosis out: no cause is sought and no recording is corrected."""
    max_effects: Annotated[int, Field(ge=0, le=20)] = 3
    """Of each kind: on forces, on markers, of bodies, of what is recorded, all over a body."""
    include: tuple[Name, ...] = ()
    """Effects to try; empty means the whole catalogue."""
    exclude: tuple[Name, ...] = ()
    """Effects to leave out."""
    thresholds: DiagnosisOptions = DiagnosisOptions()
    """Everything that decides a verdict; change it to see what hangs on it, not to get another verdict."""


class Config(ConfigSection):
    """Everything that a run does; relative paths have been resolved against the config's folder."""

    subject: Subject
    """Whom the recordings show."""
    model: ModelSource = "whole_body"
    """The built-in template, or the path of a URDF, MJCF (.xml) or OpenSim file, or of a .b3d that holds one."""
    scatter: FileScatter = FileScatter()
    """How uncertain the numbers of a model file are."""
    markers: MarkerSource = "auto"
    """Name of a built-in marker set, or the path of a YAML file {label: segment}; auto: the built-in set that lists
    most labels, the others by their words (docs/folder.md), or the markers of an OpenSim model."""
    unlisted: Literal["assign", "leave_out"] | None = None
    """Labels that the marker set does not list: assigned by where they stand and how they move, or left out; absent:
    left out by a set of the user's own (a path), assigned by a built-in one."""
    trials: tuple[TrialFile, ...] = ()
    """The recordings."""
    forces_as: ForcesAs = ForcesAs()
    """How the forces of every trial are to be read, where they are not as they should be."""
    plates: dict[int, PlateAs] = Field(default_factory=dict)
    """How single force plates of every trial are to be read, by number."""
    geometry: GeometryOptions = GeometryOptions()
    """Fit of segment lengths, joint centres, marker places and postures."""
    motion: MotionOptions = MotionOptions()
    """Filter of motion and forces."""
    contact: ContactOptions = ContactOptions()
    """What counts as contact, and as contact on a plate (docs/contact.md)."""
    inertia: Inertia = Inertia()
    """Fit of mass, centre of mass and inertia tensor of every segment."""
    torques: Torques = Torques()
    """Standard deviations of joint torques (docs/torques.md)."""
    diagnosis: DiagnosisSection = DiagnosisSection()
    """Search for what the identified model gets wrong (docs/diagnosis.md)."""
    laboratory: UserPath | None = None
    """What earlier sessions on the same plates say of the instruments: a laboratory's file of a cohort
    (docs/cohort.md)."""
    conditions: dict[Name, Condition] = Field(default_factory=dict)
    """Under which trials were recorded, one of them the reference; trials with a device tell nothing of the body."""
    evaluate: EvaluateOptions = EvaluateOptions()
    """What `torchid evaluate` compares (docs/evaluate.md)."""
    simulate: SimulateOptions | None = None
    """A synthetic session in place of recordings."""
    threads: Annotated[Count, Field(le=1024)] = 1
    """Threads of torch. More help little with a session of seconds, and wait for each other on a busy machine."""
    out: UserPath = Field(default=Path("out"), validate_default=True)
    """Folder of the results."""
    tables: tuple[Form, ...] = ()
    """Forms beside CSV in which the tables of results and cycles are written: `pip install 'torchid[tables]'`."""
    bids: bool = False
    """True writes what was measured and found of each trial as a data set of Motion-BIDS, too (docs/results.md)."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Of all random draws."""

    @property
    def body(self) -> "Config":
        """The config of the body alone: without the trials that were recorded with a device on, and their intervals."""
        worn = {name for name, condition in self.conditions.items() if condition.device is not None}
        alone = tuple(
            trial.model_copy(update={"condition": None, "channels": None})
            for trial in self.trials
            if trial.condition not in worn
        )
        kept = {"trials": alone, "contact": self._contact_without(worn), "conditions": {}}
        return self.model_copy(update={**kept, "evaluate": EvaluateOptions()})

    def _contact_without(self, conditions: set[str]) -> ContactOptions:
        """Contacts without the intervals of the trials of some conditions; without any left, one never bears."""
        gone = {trial.name for trial in self.trials if trial.condition in conditions}
        others = {
            name: replace(one, when={trial: parts for trial, parts in one.when.items() if trial not in gone})
            if isinstance(one.when, dict)
            else one
            for name, one in self.contact.others.items()
        }
        return replace(self.contact, others=others)

    @property
    def unlisted_choice(self) -> Literal["assign", "leave_out"]:
        """``unlisted``, or its default for these markers."""
        return self.unlisted or ("leave_out" if isinstance(self.markers, Path) else "assign")

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
        named = {trial for one in self.contact.others.values() if isinstance(one.when, dict) for trial in one.when}
        unknown = sorted(named - {trial.name for trial in self.trials})
        if unknown and self.trials:
            said = {"names": ", ".join(unknown)}
            raise PydanticCustomError("unknown_trial", "a contact bears in trials that are not listed: {names}", said)
        fault = faults(self.conditions, {trial.name: trial.condition for trial in self.trials})
        if fault is not None:
            raise PydanticCustomError(fault.kind, "{said}", {"said": fault.said})  # pyright: ignore[reportArgumentType]
        return self
