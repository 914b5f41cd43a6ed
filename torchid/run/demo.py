"""Hides an effect by lot in a simulated session, runs torchid on the files alone, opens the truth only then."""

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path

from torchid.config import Config, load_config
from torchid.diagnosis.verdict.records import Cause
from torchid.report.cause_sentences import called, chance, told
from torchid.run.sequence import run_experiment
from torchid.run.simulation import run_simulation
from torchid.session import Outcome
from torchid.session.fitting import OnStage
from torchid.simulate.hiding import draw_hidden, judge

SECTIONS = "demo.yaml"
"""Config of the session: beside this module where torchid is installed, in ``configs`` of a checkout."""
OUT = Path("out") / "demo"
"""Folder of the results, from where the command is given."""


def by_lot(words: Sequence[str]) -> tuple[int, Sequence[str]]:
    """Return the seed that stands first, else the clock's, and what stands behind it.

    Args:
        words: of a command.
    """
    given = bool(words) and words[0].isdecimal()
    return int(words[0]) if given else time.time_ns() // 10**6 % 10**6, words[given:]


def demo_config(seed: int, overrides: Sequence[str] = ()) -> Config:
    """Return the config of a seed, with the effect that it hides.

    Args:
        seed: of the person, their motion, and of what is hidden.
        overrides: as ``key=value``; ``out`` is meant from where the command is given.
    """
    own = [one for one in overrides if not one.startswith("out=")]
    out = Path(next((one.removeprefix("out=") for one in overrides if one.startswith("out=")), OUT)).resolve()
    with as_file(files("torchid.run").joinpath(SECTIONS)) as installed:
        found = installed if installed.exists() else Path(__file__).parents[2] / "configs" / SECTIONS
        config = load_config(found, [f"seed={seed}", *own])
    return hide(config.model_copy(update={"out": out / str(config.seed)}))


def demonstrate(config: Config, progress: OnStage) -> Iterator[str]:
    """Simulate, run, say, and only then compare; yields lines for a person as they come.

    Args:
        config: as of ``demo_config``.
        progress: hears of every stage.
    """
    yield f"Seed {config.seed} (`torchid demo {config.seed}` repeats it). Simulating ..."
    recordings = run_simulation(config)
    yield "Identifying and diagnosing from the files alone ..."
    outcome = run_experiment(blind(config, recordings), progress)
    yield from verdict(outcome)
    truth = json.loads((recordings.parent / "truth" / "subject.json").read_text())["options"]["effects"]
    if outcome.diagnosis is not None:
        causes = json.loads((config.out / "diagnosis.json").read_text())["causes"]
        yield from compared(truth, [cause for cause in causes if cause["level"] != "possible"])
    yield f"Report: {config.out / 'report.html'}"


def hide(config: Config) -> Config:
    """The config with an effect drawn by lot, unless it names its own."""
    assert config.simulate is not None
    if config.simulate.effects:
        return config
    effects = draw_hidden(config.seed, config.simulate)
    return config.model_copy(update={"simulate": replace(config.simulate, effects=effects)})


def blind(config: Config, recordings: Path) -> Config:
    """What the fits may know: the written recordings and the options, not what was simulated."""
    made = load_config(recordings)
    found = {"subject": made.subject, "trials": made.trials, "markers": made.markers, "simulate": None}
    return config.model_copy(update=found)


def verdict(outcome: Outcome) -> list[str]:
    """The diagnosis in plain lines."""
    found = outcome.diagnosis
    if found is None:
        return ["Nothing was diagnosed."]
    none = ["Verdict: no effect of the catalogue is supported by the recordings."]
    lines = [_named("Verdict", cause) for cause in found.likely] or none
    lines += [_named("Possible", cause) for cause in found.possible]
    if found.unexplained.significant:
        lines.append(f"Something else remains: {found.unexplained.description}.")
    return lines


def _named(said: str, cause: Cause) -> str:
    twins = " or ".join(called(twin) for twin in cause.indistinguishable)
    return f"{said}: {told(cause)[:-1]} ({chance(cause.confidence)}{f'; or {twins}' if twins else ''})."


def compared(truth: list[dict], causes: list[dict]) -> list[str]:
    """The truth, and whether the verdict was right."""
    right, sizes = judge(truth, causes)
    hidden = "; ".join(f"{one['effect']} at {', '.join(one['where'])}" for one in truth) or "nothing"
    return [f"Truth: {hidden}. The verdict was {'right' if right else 'wrong'}.", *(f"  {size}" for size in sizes)]
