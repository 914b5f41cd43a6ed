"""What a condition's device adds to the body, and what it does to it in every trial: the one place that asks it."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.config.conditions import Condition
from torchid.config.sections import TrialFile
from torchid.devices import (
    BodyBelief,
    Determined,
    Device,
    SheetFinding,
    device_draws,
    device_findings,
    device_forces,
    identify_device,
    load_device,
    placed,
    read_channels,
    tells,
    told_of,
)
from torchid.devices.parts import parts_prior
from torchid.devices.result import parts_draws
from torchid.dynamics.equations_of_motion import dynamic_state, generalised_forces, wrench_about
from torchid.dynamics.rows import WrenchTrial
from torchid.errors import DataError, InputError
from torchid.evaluation.trials import ConditionTrial
from torchid.model.model import Geometry
from torchid.model.pseudo import com
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.session import Outcome

log = logging.getLogger(__name__)
CHUNK = 2048
"""Choice. Frames whose equations of motion are held at a time, for memory."""


@dataclass(frozen=True)
class Worn:
    """A condition's device as it is used: nothing at all where none is worn."""

    device: Device | None
    """With every number that its forces need, or a sensor that reads them; other elements are left out of it."""
    parameters: dict[str, dict] = field(default_factory=dict)
    """What was found of its unknowns, by key: value and sd, or why it cannot be determined."""
    findings: tuple[SheetFinding, ...] = ()
    """Its sheet against what the recordings tell."""
    left_out: tuple[str, ...] = ()
    """Elements whose forces nobody knows."""
    read: tuple[str, ...] = ()
    """Elements whose force a sensor reads in some trial, which is their share there."""
    parts: Float[Tensor, "bodies 10"] | None = None
    """What its parts add to the bodies' inertial parameters, where it was identified; None: as its sheet says."""
    draws: tuple[Device, ...] = ()
    """The device with other numbers that the recordings allow."""
    parts_draws: Float[Tensor, "draws bodies 10"] | None = None


@dataclass(frozen=True)
class DeviceAction:
    """What a device does in one trial."""

    torque: Float[Tensor, "frames dofs"]
    """Its share of the generalised forces, grounded supports included, in the sense of q [N m]."""
    power: Float[Tensor, " frames"]
    """On the body [W]."""


def worn_devices(config: Config) -> dict[str, Device | None]:
    """The device of every condition, None where none is worn.

    Raises:
        ConfigError: a device's file or name is at fault.
    """
    return {
        name: None if condition.device is None else load_device(condition.device)
        for name, condition in config.conditions.items()
    }


def identified_devices(
    devices: Mapping[str, Device | None],
    outcome: Outcome,
    trials: Sequence[ConditionTrial],
    recorded: Mapping[str, dict[str, Tensor]],
    draws: int = 0,
    seed: int = 0,
) -> dict[str, Worn]:
    """The devices with their unknowns found from the trials in which they were worn, with the identified body.

    Args:
        recorded: channels of the devices, of every trial.
        draws: number of other devices that are drawn.

    Raises:
        ConfigError: ``device.*``.
    """
    found = {}
    for name, device in devices.items():
        rows = [t.followed.wrench for t in trials if t.condition == name]
        own = None if device is None else placed(device, outcome.fit.places)
        heard = {t.name: recorded[t.name] for t in trials if t.condition == name}
        chance = draws, seed
        found[name] = Worn(None) if own is None else _identified(own, outcome, [r for r in rows if r], heard, chance)
    return found


def _identified(
    device: Device,
    outcome: Outcome,
    rows: Sequence[WrenchTrial],
    recorded: Mapping[str, dict[str, Tensor]],
    chance: tuple[int, int],
) -> Worn:
    """A device as the trials with it tell; as its sheet says where they cannot."""
    if outcome.identified is None or not rows:
        return _usable(device, recorded)
    body = BodyBelief(outcome.phi, outcome.identified.of_rows)
    try:
        told = identify_device(device, body, rows, recorded)
        findings = device_findings(device, body, rows, recorded)
    except DataError as error:
        log.info("%s", error)
        return _usable(device, recorded)
    parameters = {
        key: asdict(one) | {"unit": key.rpartition(".")[2]} if isinstance(one, Determined) else {"why": one.why}
        for key, one in told.parameters.items()
    }
    return replace(
        _usable(told.device, recorded), parameters=parameters, findings=findings, parts=told.phi_on - told.body.phi,
        draws=tuple(told_of(one, recorded.values()) for one in device_draws(told, *chance)),
        parts_draws=parts_draws(told, *chance),
    )  # fmt: skip


def _usable(device: Device, recorded: Mapping[str, dict[str, Tensor]]) -> Worn:
    """A device without the elements that nobody knows the force of."""
    known = told_of(device, recorded.values())
    kept = {element.name for element in known.elements}
    heard = {name for trial in recorded.values() for name, values in trial.items() if tells(values)}
    return Worn(
        known,
        left_out=tuple(one.name for one in device.elements if one.name not in kept),
        read=tuple(one.name for one in known.elements if one.sensor.force in heard),
    )


def carried(worn: Worn, tree: Tree, phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 10"]:
    """Inertial parameters of the body with a device's parts on it.

    Args:
        phi: of the body alone.
    """
    if worn.parts is not None:
        return phi + worn.parts
    if worn.device is None or not worn.device.parts:
        return phi
    parts = parts_prior(worn.device, tree, com(phi))
    return phi.index_add(0, torch.tensor(parts.body, dtype=torch.long, device=phi.device), parts.mean)


def channels_of(
    trial: ConditionTrial, file: TrialFile, condition: Condition
) -> dict[str, Float[Tensor, " frames"]]:  # fmt: skip
    """What a device recorded in a trial, on its frames: the trial's file of channels, else analogs of its C3D.

    Args:
        trial: whose time counts.
        condition: names of the columns.

    Raises:
        InputError: the file is at fault, or lacks a column.
    """
    path: Path | None = file.channels or (file.file if file.file.suffix.lower() == ".c3d" else None)
    if condition.device is None or path is None:
        return {}
    found = read_channels(path, trial.followed.motion.time)
    for name, column in condition.channels.items():
        if column not in found:
            raise InputError(
                "evaluate.channel", "a column of channels is missing", source=path, place=column,
                found=", ".join(found)[:200], remedy="Correct channels: of the condition, or export the column",
            )  # fmt: skip
        found[name] = found[column]
    return found


def acting(worn: Worn, tree: Tree, geometry: Geometry, motion: Motion, recorded: dict[str, Tensor]) -> DeviceAction:
    """What a device does in one trial.

    Raises:
        ConfigError: ``device.unknown``, ``device.channel``, ``device.segment`` or ``device.coordinate``.
    """
    if worn.device is None:
        return DeviceAction(torch.zeros_like(motion.q), torch.zeros_like(motion.time))
    found = device_forces(worn.device, tree, geometry, motion, recorded)
    return DeviceAction(found.torque + supported(tree, geometry, motion, found.external), found.power)


def supported(
    tree: Tree, geometry: Geometry, motion: Motion, external: dict[str, Float[Tensor, "frames 6"]]
) -> Float[Tensor, "frames dofs"]:
    """Generalised forces of wrenches from the ground on segments.

    Args:
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
