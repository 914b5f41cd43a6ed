"""Hides an effect by lot in a simulated session, runs torchid on the files alone, opens the truth only then.

scripts/demo              # the lot is drawn from the clock
scripts/demo 7            # the same again
scripts/demo 7 simulate.duration_s=10 diagnosis.max_effects=1
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

from harness.command import ROOT, by_lot
from hiding import draw_hidden, judge

from torchid.config import Config, load_config
from torchid.diagnosis.verdict.records import Cause
from torchid.report.cause_sentences import called, chance, told
from torchid.run import run_experiment, run_simulation
from torchid.session import Outcome

CONFIG = ROOT / "configs" / "demo.yaml"


def main(arguments: list[str]) -> None:
    """Simulate, run, say, and only then compare."""
    seed, overrides = by_lot(arguments)
    config = load_config(CONFIG, [f"seed={seed}", *overrides])
    config = hide(config.model_copy(update={"out": config.out / str(config.seed)}))
    print(f"Seed {config.seed} (`scripts/demo {config.seed}` repeats it). Simulating ...", flush=True)
    recordings = run_simulation(config)
    print("Identifying and diagnosing from the files alone ...", flush=True)
    outcome = run_experiment(blind(config, recordings))
    print("\n".join(verdict(outcome)), flush=True)
    truth = json.loads((recordings.parent / "truth" / "subject.json").read_text())["options"]["effects"]
    causes = json.loads((config.out / "diagnosis.json").read_text())["causes"]
    print("\n".join(compared(truth, [cause for cause in causes if cause["level"] != "possible"])))
    print(f"Report: {config.out / 'report.html'}")


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
    none = ["Verdict: no effect of the catalogue is supported by the recordings."]
    if found is None:
        return none
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


if __name__ == "__main__":
    main(sys.argv[1:])
