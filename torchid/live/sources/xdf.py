"""A recorded XDF file as a source: its markers and plates, replayed."""

from pathlib import Path
from typing import Any

import numpy as np
import pyxdf
import torch

from torchid.errors import InputError
from torchid.live.sources.description import (
    FORCE_PLATE,
    MOCAP,
    ChannelLayout,
    channel_labels,
    fault,
    marker_layout,
    plate_layout,
    rate_of,
    text,
)
from torchid.live.sources.stream import Replay
from torchid.recording import Forces, Markers, Trial


def replay_xdf(path: Path, speed: float = 1.0) -> Replay:
    """Return a source that sends what a file recorded of a stream of type ``MoCap`` and one of type ``ForcePlate``.

    Clocks are synchronised as the file has measured them; times are not made even, and lost frames stay lost.

    Args:
        speed: as for ``Replay``.

    Raises:
        InputError: ``live.xdf`` where it cannot be read, ``live.lsl`` where its streams do not say what is needed.
    """
    streams = _streams(path)
    one, other = (_only(streams, kind, path) for kind in (MOCAP, FORCE_PLATE))
    markers, plates = marker_layout(one["info"], str(path)), plate_layout(other["info"], str(path))
    (time_s, position), (sample_s, wrench) = _samples(one, markers), _samples(other, plates)
    forces = Forces(sample_s, wrench, plates.plates)
    source = Replay(Trial(path.stem, Markers(markers.names, time_s, position), forces), speed)
    # Not those of the clock that is there: lost frames are no slower stream.
    source.rate_hz = rate_of(markers, time_s, str(path))
    source.force_rate_hz = rate_of(plates, sample_s, str(path))
    return source


def device_series(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return what a file recorded of streams that are neither markers nor plates, such as a device's own.

    Returns:
        Times on the file's clock [s] and values of every numeric channel, by its label, or by the stream's name and a
        number where it has none; in the form of ``torchid.devices.on_frames``.

    Raises:
        InputError: ``live.xdf`` where it cannot be read, ``live.lsl`` where two channels have one name.
    """
    found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for stream in _streams(path):
        info = stream["info"]
        known = text(info, "type").lower() in (MOCAP.lower(), FORCE_PLATE.lower())
        if known or text(info, "channel_format") == "string" or not len(stream["time_stamps"]):
            continue
        time_s, values = (np.asarray(stream[key], dtype=float) for key in ("time_stamps", "time_series"))
        order = np.argsort(time_s, kind="stable")
        for k, name in enumerate(channel_labels(info, values.shape[1])):
            if name in found:
                raise fault(str(path), "has two channels of one name", name, "Give channels labels of their own")
            found[name] = time_s[order], values[order, k]
    return found


def _streams(path: Path) -> list[dict[str, Any]]:
    """All streams of a file, their clocks synchronised as it has measured them."""
    try:
        with path.open("rb") as file:
            streams, _ = pyxdf.load_xdf(file, synchronize_clocks=True, dejitter_timestamps=False)
    except Exception as error:  # whatever a broken file does to pyxdf
        raise InputError(
            "live.xdf", "cannot be read as XDF", source=path, found=f"{type(error).__name__}: {error}"[:160],
            remedy="Name an .xdf file, as LabRecorder writes them",
        ) from error  # fmt: skip
    return streams


def _only(streams: list[dict[str, Any]], kind: str, path: Path) -> dict[str, Any]:
    """The one stream of a type that has samples."""
    full = [one for one in streams if len(one["time_stamps"])]
    some = [one for one in full if text(one["info"], "type").lower() == kind.lower()]
    if len(some) == 1:
        return some[0]
    listed = ", ".join(f"{text(one['info'], 'name')} ({text(one['info'], 'type')})" for one in some or full)
    message = f"has {'several streams' if some else 'no stream'} of type {kind}"
    raise fault(str(path), message, listed or "no stream with samples", "Record one of each type (docs/live.md)")


def _samples(stream: dict[str, Any], layout: ChannelLayout) -> tuple[torch.Tensor, torch.Tensor]:
    """Times and samples of a stream, rising: the replay cuts them by their times."""
    time_s = torch.as_tensor(stream["time_stamps"], dtype=torch.float64) - layout.late_s
    values = torch.as_tensor(stream["time_series"], dtype=torch.float64)
    order = time_s.argsort(stable=True)
    return time_s[order], layout.read(values[order])
