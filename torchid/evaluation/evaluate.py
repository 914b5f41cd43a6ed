"""The sequence of an evaluation: the body, the trials, the shares of torque, the cycles, the comparisons, the files.

The body is identified from the trials without a device. Its run is the run of ``torchid run`` on the same config; what
of it is finished is taken up again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.config import Config
from torchid.config.conditions import EvaluateOptions
from torchid.cycles.cycles import Course, Cycle, find_cycles, outliers
from torchid.devices import Device, refuse_foreign
from torchid.errors import ConfigError, DataError
from torchid.evaluation.cycle_measures.layout import MeasureLayout, make_layout
from torchid.evaluation.cycle_measures.rows import CycleRows, RowScene, cycle_rows, joined
from torchid.evaluation.evaluation import Evaluation, corrections_of
from torchid.evaluation.gaps import find_gaps
from torchid.evaluation.simulation import with_conditions
from torchid.evaluation.statistics.answers import BodyAnswer, answer
from torchid.evaluation.torque_shares.back import lever_arms
from torchid.evaluation.torque_shares.contacts import FeetWrenches, count_contacts, feet_of, refuse_twice
from torchid.evaluation.torque_shares.draws import device_deviations, torque_deviations
from torchid.evaluation.torque_shares.shares import shares
from torchid.evaluation.torque_shares.wearing import Worn, channels_of, identified_devices, worn_devices
from torchid.evaluation.trials import ConditionTrial, condition_trials, refuse_faulty, refuse_still
from torchid.evaluation.write import file_names, write_evaluation
from torchid.geometry.result import GeometryFit
from torchid.run.sequence import run_experiment
from torchid.session import Outcome
from torchid.session.fitting import OnStage
from torchid.session.following import soles
from torchid.session.opening import setup_of
from torchid.storage.results import OutputFolder


@dataclass(frozen=True)
class Material:
    """What both bodies' answers are made of."""

    trials: tuple[ConditionTrial, ...]
    cycles: dict[str, tuple[Cycle, ...]]
    layout: MeasureLayout
    worn: dict[str, Worn]
    recorded: dict[str, dict[str, Tensor]]
    """Channels of the device by trial."""
    mass_kg: float | None


def evaluate(config: Config, progress: OnStage = lambda stage, fraction: None) -> Evaluation:
    """Compare the conditions of a config, into its ``out`` folder beside the files of the body's run.

    Args:
        config: with ``conditions`` and trials under them.
        progress: called with stages and the share of each that is done.

    Raises:
        ConfigError: there is nothing to compare, or a device is at fault.
        TorchidError: as of ``run_experiment``.
        DataError: ``evaluate.no_cycles`` where a condition has none.
    """
    refuse_nothing(config)
    devices = worn_devices(config)
    refuse_twice(config, devices)
    _refuse_foreign(config, devices)  # before hours of work
    config = with_conditions(config, devices)
    with OutputFolder(config.out, beside=True) as folder:
        refuse_faulty(config, folder)
    outcome = run_experiment(config, progress)
    with OutputFolder(config.out, beside=True) as folder:
        folder.claim(file_names(config))
        trials = condition_trials(config, outcome, folder, progress)
        progress("evaluation", 0.0)
        material = gather(config, outcome, trials, devices)
        found = judge(config, outcome, material)
        write_evaluation(found, folder)
        progress("evaluation", 1.0)
    return found


def refuse_nothing(config: Config) -> None:
    """Raise ConfigError where a config has no conditions to compare."""
    if len(config.conditions) < 2:
        raise ConfigError(
            "evaluate.no_conditions", "there is nothing to compare", place="conditions",
            found=f"{len(config.conditions)} conditions",
            remedy="List a reference and another condition under conditions:, and give the trials their condition:",
        )  # fmt: skip


def _refuse_foreign(config: Config, devices: Mapping[str, Device | None]) -> None:
    worn = [device for device in devices.values() if device is not None]
    if worn:
        tree = setup_of(config).model.tree
        for device in worn:
            refuse_foreign(device, tree)


def gather(config: Config, outcome: Outcome, trials: tuple[ConditionTrial, ...], devices: dict) -> Material:
    """Cycles, columns, devices and their channels.

    Args:
        devices: by condition, None for none.

    Raises:
        DataError: a condition has no cycle.
        ConfigError: a device is at fault.
    """
    refuse_still(trials)
    cycles = all_cycles(trials, config.evaluate)
    _refuse_cycleless(config, trials, cycles)
    files = {file.name: file for file in config.trials}
    recorded = {t.name: channels_of(t, files[t.name], config.conditions[t.condition]) for t in trials}
    options = config.evaluate
    worn = identified_devices(devices, outcome, trials, recorded, options.draws, config.seed)
    every = [cycle for own in cycles.values() for cycle in own]
    mass = float(outcome.phi[:, 0].sum()) if config.evaluate.per_mass else None
    layout = make_layout(config, outcome.fit.model, every)
    return Material(trials, cycles, layout, worn, recorded, mass)


def all_cycles(trials: Sequence[ConditionTrial], options: EvaluateOptions) -> dict[str, tuple[Cycle, ...]]:
    """Cycles of all trials by name.

    Args:
        options: how cycles are found.
    """
    found = {}
    for trial in trials:
        motion = trial.followed.motion
        course = Course(
            trial.name, motion.time, motion.q, trial.dofs, trial.followed.contact, trial.recording.events
        )  # fmt: skip
        found[trial.name] = find_cycles(course, options)
    return found


def _refuse_cycleless(config: Config, trials: Sequence[ConditionTrial], cycles: dict) -> None:
    for name in config.conditions:
        own = [trial.name for trial in trials if trial.condition == name]
        if not any(cycles[trial] for trial in own):
            raise DataError(
                "evaluate.no_cycles", f"no cycle was found under condition {name}", place=", ".join(own),
                remedy="Look at evaluate.cycles: strides need contacts of the feet, other movements a coordinate that "
                "leaves its rest, or give the intervals",
            )  # fmt: skip


def judge(config: Config, outcome: Outcome, material: Material) -> Evaluation:
    """Both bodies' answers, and what cannot be answered.

    Args:
        material: from ``gather``.
    """
    options, trials = config.evaluate, material.trials
    bodies = (outcome.fit, outcome.phi, False), (outcome.scaled, outcome.prior_scaled.mean, True)
    feet, plain_feet = (
        feet_of(config, trials, fit, phi, scaled, material.worn, material.recorded) for fit, phi, scaled in bodies
    )
    deviations = torque_deviations(outcome, trials, feet, options.draws, config.seed)
    known = _rows(config, *bodies[0], material, feet, deviations)
    plain = _rows(config, *bodies[1], material, plain_feet, None)
    cycles = tuple(c for trial in trials for c in material.cycles[trial.name])
    conditions = tuple(trial.condition for trial in trials for _ in material.cycles[trial.name])
    identified, template = (
        answer(config, material.layout, cycles, conditions, joined(rows)) for rows in (known, plain)
    )
    found = Evaluation(
        config, outcome, trials, cycles, conditions, material.layout, identified, template,
        _apart(identified, conditions), material.worn, count_contacts(trials, feet), (), material.mass_kg,
        corrections_of(outcome),
    )  # fmt: skip
    return replace(found, gaps=find_gaps(found))


def _rows(
    config: Config,
    fit: GeometryFit,
    phi: Tensor,
    scaled: bool,
    material: Material,
    feet: FeetWrenches,
    deviations: dict | None,
) -> list[CycleRows]:
    options = config.evaluate
    levers = lever_arms(options.lever_arm_m, options.draws, phi, config.seed)
    found = []
    for trial in material.trials:
        followed = trial.scaled if scaled else trial.followed
        heels = {foot: points[:, 0] for foot, points in soles(fit, followed.tracked).items()}
        middle = 0.5 * sum(options.lever_arm_m)
        scene = RowScene(trial, material.cycles[trial.name], heels, levers, middle, material.mass_kg)
        worn, recorded = material.worn[trial.condition], material.recorded[trial.name]
        own = shares(trial, followed, fit, phi, worn, recorded, feet[trial.name])
        moved = None if deviations is None else deviations[trial.name]
        if moved is not None:
            more = device_deviations(worn, fit.model.tree, fit.geometry, followed.motion, recorded)
            moved = moved if more is None else moved + more
        found.append(cycle_rows(scene, material.layout, own, moved, options.points))
    return found


def _apart(identified: BodyAnswer, conditions: Sequence[str]) -> Tensor:
    """Scores of all cycles, each against those of its condition and side."""
    rows, sides = identified.rows, identified.sample.sides
    score = torch.zeros(len(conditions), dtype=rows.angle.dtype)
    for key in dict.fromkeys(zip(conditions, sides, strict=True)):
        own = [k for k, other in enumerate(zip(conditions, sides, strict=True)) if other == key]
        score[own] = outliers(rows.angle[own])
    return score
