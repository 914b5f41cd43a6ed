"""What ``torchid check`` found, recording by recording, and the same as JSON with a published schema."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from torchid.checks.plates_against_feet.session import Recording, judge_recording
from torchid.checks.recording import TrialCheck, check_trial, stated_mass
from torchid.errors import Note, TorchidError
from torchid.io import ReadOptions, read_trial
from torchid.io.resample import synchronise
from torchid.recording import Trial

VERSION = 1
"""Of the JSON; raised when a key changes its meaning or goes."""


@dataclass(frozen=True)
class Given:
    """A recording that is to be checked."""

    name: str
    file: Path
    forces: Path | None = None
    role: str = "fit"
    options: ReadOptions = ReadOptions()
    mass_kg: float | None = None
    """The subject's mass on record; absent: what the file states."""
    on_feet: Callable[[Trial], Trial] = lambda trial: trial
    """Leaves of a trial's forces what feet must answer for."""

    def read(self, options: ReadOptions) -> Trial:
        """The trial, read with these options."""
        return read_trial(self.name, self.file, self.forces, self.role, options)

    def disagreements(self, trial: Trial) -> tuple[Note, ...]:
        """Where its forces do not agree with the feet, each with its cure, by the judgement that a run makes."""
        left_out = any(trial.parameters.get(f"plates {kind}") for kind in ("refused", "overloaded"))
        if (trial.forces is None and not left_out) or len(trial.markers.time) < 2:
            return ()
        mass = self.mass_kg if self.mass_kg is not None else stated_mass(trial)
        again = Recording(lambda options: self.on_feet(self.read(options)), self.options, mass)
        found = judge_recording(self.on_feet(synchronise(trial)), again)
        return tuple(
            Note("forces.feet", f"{f.what}. Cure: {f.remedy('to the trial in a config')}", str(self.file))
            for f in found
        )


@dataclass(frozen=True)
class Refusal:
    """An error: of a file that could not be read, or of the session that a config describes."""

    source: str
    place: str
    code: str
    message: str
    found: str
    remedy: str
    text: str
    """All of it in one line, as the terminal has it."""

    @staticmethod
    def of(error: TorchidError) -> "Refusal":
        """From an error."""
        return Refusal(error.source, error.place, error.code, error.message, error.found, error.remedy, str(error))


@dataclass(frozen=True)
class CheckReport:
    """Everything that one call of ``torchid check`` found."""

    version: int
    recordings: tuple[TrialCheck, ...]
    refused: tuple[Refusal, ...]
    notes: tuple[Note, ...] = ()
    """What was decided about markers and model of a config's session."""

    @property
    def clean(self) -> bool:
        """Nothing was refused, and no recording has a problem."""
        return not self.refused and not any(check.problems for check in self.recordings)


CheckItem = TrialCheck | Refusal | Note


def check_recordings(
    given: Iterable[Given], keep: Callable[[Trial], object] = lambda trial: None
) -> Iterator[TrialCheck | Refusal]:
    """What each recording holds, or why it cannot be read, one after the other.

    Args:
        given: the recordings.
        keep: gets every trial that could be read.
    """
    for one in given:
        try:
            trial = one.read(one.options)
            found = check_trial(trial, one.mass_kg, one.disagreements(trial))
        except TorchidError as error:
            yield Refusal.of(error)
            continue
        keep(trial)
        yield found


def report(findings: Iterable[CheckItem]) -> CheckReport:
    """All findings together."""
    sorted_ = {kind: [] for kind in (TrialCheck, Refusal, Note)}
    for finding in findings:
        sorted_[type(finding)].append(finding)
    return CheckReport(VERSION, *(tuple(sorted_[kind]) for kind in (TrialCheck, Refusal, Note)))


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
