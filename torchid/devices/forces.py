"""What a device does to the body at every frame: generalised forces, wrenches from the ground, power."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.devices.action import ElementAction, action, point_in_world
from torchid.devices.device import Device, Element, Handle
from torchid.devices.laws import Channels, channel, drive_force, law_force
from torchid.dynamics.equations_of_motion import DynamicState, dynamic_state
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion

CHUNK = 2048
"""Frames walked at once, a choice for memory."""


@dataclass(frozen=True)
class ElementCourse:
    """One element over the frames of a motion."""

    force: Float[Tensor, " frames"]
    """Tension [N], positive where it pulls; or torque in the sense of the coordinate [N m]."""
    length: Float[Tensor, " frames"]
    """Length [m] or angle [rad]; NaN of a support with recorded forces."""
    power: Float[Tensor, " frames"]
    """Power on the body [W]."""


@dataclass(frozen=True)
class DeviceForces:
    """What a device does to the body besides being carried."""

    torque: Float[Tensor, "frames dofs"]
    """Generalised force of the elements between segments, in the sense of q; rows 0-5 are zero but for rounding."""
    external: dict[str, Float[Tensor, "frames 6"]]
    """Wrench of grounded supports on segments about the world's origin, in W; none of it is in ``torque``."""
    power: Float[Tensor, " frames"]
    """Power of all elements on the body [W], grounded ones included."""
    elements: dict[str, ElementCourse]


def element_force(
    element: Element,
    act: ElementAction,
    v: Float[Tensor, "dofs frames"],
    time: Float[Tensor, " frames"],
    recorded: Channels,
) -> Float[Tensor, " frames"]:
    """Return the tension or the torque of an element.

    Args:
        element: all of its numbers known.
        act: its line at these frames.
        time: of the frames [s].

    Raises:
        ConfigError: ``device.unknown`` or ``device.channel``.
    """
    force = torch.zeros_like(act.length)
    if element.law is not None:
        # The law resists what x gains: a tension pulls, and a torque is opposed to the coordinate.
        sense = -1.0 if element.turns else 1.0
        force = force + sense * law_force(element.law, element, act.length, act.rate(v))
    if element.drive is not None:
        force = force + drive_force(element.drive, element, act.length, time, recorded)
    return force


def device_forces(
    device: Device, tree: Tree, geometry: Geometry, motion: Motion, recorded: Channels | None = None
) -> DeviceForces:
    """Compute what a device does to the body of a motion.

    The human's own torque is inverse dynamics of the body with the device's parts, minus external wrenches (those of
    plates and ``external``), minus ``torque``.

    Args:
        device: every number that a force needs known.
        motion: q, v, a at marker rate.
        recorded: channels of the device on the motion's frames as recorded, by name; ``phase`` for profiles over
            phase. Commands and forces go through the motion's filter, as everything else has. An element whose sensor
            reads its force carries that, and what its numbers say where the sensor reads nothing (NaN, or zero
            throughout). What a command or a handle does in frames in which it was not recorded is NaN.

    Raises:
        ConfigError: ``device.unknown``, ``device.channel``, ``device.segment`` or ``device.coordinate``.
    """
    recorded, parts = recorded or {}, []
    every = filtered(device.elements, recorded, motion), readings(device.elements, recorded, motion)
    for start in range(0, len(motion.q), CHUNK):
        part = slice(start, start + CHUNK)
        some, read = ({name: values[part] for name, values in one.items()} for one in every)
        parts.append(_some_frames(device, tree, geometry, motion, part, some, read))
    return _joined(parts)


def smoothed(values: Float[Tensor, " frames"], motion: Motion) -> Float[Tensor, " frames"]:
    """Return a channel through the filter of a motion; NaN in frames without a sample, which nothing else is told of.

    Args:
        values: on the motion's frames, NaN where nothing was recorded.
    """
    values = values.to(motion.time)
    known = torch.isfinite(values)
    return torch.where(known, motion.smoother(torch.where(known, values, 0.0), known.to(values)), torch.nan)


def tells(values: Float[Tensor, " frames"]) -> bool:
    """Return whether a sensor reads anything: one that is dead or unplugged reads zero or nothing throughout.

    Args:
        values: as recorded, NaN where nothing was.
    """
    return bool((torch.isfinite(values) & (values != 0.0)).any())


def filtered(elements: Iterable[Element], recorded: Channels, motion: Motion) -> Channels:
    """Return recorded channels, those that are forces through the filter of the motion; NaN where nothing was recorded.

    Args:
        elements: whose commands and handles are forces.
        recorded: channels on the motion's frames, by name.
    """
    names = {one.drive.channel for one in elements if one.drive is not None}
    names |= {name for one in elements if isinstance(one.line, Handle) for name in one.line.channels}
    return {name: smoothed(values, motion) if name in names else values for name, values in recorded.items()}


def readings(elements: Iterable[Element], recorded: Channels, motion: Motion) -> dict[str, Float[Tensor, " frames"]]:
    """Return what sensors read of elements' forces, through the filter of the motion; NaN where they read nothing.

    Args:
        recorded: channels on the motion's frames, by name.

    Returns:
        Channels of sensors that tell anything (``tells``), by name.
    """
    names = {one.sensor.force for one in elements} & recorded.keys()
    return {name: smoothed(recorded[name], motion) for name in names if tells(recorded[name])}


def told_of(device: Device, trials: Iterable[Channels]) -> Device:
    """Return the device without the elements that nobody knows the force of: a number is unknown, no sensor reads.

    Args:
        device: with or without unknown numbers.
        trials: what was recorded in every trial that it was worn in. A sensor that stands for unknown numbers must tell
            something in each of them (``tells``), and have read in all of its frames.
    """
    trials = list(trials)

    def read(element: Element) -> bool:
        found = [trial.get(element.sensor.force) for trial in trials]
        return bool(trials) and all(x is not None and bool(torch.isfinite(x).all()) and tells(x) for x in found)

    return replace(device, elements=tuple(one for one in device.elements if not one.unknown or read(one)))


def carried_force(
    element: Element, act: ElementAction, v: Float[Tensor, "dofs frames"], time: Float[Tensor, " frames"],
    recorded: Channels,
    read: Channels,
) -> Float[Tensor, " frames"]:  # fmt: skip
    """Return what an element carries: what its sensor reads, else what its numbers say; see ``element_force``."""
    reading = read.get(element.sensor.force)
    if reading is None:
        return element_force(element, act, v, time, recorded)
    silent = torch.isnan(reading)
    return torch.where(silent, element_force(element, act, v, time, recorded), reading) if silent.any() else reading


def states(tree: Tree, geometry: Geometry, motion: Motion, part: slice) -> DynamicState:
    """Return poses and rates of some frames of a motion."""
    return dynamic_state(tree, geometry, *(x[part].T.contiguous() for x in (motion.q, motion.v, motion.a)))


def _some_frames(
    device: Device, tree: Tree, geometry: Geometry, motion: Motion, part: slice, recorded: Channels, read: Channels
) -> DeviceForces:
    state, time = states(tree, geometry, motion, part), motion.time[part]
    q, v = motion.q[part].T, motion.v[part].T
    torque, power = torch.zeros_like(v), torch.zeros_like(time)
    external: dict[str, Tensor] = {}
    courses = {}
    for element in device.elements:
        if isinstance(element.line, Handle):
            wrench, course = _held(element, element.line, state, v, recorded)
            _add(external, element.line.point.segment, wrench.T)
        else:
            act = action(element, state, q)
            force = carried_force(element, act, v, time, recorded, read)
            work = act.unit * force
            course = ElementCourse(force, act.length, (work * v).sum(0))
            for segment, unit in act.ground.items():
                _add(external, segment, (unit * force).T)
            torque = torque if act.ground else torque + work
        courses[element.name] = course
        power = power + course.power
    return DeviceForces(torque.T, external, power, courses)


def _add(external: dict[str, Tensor], segment: str, wrench: Float[Tensor, "frames 6"]) -> None:
    external[segment] = external[segment] + wrench if segment in external else wrench


def _held(
    element: Element, line: Handle, state: DynamicState, v: Tensor, recorded: Channels
) -> tuple[Float[Tensor, "6 frames"], ElementCourse]:
    """Wrench of a support with recorded forces about the world's origin, and its power on the body."""
    force = torch.stack([channel(recorded, name, element.name).to(v) for name in line.channels])
    at = point_in_world(line.point, state, element.name)
    k = state.plan.position[state.plan.tree.index(line.point.segment)]
    speed = state.motion.v[k] + torch.linalg.cross(state.motion.w[k], at - state.at.p[k], dim=0)
    size = torch.linalg.vector_norm(force, dim=0)
    wrench = torch.cat([force, torch.linalg.cross(at, force, dim=0)])
    return wrench, ElementCourse(size, torch.full_like(size, torch.nan), (force * speed).sum(0))


def _joined(parts: list[DeviceForces]) -> DeviceForces:
    first = parts[0]
    courses = {
        name: ElementCourse(*(torch.cat([getattr(p.elements[name], key) for p in parts])
                              for key in ("force", "length", "power")))
        for name in first.elements
    }  # fmt: skip
    external = {name: torch.cat([p.external[name] for p in parts]) for name in first.external}
    return DeviceForces(torch.cat([p.torque for p in parts]), external, torch.cat([p.power for p in parts]), courses)
