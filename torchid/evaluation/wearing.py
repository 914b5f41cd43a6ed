"""What a condition's device adds to the body, and what it does to it in every trial: the one place that asks it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.config.conditions import Condition
from torchid.devices import Device, load_device
from torchid.devices.forces import device_forces
from torchid.devices.parts import parts_prior
from torchid.dynamics import dynamic_state, generalised_forces, wrench_about
from torchid.evaluation.channels import read_channels
from torchid.evaluation.trials import ConditionTrial
from torchid.inertia.pseudo import com
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.outcome import Outcome

CHUNK = 2048
"""Choice. Frames whose equations of motion are held at a time, for memory."""


@dataclass(frozen=True)
class Worn:
    """A condition's device as it is used: nothing at all where none is worn."""

    device: Device | None
    """With every number that its forces need."""
    parameters: dict[str, dict] = field(default_factory=dict)
    """What was found of its unknowns, by key: value and sd, or why it cannot be determined."""


@dataclass(frozen=True)
class Action:
    """What a device does in one trial."""

    torque: Float[Tensor, "frames dofs"]
    """Its share of the generalised forces, grounded supports included, in the sense of q [N m]."""
    power: Float[Tensor, " frames"]
    """On the body [W]."""


def worn_devices(config: Config) -> dict[str, Device | None]:
    """The device of every condition, None where none is worn.

    Args:
        config: of the evaluation.

    Raises:
        ConfigError: a device's file or name is at fault.
    """
    return {
        name: None if condition.device is None else load_device(condition.device)
        for name, condition in config.conditions.items()
    }


def with_unknowns(
    devices: dict[str, Device | None],
    outcome: Outcome,
    trials: Sequence[ConditionTrial],
    recorded: dict[str, dict[str, Tensor]],
) -> dict[str, Worn]:
    """The devices with their unknowns found from the trials in which they were worn.

    Args:
        devices: by condition.
        outcome: of the body's run.
        trials: of all conditions.
        recorded: channels of the devices by trial.
    """
    del outcome, trials, recorded
    return {name: Worn(device) for name, device in devices.items()}


def carried(device: Device | None, tree: Tree, phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 10"]:
    """Inertial parameters of the body with a device's parts on it.

    Args:
        device: None for nothing.
        tree: of the model.
        phi: of the body alone.
    """
    if device is None:
        return phi
    parts = parts_prior(device, tree, com(phi))
    return phi.index_add(0, torch.tensor(parts.body, dtype=torch.long, device=phi.device), parts.mean)


def channels_of(
    trial: ConditionTrial, path: Path | None, condition: Condition
) -> dict[str, Float[Tensor, " frames"]]:  # fmt: skip
    """What the device recorded in a trial, on its frames; nothing where the trial has no file.

    Args:
        trial: whose time counts.
        path: of the trial's channels.
        condition: names of the columns.

    Raises:
        InputError: the file is at fault.
    """
    return {} if path is None else read_channels(path, trial.followed.motion.time, condition.channels)


def acting(
    device: Device | None, tree: Tree, geometry: Geometry, motion: Motion, recorded: dict[str, Tensor]
) -> Action:
    """What a device does in one trial.

    Args:
        device: None for nothing.
        tree: of the model.
        geometry: of the subject.
        motion: coordinates with their rates.
        recorded: channels on the motion's frames.

    Raises:
        ConfigError: ``device.unknown``, ``device.channel``, ``device.segment`` or ``device.coordinate``.
    """
    if device is None:
        return Action(torch.zeros_like(motion.q), torch.zeros_like(motion.time))
    found = device_forces(device, tree, geometry, motion, recorded)
    return Action(found.torque + supported(tree, geometry, motion, found.external), found.power)


def supported(
    tree: Tree, geometry: Geometry, motion: Motion, external: dict[str, Float[Tensor, "frames 6"]]
) -> Float[Tensor, "frames dofs"]:
    """Generalised forces of wrenches from the ground on segments.

    Args:
        tree: of the model.
        geometry: of the subject.
        motion: coordinates with their rates.
        external: wrench on each segment about the origin of W [N, N m].
    """
    out = torch.zeros_like(motion.q)
    for start in range(0, len(motion.q) if external else 0, CHUNK):
        part = slice(start, start + CHUNK)
        state = dynamic_state(tree, geometry, *(x[part].T.contiguous() for x in (motion.q, motion.v, motion.a)))
        wrenches = motion.q.new_zeros(len(tree.bodies), 6, len(motion.q[part]))
        for segment, wrench in external.items():
            position = state.plan.position[tree.index(segment)]
            wrenches[position] += wrench_about(wrench[part], motion.q[part, :3]).T
        out[part] = generalised_forces(state, wrenches).T
    return out


def device_sentences(device: Device) -> Sequence[str]:
    """Where a device's numbers come from, for the report.

    Args:
        device: with its sources.
    """
    return device.sources
