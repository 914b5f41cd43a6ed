"""What the config changes in the forces of trials as they are read."""

from collections.abc import Iterator
from dataclasses import fields

from torchid.config import Config
from torchid.config.sections import TrialFile
from torchid.io.mend import ForcesAs, PlateAs, in_config
from torchid.session import Outcome
from torchid.wording import listing

FEW = 4
"""Choice. Trials, and values of a key, that are listed."""


def read_as(outcome: Outcome) -> str:
    """Return in one sentence what the config changes in forces as they are read; empty where it changes nothing.

    Args:
        outcome: the run.
    """
    trials = outcome.session.trials
    values: dict[str, dict[str, list[str]]] = {}
    for name, file in outcome.session.files.items():
        for key, value in _changes(outcome.config, file, name in trials and trials[name].forces is not None):
            values.setdefault(key, {}).setdefault(value, []).append(name)
    parts = [
        f"{key} {listing([f'{value} in {_trials(names, len(trials))}' for value, names in own.items()], FEW)}"
        for key, own in values.items()
    ]
    return f"Read with {'; '.join(parts)}." if parts else ""


def _trials(names: list[str], count: int) -> str:
    return "all trials" if len(names) == count > 1 else listing(names, FEW)


def _changes(config: Config, file: TrialFile, forceful: bool) -> Iterator[tuple[str, str]]:
    """Keys and values of a trial's lines, and of those for all trials where it has none of its own."""
    forces = config.forces_as if file.forces_as is None else file.forces_as
    if not forceful and forces.use:
        return
    yield from ((f"forces_as {key}", value) for key, value in _entries(forces))
    plates = config.plates if file.plates is None else file.plates
    for number, plate in plates.items():
        yield from ((f"plate {number} {key}", value) for key, value in _entries(plate))


def _entries(change: ForcesAs | PlateAs) -> Iterator[tuple[str, str]]:
    for one in fields(change):
        if getattr(change, one.name) != one.default:
            yield one.name, in_config(getattr(change, one.name))
