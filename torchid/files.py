"""Files that exist whole or not at all, under names that cannot leave their folder."""

import dataclasses
import hashlib
import json
import math
import os
import re
import secrets
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any, BinaryIO

import h5netcdf
import numpy as np
import torch
import xarray

from torchid.errors import InputError

_SAFE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}(?<!\.)\Z")
_RESERVED = re.compile(r"(?i:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?\Z")
"""Devices of Windows."""
CHUNK = 1024
"""Samples along the first dimension that a netCDF file packs together."""


def safe_name(text: str) -> str:
    """A file-name part for a name that came from data: itself if plain, else a slug and eight hex of its hash."""
    if _SAFE.match(text) and not _RESERVED.match(text):
        return text
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    slug = re.sub(r"[^A-Za-z0-9]+", "-", plain).strip("-")[:40] or "name"
    return f"{slug}-{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place, flushed to the disk, when the block ends well.

    Raises:
        InputError: ``results.unwritable`` with the system's reason (disk full, read-only, no such folder).
    """
    path = Path(path)
    temporary = path.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        yield temporary
        _flush(temporary, os.O_RDWR)
        os.replace(temporary, path)
        if os.name == "posix":  # Windows cannot open a folder
            _flush(path.parent, os.O_RDONLY)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def unwritable(path: Path, error: OSError) -> InputError:
    """The error ``results.unwritable`` with the system's reason."""
    return InputError(
        "results.unwritable",
        "cannot be written",
        source=path,
        found=error.strerror or str(error),
        remedy="Make room or choose another `out`.",
    )


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """A binary file that appears at ``path`` only when the block ends well; errors as ``atomic_path``."""
    with atomic_path(path) as temporary, temporary.open("xb") as file:
        yield file


def _flush(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def plain(value: Any) -> Any:
    """``value`` as JSON can hold it: tensors and arrays become lists, dataclasses dicts, NaN and infinity None.

    Raises:
        TypeError: the value has no such form.
    """
    if isinstance(value, torch.Tensor):
        return plain(value.detach().cpu().tolist())
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Enum):
        return plain(value.value)
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(entry) for entry in (sorted(value) if isinstance(value, set | frozenset) else value)]
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def write_json(path: str | Path, value: Any) -> None:
    """``plain(value)`` as UTF-8 JSON, atomically; a number that does not exist is ``null``."""
    text = json.dumps(plain(value), indent=1, ensure_ascii=False, allow_nan=False)
    # Half a surrogate pair from a damaged label has no UTF-8; its backslash form is JSON again.
    with atomic_write(path) as file:
        file.write(text.encode("utf-8", "backslashreplace") + b"\n")


def write_text(path: str | Path, text: str) -> None:
    """``text`` as UTF-8, atomically."""
    with atomic_write(path) as file:
        file.write(text.encode("utf-8", "replace"))


def write_netcdf(path: str | Path, pieces: Iterable[xarray.Dataset]) -> None:
    """A netCDF-4 file through h5netcdf, deflated, atomically.

    Args:
        path: the file.
        pieces: the dataset, cut along its dimension ``time`` where it is long; only one piece is held at a time.
    """
    with atomic_path(path) as temporary:
        for k, piece in enumerate(pieces):
            if k == 0:
                long = [name for name in ("time",) if name in piece.sizes]
                piece.to_netcdf(temporary, engine="h5netcdf", encoding=_encoding(piece), unlimited_dims=long)
            else:
                _append(temporary, piece)


def _encoding(dataset: xarray.Dataset) -> dict[Any, dict[str, Any]]:
    numbers = {name: v for name, v in dataset.variables.items() if v.ndim and v.dtype.kind in "fiu"}
    sizes = {name: (min(max(1, len(v)), CHUNK), *map(int, v.shape[1:])) for name, v in numbers.items()}
    return {name: {"zlib": True, "complevel": 1, "chunksizes": size} for name, size in sizes.items()}


def _append(path: Path, piece: xarray.Dataset) -> None:
    with h5netcdf.File(path, "a") as file:
        start = file.dimensions["time"].size
        file.resize_dimension("time", start + piece.sizes["time"])
        for name, variable in file.variables.items():
            if "time" in variable.dimensions:
                variable[start:] = piece[name].values.astype(variable.dtype)


def file_sha256(path: str | Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
