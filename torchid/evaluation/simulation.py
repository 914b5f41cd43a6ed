"""Synthetic sessions with conditions: a person who moves with nothing and with devices on, recorded as C3D.

The device's parts are carried, so that plates feel them. What its elements do between segments changes neither the
prescribed motion nor what plates read: it is the torque that the person need not supply.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config, load_config
from torchid.devices import Device, device_forces
from torchid.evaluation.torque_shares.wearing import Worn, carried
from torchid.run.simulation import RECORDINGS
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import TRUTH, SimulatedSession, session_config, simulate_session, write_session
from torchid.simulate.subject import SimulatedSubject
from torchid.simulate.trial import SimulatedTrial, simulate_trial
from torchid.storage.files import atomic_write, write_text
from torchid.storage.results import OutputFolder
from torchid.torque.inverse import Load, joint_torques

SENSOR_SD = 0.01
"""Choice. Noise of a device's sensor, part of its largest reading."""


def simulate_conditions(
    options: SimulateOptions, seed: int, devices: Mapping[str, Device | None], out: Path
) -> SimulatedSession:  # fmt: skip
    """Simulate a session and, under every condition, the motions of ``options.conditions``; write it into a folder.

    Args:
        devices: as they are, every number known; by condition, None for none.
        out: folder for C3D files, channels as CSV, ``config.yaml`` with a condition of every trial, and ``truth/``.

    Returns:
        The session, trials of conditions last, called ``CONDITION_MOTION_NUMBER``.

    Raises:
        ConfigError: as of ``simulate_session``, or ``device.*``.
    """
    base = simulate_session(options, seed)
    own: dict[str, str] = {}
    worn_trials = []
    for condition, device in devices.items():
        person = wearing(base.subject, device)
        for k, motion in enumerate(options.conditions):
            name = f"{condition}_{motion}_{k + 1}"
            own[name] = condition
            worn_trials.append(simulate_trial(person, motion, options, seed, name=name))
    session = SimulatedSession(base.subject, (*base.trials, *worn_trials))
    written = write_session(session, options, out)
    rng = np.random.default_rng((seed, 35))
    entries: list[dict[str, Any]] = []
    for item, entry in zip(session.trials, session_config(session)["trials"], strict=True):  # type: ignore[arg-type]
        condition = own.get(item.trial.name)
        device = devices.get(condition or "")
        channels = None if device is None else _channels(base.subject, item, device, rng)
        if condition is not None:
            _write_truth(out / TRUTH / f"{item.trial.name}_shares.npz", base.subject, item, device)
        if channels is not None and len(channels) > 1:
            _write_channels(out / f"{item.trial.name}.csv", channels)
            entry |= {"channels": f"{item.trial.name}.csv"}
        entries.append(entry | ({} if condition is None else {"condition": condition}))
    listed = session_config(session) | {"trials": entries, "conditions": _conditions(devices)}
    write_text(out / "config.yaml", yaml.safe_dump(listed, sort_keys=False))
    return written


def _conditions(devices: Mapping[str, Device | None]) -> dict[str, dict]:
    """Conditions as the config of the recordings lists them; whoever evaluates says what was worn."""
    return {name: {"reference": k == 0} for k, name in enumerate(devices)}


def with_conditions(config: Config, devices: Mapping[str, Device | None]) -> Config:
    """The config with a simulated session in place of ``simulate:``, where it lists no trials.

    Args:
        config: of an evaluation.

    Raises:
        ConfigError: as of ``simulate_conditions``.
    """
    if config.trials or config.simulate is None:
        return config.model_copy(update={"simulate": None})
    with OutputFolder(config.out / RECORDINGS) as folder:
        simulate_conditions(config.simulate, config.seed, devices, folder.staging)
    made = load_config(config.out / RECORDINGS / "config.yaml")
    found = {"subject": made.subject, "trials": made.trials, "markers": made.markers}
    return config.model_copy(update={**found, "simulate": None})


def wearing(subject: SimulatedSubject, device: Device | None) -> SimulatedSubject:
    """The person with a device's parts on.

    Args:
        subject: without them.
        device: every number known.
    """
    return replace(subject, phi=carried(Worn(device), subject.model.tree, subject.phi))


def true_shares(
    subject: SimulatedSubject, item: SimulatedTrial, device: Device | None
) -> tuple[Float[Tensor, "frames dofs"], Float[Tensor, "frames dofs"]]:
    """What the person and the device supply in a simulated trial [N m].

    Args:
        subject: without the device.
        item: the trial with its truth.
    """
    tree, motion = subject.model.tree, item.truth.motion
    feet = [Load(f"foot_{side}", item.truth.feet.wrench[:, k]) for k, side in enumerate("lr")]
    demand = joint_torques(tree, subject.geometry, wearing(subject, device).phi, motion, feet)
    if device is None:
        return demand, torch.zeros_like(demand)
    taken = device_forces(device, tree, subject.geometry, motion).torque
    return demand - taken, taken


def _write_truth(path: Path, subject: SimulatedSubject, item: SimulatedTrial, device: Device | None) -> None:
    human, taken = true_shares(subject, item, device)
    with atomic_write(path) as file:
        np.savez_compressed(file, human=human.numpy(), device=taken.numpy(), time=item.truth.motion.time.numpy())


def _channels(
    subject: SimulatedSubject, item: SimulatedTrial, device: Device, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """What sensors of the device read, noise included."""
    motion = item.truth.motion
    found = device_forces(device, subject.model.tree, subject.geometry, motion)
    channels = {"time": motion.time.numpy()}
    for element in device.elements:
        course = found.elements[element.name]
        for channel, values in ((element.sensor.force, course.force), (element.sensor.length, course.length)):
            if channel:
                clean = values.numpy()
                channels[channel] = clean + SENSOR_SD * np.abs(clean).max() * rng.normal(size=len(clean))
    return channels


def _write_channels(path: Path, channels: dict[str, np.ndarray]) -> None:
    rows = np.stack(list(channels.values()), axis=1)
    lines = [",".join(channels), *(",".join(f"{x:.6f}" for x in row) for row in rows)]
    write_text(path, "\n".join(lines) + "\n")
