"""Hides a device by lot in a simulated session, evaluates the files alone, opens the truth only then.

scripts/demo --device              # the lot is drawn from the clock
scripts/demo --device 7            # the same again
scripts/demo --device 7 simulate.duration_s=6
"""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import yaml
from harness.command import ROOT

from torchid.config import Config, load_config
from torchid.cycles.measures import measure
from torchid.devices import Device, load_device
from torchid.evaluation.evaluate import evaluate
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.simulation import simulate_conditions
from torchid.run.demo import by_lot
from torchid.storage.results import OutputFolder

CONFIG = ROOT / "configs" / "evaluate_simulated.yaml"
JOINTS = {"hip": ("pelvis", "thigh"), "knee": ("thigh", "shank"), "ankle": ("shank", "foot")}
RANGES = {"hip": (15.0, 60.0), "knee": (15.0, 60.0), "ankle": (30.0, 120.0)}
"""Stiffnesses that are drawn, by joint [N m/rad]."""


def main(arguments: list[str]) -> None:
    """Simulate, evaluate, say, and only then compare."""
    seed, overrides = by_lot(arguments)
    config = load_config(CONFIG, [f"seed={seed}", *overrides])
    config = config.model_copy(update={"out": config.out / str(seed)})
    print(f"Seed {seed} (`scripts/demo --device {seed}` repeats it). Simulating ...", flush=True)
    recordings = record(config)
    print("Identifying and evaluating from the files alone ...", flush=True)
    found = evaluate(blind(config, recordings))
    page = found.config.out / "evaluation.html"
    print("\n".join([*verdict(found), *compared(found, recordings.parent / "truth"), f"Report: {page}"]))


def draw_device(seed: int) -> dict:
    """A device by lot as its sheet would be if somebody knew it: a joint, stiffness, masses; sometimes nothing."""
    rng = np.random.default_rng((seed, 3))
    joint = str(rng.choice(list(JOINTS)))
    proximal, distal = JOINTS[joint]
    stiffness = 0.0 if rng.random() < 0.2 else round(float(rng.uniform(*RANGES[joint])), 1)
    own = {"pelvis": "pelvis"}
    sides = [{"segment": own.get(part, f"{part}_{s}"), "name": f"{part}_{s}",
              "mass_kg": round(float(rng.uniform(0.2, 0.9)), 2), "com_m": [0.0, 0.05 if s == "l" else -0.05, -0.1]}
             for part in dict.fromkeys((proximal, distal)) for s in "lr"]  # fmt: skip
    springs = [{"type": "spring", "name": f"{joint}_{s}", "coordinate": f"{joint}_{s}_flexion",
                "between": [own.get(proximal, f"{proximal}_{s}"), f"{distal}_{s}"], "stiffness_Nm_rad": stiffness,
                "rest_rad": 0.0, "sensor": {"torque": f"{joint}_{s}"}} for s in "lr"]  # fmt: skip
    return {"name": f"springs over both {joint}s", "parts": sides, "elements": springs}


def blinded(sheet: dict) -> dict:
    """The sheet as the evaluation gets it: masses, stiffness and rest unknown, sensors listed.

    The zero of a joint's angle is a convention of the model, so that no sheet knows where a spring rests in it.
    """
    parts = [part | {"mass_kg": "unknown"} for part in sheet["parts"]]
    return sheet | {
        "parts": parts,
        "elements": [one | {"stiffness_Nm_rad": "unknown", "rest_rad": "unknown"} for one in sheet["elements"]],
    }


def record(config: Config) -> Path:
    """Simulate the session with the drawn device; its true sheet stands with the truth, a blinded one beside."""
    assert config.simulate is not None
    sheet = draw_device(config.seed)
    with OutputFolder(config.out / "recordings") as folder:
        true = write_sheet(folder.staging / "truth" / "device.yaml", sheet)
        write_sheet(folder.staging / "device.yaml", blinded(sheet))
        simulate_conditions(config.simulate, config.seed, {"without": None, "on": true}, folder.staging)
    return config.out / "recordings" / "config.yaml"


def write_sheet(path: Path, sheet: dict) -> Device:
    """A device's YAML, and the device that it says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(sheet, sort_keys=False))
    return load_device(path)


def blind(config: Config, recordings: Path) -> Config:
    """What the evaluation may know: the recordings, the blinded sheet and the options."""
    made = load_config(recordings)
    conditions = {
        name: replace(own, device=None if own.reference else recordings.parent / "device.yaml")
        for name, own in made.conditions.items()
    }
    return config.model_copy(
        update={"subject": made.subject, "trials": made.trials, "markers": made.markers, "simulate": None,
                "conditions": conditions}
    )  # fmt: skip


def verdict(found: Evaluation) -> list[str]:
    """Findings and the device's parameters in plain lines."""
    one = found.identified.comparisons[0]
    differing = f"{len(one.found(found.level))} of {len(one.columns)} measures"
    lines = [f"Found: {differing} and {len(one.found_courses(found.level))} of {len(one.courses)} courses differ."]
    for key, said in found.worn["on"].parameters.items():
        if key.endswith(("stiffness_Nm_rad", "mass_kg")):
            value = f"{said['value']:.2f} (sd {said['sd']:.2f})" if "value" in said else f"unknown: {said['why']}"
            lines.append(f"  {key}: {value}")
    return lines


def compared(found: Evaluation, truth: Path) -> list[str]:
    """True differences of the peak torques beside those of both bodies."""
    true = {trial.name: np.load(truth / f"{trial.name}_shares.npz")["human"] for trial in found.trials}
    rows = {}
    for name, row in zip(found.layout.names, found.layout.rows, strict=True):
        means: dict[str, list[float]] = {}
        for trial in found.trials:
            cycles = [c for c in found.cycles if c.trial == trial.name]
            tau = torch.as_tensor(true[trial.name][:, row : row + 1])
            each = [float(measure(("peak_torque_Nm",), c, tau, tau, tau, 0.01)) for c in cycles]
            if each:
                means.setdefault(trial.condition, []).append(float(np.mean(each)))
        rows[name] = float(np.mean(means["on"]) - np.mean(means["without"]))
    device = yaml.safe_load((truth / "device.yaml").read_text())
    total = sum(part["mass_kg"] for part in device["parts"])
    lines = [f"Truth: {device['name']}, {device['elements'][0]['stiffness_Nm_rad']} N m/rad, {total:.2f} kg.",
             "Change of the peak torque [N m]: identified (95 %), scaled template, truth"]  # fmt: skip
    one, plain = found.identified.comparisons[0], found.template.comparisons[0]
    for k, column in enumerate(one.columns):
        if column.measure == "peak_torque_Nm":
            value, low, high = (float(getattr(one.difference, n)[k]) for n in ("value", "low", "high"))
            inside = "inside" if low <= rows[column.where] <= high else "OUTSIDE"
            template = float(plain.difference.value[k])
            lines.append(f"  {column.where:16s} {value:7.1f} ({low:.1f} to {high:.1f}), {template:7.1f}, "
                         f"{rows[column.where]:7.1f} {'' if math.isnan(low) else inside}")  # fmt: skip
    return lines


if __name__ == "__main__":
    main(sys.argv[1:])
