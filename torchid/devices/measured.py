"""What a device's own sensor says of an element, beside where the trial shows the element to be."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.devices.base_columns import Acting, acting
from torchid.devices.device import Element
from torchid.devices.forces import smoothed
from torchid.devices.laws import Channels, command
from torchid.devices.supports import Recorded
from torchid.dynamics.rows import WrenchTrial


@dataclass(frozen=True)
class MeasuredElement:
    """An element, where its trial shows it, and what its sensor says at the same frames."""

    acting: Acting
    raw: Float[Tensor, " frames"]
    """Of the sensor, as recorded."""
    force: Float[Tensor, " frames"]
    """The same through the motion's filter."""
    own_length: bool
    """Whether the length is the device's own measurement rather than the markers'."""
    known: Bool[Tensor, " frames"]
    """Frames in which everything was recorded that the law is held against; the others count for nothing."""

    @property
    def read(self) -> Float[Tensor, " known"]:
        """Return the filtered force in the known frames."""
        return self.force[self.known]

    @property
    def length(self) -> Float[Tensor, " known"]:
        """Return length [m] or angle [rad] in the known frames."""
        return self.acting.act.length[self.known]

    def left(self, force: Float[Tensor, " frames"]) -> Float[Tensor, " known"]:
        """Return the read force less another in the known frames, 0 where a late command is not known.

        Args:
            force: of a law, in all frames.
        """
        return torch.nan_to_num(self.force - force)[self.known]


def measured_by(element: Element, trials: Sequence[WrenchTrial], recorded: Recorded) -> list[MeasuredElement]:
    """Return an element in every trial in which its sensor of force was recorded.

    Args:
        element: with a line of its own.

    Raises:
        ConfigError: ``device.segment`` or ``device.coordinate``.
    """
    found = []
    for trial in trials:
        channels = recorded.get(trial.name, {})
        if element.sensor.force and element.sensor.force in channels:
            one = _measured(element, trial, channels)
            found += [one] if bool(one.known.any()) else []
    return found


def _measured(element: Element, trial: WrenchTrial, channels: Channels) -> MeasuredElement:
    """An element in one trial with what its sensors say, in the frames in which they and its command do."""
    one, sensor = acting(element, trial, channels), element.sensor
    own, length = bool(sensor.length) and sensor.length in channels, one.act.length
    raw = channels[sensor.force].to(length)
    known = torch.isfinite(raw)
    if own:
        course = channels[sensor.length].to(length)
        known = known & torch.isfinite(course)
        course = smoothed(course + (length - course).nanmean(), trial.motion)
        one = replace(one, act=replace(one.act, length=course))
    if element.drive is not None:
        wanted = command(element.drive, element, one.act.length, trial.motion.time, one.recorded)
        known = known & torch.isfinite(wanted)
    return MeasuredElement(one, raw, smoothed(raw, trial.motion), own, known)
