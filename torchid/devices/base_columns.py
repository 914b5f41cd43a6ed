"""What the base rows of the equations of motion see of an element: the wrench that it brings from outside the body.

The six base rows sum the wrenches on all segments. Two opposite forces inside the body leave nothing of them, whatever
element makes them; a support from the ground leaves its whole wrench. Which of the two an element is, is computed from
its columns and not looked up by its type.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.devices.action import ElementAction, action
from torchid.devices.device import Device, Element, Handle, SheetValue
from torchid.devices.forces import CHUNK, device_forces, element_force, filtered, states
from torchid.devices.laws import Channels
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import WrenchTrial

INNER = 1e-9
"""Base rows relative to joint rows below which an element acts inside the body, derived: rounding leaves 1e-15, and a
support from the ground about one."""
LINES = ("length", "jacobian", "unit")
"""Fields of an ``ElementAction`` that run over frames."""
STEP = 1e-4
"""Step of a derivative with respect to a parameter relative to its scale, chosen between rounding and curvature; laws
are piecewise linear in theirs."""
SCALE = {"stiffness": 100.0, "rest": 0.1, "preload": 10.0, "free_play": 0.01, "damping": 10.0, "gain": 1.0, "lag": 0.05}
"""Typical size of each parameter [SI], by which steps are scaled; chosen, decides nothing."""


@dataclass(frozen=True)
class Acting:
    """An element over all frames of a trial."""

    element: Element
    act: ElementAction
    trial: WrenchTrial
    recorded: Channels

    def force(self, numbers: dict[str, SheetValue]) -> Float[Tensor, " frames"]:
        """Return its force with some of its parameters replaced.

        Args:
            numbers: by name; they and those of the element that stay are known.
        """
        motion, element = self.trial.motion, self.element.with_numbers(numbers)
        return element_force(element, self.act, motion.v.T, motion.time, self.recorded)

    def slopes(self, numbers: dict[str, SheetValue], names: tuple[str, ...]) -> Float[Tensor, "params frames"]:
        """Return the derivative of its force with respect to some parameters, by central differences.

        Args:
            numbers: where the derivative is taken.
        """
        found = []
        for name in names:
            h = STEP * SCALE[name]
            ends = [self.force({**numbers, name: SheetValue(numbers[name].value + side * h)}) for side in (1.0, -1.0)]
            found.append((ends[0] - ends[1]) / (2.0 * h))
        return torch.stack(found)


def acting(element: Element, trial: WrenchTrial, recorded: Channels) -> Acting:
    """Return an element over all frames of a trial.

    Args:
        element: not a support with recorded forces.
        trial: whose motion it follows.

    Raises:
        ConfigError: ``device.segment`` or ``device.coordinate``.
    """
    motion, parts = trial.motion, []
    for start in range(0, len(motion.q), CHUNK):
        part = slice(start, start + CHUNK)
        parts.append(action(element, states(trial.tree, trial.geometry, motion, part), motion.q[part].T))
    length, jacobian, unit = (torch.cat([getattr(one, key) for one in parts], -1) for key in LINES)
    ground = {name: torch.cat([one.ground[name] for one in parts], 1) for name in parts[0].ground}
    return Acting(element, ElementAction(length, jacobian, unit, ground), trial, filtered([element], recorded, motion))


def seen_share(one: Acting) -> float:
    """Return the size of an element's unit force in the base rows relative to all rows, 0 to 1.

    Args:
        one: an element over a trial; moments count at one metre.
    """
    total = float(one.act.unit.norm())
    return float(one.act.unit[:6].norm()) / total if total else 0.0


def known_external(device: Device, trial: WrenchTrial, recorded: Channels) -> Float[Tensor, "frames 6"]:
    """Return the wrench of the grounded supports whose numbers are all known, about the world's origin.

    It is NaN in frames in which a support's channel was not recorded.

    Args:
        device: whose other elements are left out.
        trial: with the motion.
    """
    own = tuple(one for one in device.elements if one.grounded and not one.unknown)
    total = torch.zeros_like(trial.wrench)
    if not own:
        return total
    few = Device(device.name, elements=own)
    for wrench in device_forces(few, trial.tree, trial.geometry, trial.motion, recorded).external.values():
        total = total + wrench
    return total


def heard(trial: WrenchTrial, support: Float[Tensor, "frames 6"]) -> WrenchTrial:
    """Return a trial without the frames in which nobody knows what supports carried.

    Args:
        support: its wrench, NaN where it was not recorded.
    """
    return replace(trial, used=trial.used & torch.isfinite(support).all(dim=1))


def about_root(trial: WrenchTrial, wrench: Float[Tensor, "frames 6"]) -> Float[Tensor, "6 frames"]:
    """Return a wrench about the world's origin taken about the root's, as base rows are."""
    return wrench_about(wrench, trial.motion.q[:, :3]).T


def has_line(element: Element) -> bool:
    """Return whether an element has a length or an angle."""
    return not isinstance(element.line, Handle)
