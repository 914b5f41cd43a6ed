#!/usr/bin/env python
"""Evaluate a device with every step in sight: body, trials, device, shares of torque, cycles, permutations.

    python scripts/evaluate_device.py --config configs/evaluate_simulated.yaml --joint hip_l_flexion

Prints what each step knows; writes the files of ``torchid evaluate`` into the config's folder.
"""

import argparse
from dataclasses import replace

import torch

from torchid.config import load_config
from torchid.cycles.cycles import normalise
from torchid.cycles.measures import measure, unit_of
from torchid.evaluation.evaluate import gather, judge
from torchid.evaluation.simulation import with_conditions
from torchid.evaluation.statistics.comparing import Sample, compare
from torchid.evaluation.torque_shares.contacts import feet_of
from torchid.evaluation.torque_shares.shares import shares
from torchid.evaluation.torque_shares.wearing import worn_devices
from torchid.evaluation.trials import condition_trials
from torchid.evaluation.write import write_evaluation
from torchid.run import run_experiment
from torchid.storage.results import OutputFolder


def quiet(stage: str, fraction: float) -> None:
    del stage, fraction


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", required=True)
    parser.add_argument("--joint", default="hip_l_flexion")
    parser.add_argument("overrides", nargs="*", help="key=value")
    args = parser.parse_args(argv)

    # 1. The body, from the trials without a device (a finished run is taken up again).
    config = load_config(args.config, args.overrides)
    devices = worn_devices(config)
    config = with_conditions(config, devices)
    outcome = run_experiment(config)
    fit, tree = outcome.fit, outcome.fit.model.tree
    print(f"body: {float(outcome.phi[:, 0].sum()):.2f} kg from {len(outcome.session.trials)} trials")

    # 2. Trials with the device are followed by that body; cycles, channels, and what is unknown of the device.
    with OutputFolder(config.out, beside=True) as folder:
        trials = condition_trials(config, outcome, folder, quiet)
        material = gather(config, outcome, trials, devices)
        for condition, worn in material.worn.items():
            print(f"{condition}: {worn.parameters or 'nothing to identify'}")

        # 3. demand = ID(phi + parts) - J' F of the plates; human = demand - device, for one coordinate.
        row, rows, names, labels = tree.dof_names.index(args.joint), [], [], []
        feet = feet_of(config, trials, fit, outcome.phi, False, material.worn, material.recorded)
        for trial in trials:
            worn, recorded = material.worn[trial.condition], material.recorded[trial.name]
            own = shares(trial, trial.followed, fit, outcome.phi, worn, recorded, feet[trial.name])
            human, step = own.human[:, row : row + 1], float(trial.followed.motion.time[1])
            for cycle in material.cycles[trial.name]:
                q, v = own.q[:, row : row + 1], own.v[:, row : row + 1]
                rows.append(measure(config.evaluate.measures, cycle, human, v, q, step)[0])
                names.append(trial.name)
                labels.append(trial.condition)
            curve = torch.stack([normalise(human, c, 5)[:, 0] for c in material.cycles[trial.name]]).mean(0)
            print(f"{trial.name}: {args.joint} at 0, 25 ... 100 %: {[round(x, 1) for x in curve.tolist()]} N m")

        # 4. Labels of trials are exchanged in all ways; the largest statistic of all measures adjusts every p.
        columns = tuple(c for c in material.layout.columns if c.where == args.joint)
        sample = Sample(tuple(names), tuple(labels), columns, torch.stack(rows))
        reference = next(name for name, one in config.conditions.items() if one.reference)
        for other in (name for name in config.conditions if name != reference):
            found = compare(sample, reference, other, replace(config.evaluate), config.seed)
            for k, column in enumerate(found.columns):
                value, low, high = (float(getattr(found.difference, n)[k]) for n in ("value", "low", "high"))
                print(f"{other}: {column.measure:22s} {value:8.2f} ({low:.2f} to {high:.2f}) {unit_of(column.measure)} "
                      f"p {float(found.tested.p[k]):.4f}, adjusted {float(found.tested.adjusted[k]):.4f}")  # fmt: skip

        # 5. The same for all coordinates, bands and the scaled template: what `torchid evaluate` writes.
        write_evaluation(judge(config, outcome, material), folder)
    print(f"report: {config.out / 'evaluation.html'}")


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
