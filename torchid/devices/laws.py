"""Force of an element from its length, its rate and its recorded channels."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.devices.device import Drive, Element, Law, Number
from torchid.errors import ConfigError

Channels = dict[str, Tensor]
"""Recorded channels of a device on the frames of a motion, by name, shape (frames,)."""
PHASE = "phase"
"""Channel with the phase of the cycle, 0 to 1, that a profile over phase is read at."""


def known(number: Number, element: Element, parameter: str) -> float:
    """Return a number that a force needs.

    Raises:
        ConfigError: ``device.unknown`` where it is to be identified first.
    """
    if number is None:
        raise ConfigError(
            "device.unknown", "this number is unknown, so what the element does cannot be said",
            place=f"{element.name}.{element.key(parameter)}",
            remedy="Identify the device first (a sensor of the element, or a grounded support), or write the number",
        )  # fmt: skip
    return number.value


def channel(recorded: Channels, name: str, element: str) -> Float[Tensor, " frames"]:
    """Return a recorded channel.

    Raises:
        ConfigError: ``device.channel`` where it was not recorded.
    """
    if name not in recorded:
        raise ConfigError(
            "device.channel", "a channel of the device was not recorded", place=element, found=name,
            remedy=f"Recorded are {', '.join(recorded) or 'no channels'}",
        )  # fmt: skip
    return recorded[name]


def law_force(
    law: Law, element: Element, x: Float[Tensor, " frames"], rate: Float[Tensor, " frames"]
) -> Float[Tensor, " frames"]:
    """Return k e + preload + c rate, e the way beyond rest and free play; see ``device.Law``.

    Args:
        law: all of its numbers known, but for a stiffness that a table replaces.
        x: length [m] or angle [rad].
        rate: of x, per second.

    Raises:
        ConfigError: ``device.unknown``.
    """
    rest, preload, play, damping = (
        known(getattr(law, n), element, n) for n in ("rest", "preload", "free_play", "damping")
    )
    beyond = x - rest
    beyond = torch.sign(beyond) * (beyond.abs() - play).clamp_min(0.0)
    if law.table:
        elastic = preload + interpolated(law.table, beyond)
    else:
        elastic = preload + known(law.stiffness, element, "stiffness") * beyond
    force = elastic + damping * rate
    return torch.where(elastic > 0.0, force.clamp_min(0.0), 0.0) if law.tension_only else force


def interpolated(table: tuple[tuple[float, float], ...], x: Tensor) -> Tensor:
    """Return the piecewise linear function of a table, beyond its ends as straight on as its last pieces.

    Args:
        table: abscissa and value, rising.
    """
    at, value = (x.new_tensor(column) for column in zip(*table, strict=True))
    k = (torch.bucketize(x.contiguous(), at) - 1).clamp(0, len(at) - 2)
    slope = (value[k + 1] - value[k]) / (at[k + 1] - at[k])
    return value[k] + slope * (x - at[k])


def drive_force(
    drive: Drive, element: Element, x: Float[Tensor, " frames"], time: Float[Tensor, " frames"], recorded: Channels
) -> Float[Tensor, " frames"]:
    """Return gain times the profile or channel, late by the lag.

    Args:
        drive: what is commanded.
        x: length or angle of the element.
        time: of the frames [s].

    Raises:
        ConfigError: ``device.unknown`` or ``device.channel``.
    """
    gain, lag = (known(getattr(drive, n), element, n) for n in ("gain", "lag"))
    return gain * late(command(drive, element, x, time, recorded), time, lag)


def command(
    drive: Drive, element: Element, x: Float[Tensor, " frames"], time: Float[Tensor, " frames"], recorded: Channels
) -> Float[Tensor, " frames"]:
    """Return the profile or channel itself, without gain and lag; arguments as of ``drive_force``."""
    if drive.channel:
        return channel(recorded, drive.channel, element.name).to(time)
    at = {"time": lambda: time, "angle": lambda: x, "phase": lambda: channel(recorded, PHASE, element.name)}
    first, last = drive.profile[0][0], drive.profile[-1][0]
    return interpolated(drive.profile, at[drive.over]().clamp(first, last))


def late(values: Float[Tensor, " frames"], time: Float[Tensor, " frames"], lag: float) -> Float[Tensor, " frames"]:
    """Return a series as it comes ``lag`` seconds later, its first value before its begin."""
    if lag == 0.0:
        return values
    clock = time.cpu().numpy()
    return torch.as_tensor(np.interp(clock - lag, clock, values.cpu().numpy())).to(values)
