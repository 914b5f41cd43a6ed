"""Forces against feet for the trials of a session together: what one trial leaves open another may tell."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from torchid.agreement.changes import Change
from torchid.agreement.finding import Finding
from torchid.agreement.judge import judge
from torchid.errors import InputError
from torchid.io.mend import ForcesAs
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


def judge_recording(trial: Trial, recording: Recording) -> tuple[Finding, ...]:
    """Findings about one trial, as lines that can stand in a config in place of those that it has.

    Args:
        trial: as read with the recording's options, forces on the clock of the markers.
        recording: how to read it again.
    """
    found = judge(trial, recording.mass_kg, recording.again)
    options = recording.options
    if not found or (options.forces_as == ForcesAs() and not options.plates):
        return found
    bare = recording.again(Change("")) or trial
    return tuple(
        replace(f, what=f"with what the config says about them (forces_as, plates), {f.what}", removed=True)
        for f in judge(bare, recording.mass_kg, recording.again) or (replace(found[0], changes=(Change(""),)),)
    )


def judge_session(trials: Mapping[str, tuple[Trial, Recording]]) -> dict[str, tuple[Finding, ...]]:
    """Findings about every trial that has some.

    A change that one trial leaves open is settled by another trial that has the same plates and tells it.

    Args:
        trials: by name, each as read and how to read it again.
    """
    found = {name: judge_recording(trial, recording) for name, (trial, recording) in trials.items()}
    settled = {f.changes[0].line for each in found.values() for f in each if len(f.changes) == 1}
    return {name: tuple(_narrowed(f, settled) for f in each) for name, each in found.items() if each}


def _narrowed(finding: Finding, settled: set[str]) -> Finding:
    """The finding with those of its changes alone that other trials have settled, if there are some."""
    shared = tuple(change for change in finding.changes if change.line in settled)
    return replace(finding, changes=shared) if shared else finding


def holds_everywhere(change: Change, trials: Mapping[str, tuple[Trial, Recording]]) -> bool:
    """Whether every trial agrees once the change is made in all of them."""
    for trial, recording in trials.values():
        other = recording.again(change)
        if trial.forces is not None and (other is None or judge(other, recording.mass_kg)):
            return False
    return True


def refuse_disagreement(trials: Mapping[str, tuple[Trial, Recording]]) -> None:
    """Refuse a session whose forces do not agree with the feet.

    Args:
        trials: by name, each as read and how to read it again.

    Raises:
        InputError: ``forces.feet``, with what was seen and the line of the config that mends it.
    """
    found = judge_session(trials)
    if not found:
        return
    name, findings = next(iter(found.items()))
    lines = {f.changes[0].line if f.changes else "" for each in found.values() for f in each}
    one = findings[0].changes[0] if findings[0].changes else None
    where = "to the trial"
    if len(lines) == 1 and one is not None and not one.up and len(trials) > 1 and holds_everywhere(one, trials):
        where = "to the config, for every trial,"
    others = f" (and of {', '.join(n for n in found if n != name)})" if len(found) > 1 else ""
    raise InputError(
        "forces.feet",
        "; ".join(f.what for f in findings),
        source=trials[name][0].parameters.get("file", ""),
        place=f"trial {name}{others}",
        remedy=". ".join(dict.fromkeys(f.remedy(where) for f in findings)),
    )
