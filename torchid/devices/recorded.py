"""Channels of a device from files, on the frames of a motion: C3D analogs, MOT and STO columns, CSV columns.

A channel that was sampled faster than the frames is averaged over each frame's time. Streams of LSL come from
``torchid.live.sources.xdf.device_series`` in the same form.
"""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import InputError
from torchid.io.c3d import read_analogs
from torchid.io.c3d_header import read_header
from torchid.io.c3d_layout import resolve_layout
from torchid.io.files import FileBytes, read_lines
from torchid.io.storage import read_storage

Series = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""Times [s] and values of each channel, by name."""


def read_channels(path: str | Path, time: Float[Tensor, " frames"]) -> dict[str, Tensor]:
    """Read the channels of a file on some frames.

    Args:
        path: C3D (its analog channels), MOT or STO (its columns), or CSV (first column the time [s], a header).
        time: of the frames, on the clock of the file [s].

    Returns:
        Channels (frames,) by name; NaN where the file does not reach.

    Raises:
        InputError: ``device.channels`` for another kind of file or one that is not as said; what the readers say.
    """
    path = Path(path)
    readers = {".c3d": _c3d, ".mot": _storage, ".sto": _storage, ".csv": _csv}
    if path.suffix.lower() not in readers:
        raise InputError(
            "device.channels", "not a file of channels", source=path, found=path.suffix,
            remedy=f"Known: {', '.join(readers)}",
        )  # fmt: skip
    return on_frames(readers[path.suffix.lower()](path), time)


def on_frames(series: Series, time: Float[Tensor, " frames"]) -> dict[str, Tensor]:
    """Return series on the frames of a motion; faster ones averaged over each frame, NaN beyond their ends.

    Args:
        series: rising times [s] and values by name.
        time: of the frames, at equal steps [s].
    """
    clock = time.cpu().numpy()
    step = float(np.median(np.diff(clock))) if len(clock) > 1 else 0.0
    return {name: torch.as_tensor(_resampled(t, x, clock, step)).to(time) for name, (t, x) in series.items()}


def _resampled(t: np.ndarray, x: np.ndarray, clock: np.ndarray, step: float) -> np.ndarray:
    own = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    inside = (clock >= t[0] - 0.5 * own) & (clock <= t[-1] + 0.5 * own)
    if own >= 0.75 * step or len(t) < 2:
        return np.where(inside, np.interp(clock, t, x), np.nan)
    # the mean over a frame is the difference of the integral, which the trapezoidal rule gives
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))])
    low, high = (np.clip(clock + side * 0.5 * step, t[0], t[-1]) for side in (-1.0, 1.0))
    mean = (np.interp(high, t, integral) - np.interp(low, t, integral)) / np.maximum(high - low, 1e-12)
    return np.where(inside, mean, np.nan)


def _c3d(path: Path) -> Series:
    data = FileBytes(path)
    header = read_header(data, path)
    layout = resolve_layout(header, data, False)
    labels = header.strings("ANALOG", "LABELS")
    values, _ = read_analogs(data, layout, header)
    begin = (layout.first_frame - 1) / layout.rate
    time = begin + np.arange(len(values)) / (layout.rate * max(layout.ratio, 1))
    return {label.strip(): (time, values[:, k]) for k, label in enumerate(labels[: values.shape[1]])}


def _storage(path: Path) -> Series:
    storage = read_storage(path)
    return {name: (storage.time, storage.values[:, k]) for k, name in enumerate(storage.columns)}


def _csv(path: Path) -> Series:
    rows = [row for row in csv.reader(read_lines(path)) if any(cell.strip() for cell in row)]
    try:
        values = np.array([[float(cell) for cell in row] for row in rows[1:]])
        names = [name.strip() for name in rows[0]]
        good = len(values) > 1 and values.shape[1] == len(names) and bool((np.diff(values[:, 0]) > 0.0).all())
    except (ValueError, IndexError):
        good = False
    if not good:
        raise InputError(
            "device.channels", "not columns over time", source=path,
            remedy="Write a header, then rows of numbers as long as it, the rising time [s] first",
        )  # fmt: skip
    return {name: (values[:, 0], values[:, k]) for k, name in enumerate(names) if k}
