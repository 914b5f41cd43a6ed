"""Forces against feet for the trials of a session together: what one trial leaves open another may tell."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.finding import ForceFinding
from torchid.checks.plates_against_feet.judge import judge
from torchid.errors import InputError
from torchid.io.options import ReadOptions
from torchid.io.resample import synchronise
from torchid.recording import Trial

Read = Callable[[ReadOptions], Trial]


@dataclass(frozen=True)
class Recording:
    """A trial that can be read again in other ways."""

    read: Read
    options: ReadOptions
    mass_kg: float | None = None

    def again(self, change: Change) -> Trial | None:
        """The trial read with a change in place of what the config says about its forces, None where that fails."""
        try:
            return synchronise(self.read(changed_options(self.options, change)))
        except InputError:
            return None


def changed_options(options: ReadOptions, change: Change) -> ReadOptions:
    """The options of a trial with the change's line in its entry of the config."""
    up = options.up if change.up is None else change.up
    return replace(options, up=up, forces_as=change.forces_as, plates=change.plates)


def judge_recording(trial: Trial, recording: Recording) -> tuple[ForceFinding, ...]:
    """Findings about one trial, as lines that can stand in a config in place of those that it has.

    Args:
        trial: as read with the recording's options, forces on the clock of the markers.
        recording: how to read it again.
    """
    options, mass = recording.options, recording.mass_kg
    given = Change("", options.forces_as, options.plates)
    if options.forces_as.believe:
        return ()
    found = judge(trial, mass, recording.again)
    if not found or not given.line:
        return found
    seen = f"with what the config says about its forces: {'; '.join(f.what for f in found)}"
    for change in (Change("nothing is said of them"), *(given & c for f in found for c in f.changes)):
        other = recording.again(change)
        if other is not None and not judge(other, mass, recording.again):
            return (ForceFinding(seen, (change,), removed=True),)
    return (ForceFinding(seen, removed=True),)


def judge_session(trials: Mapping[str, tuple[Trial, Recording]]) -> dict[str, tuple[ForceFinding, ...]]:
    """Findings about every trial that has some; a line that one of them tells alone settles it where others are open.

    Args:
        trials: by name, each as read and how to read it again.
    """
    found = {name: judge_recording(trial, recording) for name, (trial, recording) in trials.items()}
    settled = {f.lines()[0] for each in found.values() for f in each if len(f.changes) == 1}
    return {name: tuple(_narrowed(f, settled) for f in each) for name, each in found.items() if each}


def _narrowed(finding: ForceFinding, settled: set[str]) -> ForceFinding:
    """The finding with those of its changes alone that other trials have settled, if there are some."""
    shared = tuple(c for c, line in zip(finding.changes, finding.lines(), strict=True) if line in settled)
    return replace(finding, changes=shared) if shared else finding


def holds_everywhere(change: Change, trials: Mapping[str, tuple[Trial, Recording]]) -> bool:
    """Whether every trial agrees once the change is made in all of them."""
    for trial, recording in trials.values():
        other = recording.again(change)
        if trial.forces is not None and (other is None or judge(other, recording.mass_kg, recording.again)):
            return False
    return True


def refuse_disagreement(trials: Mapping[str, tuple[Trial, Recording]], everywhere: bool = True) -> None:
    """Refuse a session whose forces do not agree with the feet.

    Args:
        trials: by name, each as read and how to read it again.
        everywhere: whether these are all trials of the config, so that a line may be advised for all of them.

    Raises:
        InputError: ``forces.feet``, with what was seen and the line of the config that mends it.
    """
    found = judge_session(trials)
    if not found:
        return
    name, findings = next(iter(found.items()))
    first = findings[0]
    where, same = "to the trial", [n for n, each in found.items() if each[0].lines() == first.lines()]
    alone = len(first.changes) == 1 and not first.changes[0].up and not first.removed
    if alone and everywhere and len(trials) > 1:
        if len(same) == len(found) and holds_everywhere(first.changes[0], trials):
            where = "to the config, for every trial,"
    rest = [n for n in found if n not in same]
    others = f"; forces of {', '.join(rest)} do not agree either, `torchid check` tells how" if rest else ""
    raise InputError(
        "forces.feet",
        f"{first.what}{others}",
        source=trials[name][0].parameters.get("file", ""),
        place=f"trial{'s' if same[1:] else ''} {', '.join(same)}",
        remedy=first.remedy(where),
    )
