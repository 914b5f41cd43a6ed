"""What a device recorded of itself in a trial, on the frames of the trial's motion."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import InputError
from torchid.io.storage import read_storage

STORAGES = (".mot", ".sto")


def read_channels(
    path: Path, time: Float[Tensor, " frames"], names: Mapping[str, str] | None = None
) -> dict[str, Float[Tensor, " frames"]]:
    """Channels of a MOT, STO or CSV file at the times of a motion, linear between samples.

    Args:
        path: the file; its first column is the time in the trial's clock [s].
        time: of the frames [s]; outside the file's span a channel is NaN.
        names: column for each name that a device asks for; columns keep their own names as well.

    Raises:
        InputError: ``channels.table`` where the file is no such table, or a column is not there.
    """
    columns = _storage(path) if path.suffix.lower() in STORAGES else _csv(path)
    clock, at = columns.pop("time"), time.cpu().numpy()
    found = {name: np.interp(at, clock, values, left=np.nan, right=np.nan) for name, values in columns.items()}
    for name, column in (names or {}).items():
        if column not in found:
            raise InputError(
                "channels.table", "a column is missing", source=path, place=column,
                found=", ".join(columns)[:200], remedy="Correct channels: of the condition, or export the column",
            )  # fmt: skip
        found[name] = found[column]
    return {name: torch.as_tensor(values).to(time) for name, values in found.items()}


def _storage(path: Path) -> dict[str, np.ndarray]:
    stored = read_storage(path)
    return {"time": stored.time} | {name: stored.values[:, k] for k, name in enumerate(stored.columns)}


def _csv(path: Path) -> dict[str, np.ndarray]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            head, *rows = [row for row in csv.reader(file) if row]
        values = np.array([[float(cell) for cell in row] for row in rows])
        names = [name.strip() for name in head]
        if values.ndim != 2 or values.shape[1] != len(names) or (np.diff(values[:, 0]) <= 0.0).any():
            raise ValueError("rows of unequal length, or a time that does not rise")
    except (OSError, ValueError) as error:
        raise InputError(
            "channels.table", "this is no table of channels", source=path, found=str(error)[:120],
            remedy="Write a line of names, then rows of numbers with the time [s] first and rising",
        ) from error  # fmt: skip
    return {"time": values[:, 0]} | {name: values[:, k] for k, name in enumerate(names) if k}
