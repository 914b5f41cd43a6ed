"""What ``torchid check`` found as JSON with a published schema."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter

from torchid.checks.finding import Finding, FindingRecord, record_of
from torchid.checks.plates import PlateCheck
from torchid.checks.recording import TrialCheck
from torchid.checks.report import DEFECT, CheckItem, Refusal
from torchid.conventions import GRAVITY
from torchid.errors import Note

VERSION = 2
"""Of the JSON; raised when a key changes its meaning or goes."""


@dataclass(frozen=True)
class MarkersRecord:
    """The markers of a recording."""

    count: int
    rate_hz: float
    frames: int
    duration_s: float
    gaps: dict[str, float]
    """Missing samples [%] of every marker."""


@dataclass(frozen=True)
class SuspectRecord:
    """What may be wrong with a plate."""

    hypothesis: str
    """Key and value of the line, such as ``turn_deg=180``."""
    config: str
    """The line that mends it if it is so."""
    evidence: str
    """What was seen, in figures."""


@dataclass(frozen=True)
class PlateRecord:
    """One plate during a recording."""

    id: str
    type: str
    """In the C3D file, empty where the file has none."""
    weight_kg: float | None
    """Mean vertical force while somebody is on it, as a mass."""
    cop_to_sole_m: float | None
    """Median distance of the pressure from the nearest foot."""
    mean_N: float  # noqa: N815 - units end keys
    peak_N: float  # noqa: N815
    unloaded_N: float | None  # noqa: N815
    """Median vertical force while nobody is on it."""
    outside: float
    """Share of the loaded time that the pressure lies beside the plate."""
    saturated: int
    """Samples on a plateau at the peak."""
    suspect: tuple[SuspectRecord, ...]


@dataclass(frozen=True)
class FileRecord:
    """A recording that could be read."""

    name: str
    file: str
    subject: str
    markers: MarkersRecord
    force_rate_hz: float | None
    plates: tuple[PlateRecord, ...]
    weight_kg: float | None
    """Mean vertical force over the frames where the plates carry somebody, as a mass."""
    moved_kg: float | None
    """The same with the markers' vertical acceleration."""
    recorded_kg: float | None
    units: str
    up: str
    events: int
    problems: tuple[FindingRecord, ...]
    """What makes a result wrong or impossible until it is mended."""
    warnings: tuple[FindingRecord, ...]
    """What is at fault and harms no result."""
    notes: tuple[Note, ...]
    """What reading chose or repaired without it being a problem."""


@dataclass(frozen=True)
class CheckReport:
    """Everything that one call of ``torchid check`` found."""

    version: int
    files: tuple[FileRecord, ...]
    refused: tuple[Refusal, ...]
    notes: tuple[Note, ...] = ()
    """What was decided about markers and model of a config's session."""

    @property
    def defects(self) -> bool:
        """A defect of torchid has shown in some recording."""
        return any(one.code == DEFECT for one in self.refused)

    @property
    def clean(self) -> bool:
        """Nothing was refused, and no recording has a problem."""
        return not self.refused and not any(file.problems for file in self.files)


def report(findings: Iterable[CheckItem]) -> CheckReport:
    """All findings together."""
    sorted_ = {kind: [] for kind in (TrialCheck, Refusal, Note)}
    for finding in findings:
        sorted_[type(finding)].append(finding)
    files = tuple(_file(check) for check in sorted_[TrialCheck])
    return CheckReport(VERSION, files, tuple(sorted_[Refusal]), tuple(sorted_[Note]))


def _file(check: TrialCheck) -> FileRecord:
    markers = MarkersRecord(check.markers, check.rate, check.frames, check.duration, check.gaps)
    plates = tuple(_plate(plate, check) for plate in check.plates)
    problems, warnings = (tuple(map(record_of, some)) for some in (check.problems, check.warnings))
    return FileRecord(
        check.name, check.source, check.subject, markers, check.force_rate, plates, check.weight, check.mass,
        check.recorded_mass, check.units, check.up, check.events, problems, warnings, check.notes,
    )  # fmt: skip


def _plate(plate: PlateCheck, check: TrialCheck) -> PlateRecord:
    weight = None if plate.loaded is None else plate.loaded / GRAVITY
    suspect = tuple(one for problem in check.problems for one in _suspects(problem, plate.name))
    return PlateRecord(
        plate.name, plate.kind, weight, check.to_sole.get(plate.name), plate.mean, plate.peak, plate.baseline,
        plate.outside, plate.saturated, suspect,
    )  # fmt: skip


def _suspects(problem: Finding, plate: str) -> Iterator[SuspectRecord]:
    for cure in problem.cures:
        if not cure.plates or plate in {f"plate {n}" for n in cure.plates}:
            yield SuspectRecord(cure.hypothesis, cure.config, problem.evidence)


def to_json(found: CheckReport) -> str:
    """The report as JSON that ``schema`` describes; a number that is not known is null."""
    return TypeAdapter(CheckReport).dump_json(found, indent=2).decode()


def schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of ``to_json``, as ``docs/check.schema.json`` has it."""
    made = TypeAdapter(CheckReport).json_schema(mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_with_unknown(made)}


def _with_unknown(part: Any) -> Any:
    """The same with null beside every number: JSON has no NaN."""
    if isinstance(part, list):
        return [_with_unknown(one) for one in part]
    if not isinstance(part, dict):
        return part
    known = {key: _with_unknown(value) for key, value in part.items()}
    return {**known, "type": ["number", "null"]} if known.get("type") == "number" else known
