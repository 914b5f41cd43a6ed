"""What ``torchid check`` finds, recording by recording."""

import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from torchid.checks.plates_against_feet.finding import ForceFinding
from torchid.checks.plates_against_feet.readings import pressures_to_soles
from torchid.checks.plates_against_feet.session import Recording, judge_recording, reconciled
from torchid.checks.recording import TrialCheck, check_trial, stated_mass
from torchid.errors import Note, TorchidError, said_of_defect
from torchid.io import ReadOptions, read_trial
from torchid.io.resample import synchronise
from torchid.recording import Trial

DEFECT = "torchid.defect"
"""Wording. Code of what is an error of torchid's own."""
log = logging.getLogger(__name__)


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

    def disagreements(self, trial: Trial) -> tuple[ForceFinding, ...]:
        """Where its forces do not agree with the feet, each with its cure, by the judgement that a run makes."""
        return judge_recording(*self.to_judge(trial)) if judged(trial) else ()

    def to_judge(self, trial: Trial) -> tuple[Trial, Recording]:
        """The trial as its forces are judged, and how to read it again."""
        return self.on_feet(synchronise(trial)), self.again(trial)

    def again(self, trial: Trial) -> Recording:
        """How to read the trial in other ways; what its file states of the mass holds where none is on record."""
        mass = self.mass_kg if self.mass_kg is not None else stated_mass(trial)
        return Recording(lambda options: self.on_feet(self.read(options)), self.options, mass)

    def checked(self, trial: Trial, found: tuple[ForceFinding, ...]) -> TrialCheck:
        """All about the trial, with what is wrong with its forces."""
        said = tuple(one.as_finding(str(self.file)) for one in found)
        to_sole = pressures_to_soles(self.to_judge(trial)[0]) if judged(trial) and trial.forces is not None else {}
        return check_trial(trial, self.mass_kg, said, to_sole)


def judged(trial: Trial) -> bool:
    """Whether there are forces to judge, or plates that reading has left out."""
    left_out = any(trial.parameters.get(f"plates {kind}") for kind in ("refused", "overloaded"))
    return (trial.forces is not None or left_out) and len(trial.markers.time) > 1


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

    @staticmethod
    def of_defect(source: str, error: Exception) -> "Refusal":
        """From an error that is none of torchid's own, in one recording among others."""
        said, remedy = said_of_defect(error), "Report it; the traceback: --debug"
        text = f"{source}: a defect of torchid: {said} (the traceback: --debug)"
        return Refusal(source, "", DEFECT, "a defect of torchid", said, remedy, text)


CheckItem = TrialCheck | Refusal | Note


def check_recordings(
    given: Iterable[Given], keep: Callable[[Trial], object] = lambda trial: None, one_session: bool = False
) -> Iterator[TrialCheck | Refusal]:
    """What each recording holds, or why it cannot be read, one after the other.

    Args:
        given: the recordings.
        keep: gets every trial that could be read.
        one_session: whether they are of one subject in one laboratory: those whose forces do not agree with the feet
            then come last, when all have been heard, for one may settle what another leaves open.
    """
    held: dict[str, tuple[Given, Trial, tuple[ForceFinding, ...]]] = {}
    for one in given:
        try:
            trial = one.read(one.options)
            found = one.disagreements(trial)
            if found and one_session:
                held[one.name] = one, trial, found
            else:
                checked = one.checked(trial, found)
        except TorchidError as error:
            yield Refusal.of(error)
            continue
        except Exception as error:  # one recording's, while a folder has others
            log.debug("%s", one.file, exc_info=error)
            yield Refusal.of_defect(str(one.file), error)
            continue
        keep(trial)
        if one.name not in held:
            yield checked
    trials = {name: one.to_judge(trial) for name, (one, trial, _) in held.items()}
    for name, found in reconciled({name: found for name, (_, _, found) in held.items()}, trials).items():
        one, trial, _ = held[name]
        yield one.checked(trial, found)
