"""Forces against feet for the trials of a session together: what one trial leaves open another may tell."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from torchid.checks.plates_against_feet.changes import Change, contradict
from torchid.checks.plates_against_feet.finding import ForceFinding, without
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
    """Findings about every trial that has some, reconciled.

    Args:
        trials: by name, each as read and how to read it again.
    """
    found = {name: judge_recording(trial, recording) for name, (trial, recording) in trials.items()}
    return reconciled({name: each for name, each in found.items() if each}, trials)


def reconciled(
    found: Mapping[str, tuple[ForceFinding, ...]], trials: Mapping[str, tuple[Trial, Recording]]
) -> dict[str, tuple[ForceFinding, ...]]:
    """Findings about trials of one session: a line that one tells alone settles it where others are open.

    Lines of two trials that contradict each other about one plate are not both advised: one that mends both is, or
    none.

    Args:
        found: by trial, of those that have some.
        trials: by name, each as read and how to read it again.
    """
    settled = {f.lines()[0] for each in found.values() for f in each if len(f.changes) == 1}
    narrowed = {name: tuple(_narrowed(f, settled) for f in each) for name, each in found.items()}
    clash = _contradiction(narrowed)
    if clash is None:
        return narrowed
    number, told = clash
    concerned = {name: trials[name] for name in told}
    options = [change for each in told.values() for change in each]
    shared = [change for change in options if holds_everywhere(change, concerned)][:1]
    return {
        name: tuple(_settled(f, number, told, shared) for f in each) if name in told else each
        for name, each in narrowed.items()
    }


def _contradiction(found: Mapping[str, tuple[ForceFinding, ...]]) -> tuple[int, dict[str, tuple[Change, ...]]] | None:
    """The first plate of which two trials tell nothing that can both be, and the changes that each trial tells."""
    told = {name: each[0].changes for name, each in found.items()}
    for number in sorted({n for changes in told.values() for change in changes for n in change.plates}):
        about = {name: own for name, own in told.items() if own and all(number in change.plates for change in own)}
        for one, other in combinations(about.values(), 2):
            if all(contradict(a, b, number) for a in one for b in other):
                return number, about
    return None


def _settled(
    finding: ForceFinding, number: int, told: Mapping[str, tuple[Change, ...]], shared: Sequence[Change]
) -> ForceFinding:
    """The finding about a plate of which trials tell what cannot both be: with the line that mends all, or none."""
    if not all(number in change.plates for change in finding.changes):
        return finding
    if shared:
        return replace(finding, changes=(shared[0],))
    each = "; ".join(f"{name}: {' or '.join(f'`{c.line}`' for c in own)}" for name, own in told.items())
    advice = (
        f"Trials contradict each other about plate {number} ({each}), and one plate cannot be both. Compare what their "
        f"files say of it and whether it was changed between them; to go on without it add `{without(number).line}`"
    )
    return replace(finding, changes=(), advice=advice)


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
