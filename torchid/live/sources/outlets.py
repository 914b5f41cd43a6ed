"""A recording as streams of Lab Streaming Layer, as a laboratory would send it."""

import time
from collections.abc import Callable

import numpy as np
import pylsl
from torch import Tensor

from torchid.live.sources.description import FORCE_PLATE, MOCAP, POSITION, WRENCH
from torchid.live.sources.stream import Packet, Replay
from torchid.recording import Plate, Trial

BETWEEN_S = 3.0
"""Choice. Pause between two rounds: longer than the jump of times that tells a stream's clock was set (``JUMP_S``), so
that nothing is smoothed from the end of a recording to its beginning."""
NAP_S = 0.001
"""Choice. Pause where no frame is due: a tenth of a frame at 100 Hz."""
UNITS = {"Position": "meters", "Force": "N", "Moment": "N m"}


def describe_markers(labels: tuple[str, ...], rate_hz: float, name: str, source_id: str) -> pylsl.StreamInfo:
    """Return the description of a stream of markers, in metres and Z up, by XDF's conventions.

    Args:
        source_id: by which the stream is known again after a restart.
    """
    info = pylsl.StreamInfo(name, MOCAP, 3 * len(labels), rate_hz, pylsl.cf_double64, source_id)
    _channels(info, "marker", labels, tuple(POSITION))
    info.desc().append_child("setup").append_child_value("up", "z")
    return info


def describe_plates(plates: tuple[Plate, ...], rate_hz: float, name: str, source_id: str) -> pylsl.StreamInfo:
    """Return the description of a stream of plates: wrenches on the subject about the origin of W, and the corners.

    Args:
        plates: with unique names.
        source_id: by which the stream is known again after a restart.
    """
    info = pylsl.StreamInfo(name, FORCE_PLATE, 6 * len(plates), rate_hz, pylsl.cf_double64, source_id)
    _channels(info, "plate", tuple(plate.name for plate in plates), tuple(WRENCH))
    entries = info.desc().append_child("plates")
    for plate in plates:
        entry = entries.append_child("plate").append_child_value("id", plate.name)
        if plate.corners is not None:
            corners = entry.append_child_value("unit", "meters").append_child("corners")
            for place in plate.corners.tolist():
                corner = corners.append_child("corner")
                for axis, value in zip("XYZ", place, strict=True):
                    corner.append_child_value(axis, repr(value))
    info.desc().append_child("setup").append_child_value("up", "z")
    return info


def _channels(info: pylsl.StreamInfo, owner: str, names: tuple[str, ...], parts: tuple[str, ...]) -> None:
    channels = info.desc().append_child("channels")
    for name in names:
        for part in parts:
            channel = channels.append_child("channel").append_child_value("label", f"{name}_{part}")
            channel.append_child_value(owner, name).append_child_value("type", part)
            channel.append_child_value("unit", UNITS[part[:-1]])


class Outlets:
    """A stream of markers and, where a trial has forces, one of plates; both are open while this lives."""

    def __init__(self, trial: Trial, name: str = "torchid") -> None:
        """Open them.

        Args:
            name: of both streams, by which they are known again after a restart.
        """
        markers, forces = trial.markers, trial.forces
        self._markers = pylsl.StreamOutlet(describe_markers(markers.labels, markers.rate, name, f"{name} markers"))
        self._plates = None if forces is None else pylsl.StreamOutlet(
            describe_plates(forces.plates, forces.rate, name, f"{name} plates")
        )  # fmt: skip

    def listened(self) -> bool:
        """Return whether somebody receives the markers."""
        return self._markers.have_consumers()

    def send(self, packet: Packet, shift_s: float) -> None:
        """Send frames and samples at once.

        Args:
            packet: with times by the recording's clock.
            shift_s: from there to LSL's clock of this machine.
        """
        _push(self._markers, packet.markers.position, packet.markers.time + shift_s)
        if self._plates is not None and packet.forces is not None:
            _push(self._plates, packet.forces.wrench, packet.forces.time + shift_s)


def _push(outlet: pylsl.StreamOutlet, values: Tensor, time_s: Tensor) -> None:
    if len(time_s):
        samples = np.ascontiguousarray(values.flatten(1).numpy())
        outlet.push_chunk(samples, time_s.tolist())  # pyright: ignore[reportArgumentType]


def play(
    trial: Trial, outlets: Outlets, speed: float = 1.0, loop: bool = False, stop: Callable[[], bool] = lambda: False
) -> None:
    """Send a trial at its own pace, or at a multiple of it: time stamps keep the pace of the recording.

    Args:
        trial: what is sent.
        speed: multiple of the recording's own pace.
        loop: begin again after the end, with a pause.
        stop: asked before every packet.
    """
    first, last, sent_s = float(trial.markers.time[0]), float(trial.markers.time[-1]), 0.0
    while not stop():
        begun_s = max(pylsl.local_clock(), sent_s + BETWEEN_S)
        source, sent_s = Replay(trial, speed), begun_s + last - first
        while not stop() and (packet := source.take()) is not None:
            outlets.send(packet, begun_s - first)
            if not len(packet.markers.time):
                time.sleep(NAP_S)
        if not loop:
            return
        _nap(BETWEEN_S, stop)


def _nap(seconds: float, stop: Callable[[], bool]) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end and not stop():
        time.sleep(NAP_S)
