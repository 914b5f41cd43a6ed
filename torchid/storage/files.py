"""Files that exist whole or not at all, under names that cannot leave their folder."""

import dataclasses
import hashlib
import io
import json
import math
import os
import re
import secrets
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch

from torchid.errors import InputError

_SAFE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}(?<!\.)\Z")
_RESERVED = re.compile(r"(?i:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?\Z")
"""Devices of Windows."""
TEMPORARY = f".{'?' * 16}.tmp*"
"""Pattern of the names under which files are written before they take their own; only a killed run leaves one."""


class NewFile(io.FileIO):
    """A new file without a buffer. Whatever torchid itself writes goes through one, so that tests can make it fail."""

    def __init__(self, path: Path) -> None:
        """Raises OSError: ``path`` exists or cannot be made."""
        super().__init__(path, "x+")


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
    temporary = _temporary(path.parent, path.suffix)
    with writing(path):
        try:
            yield temporary
            _flush(temporary, os.O_RDWR)
            os.replace(temporary, path)
            flush_folder(path.parent)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Turns the system's errors of the block into InputError ``results.unwritable`` about ``path``."""
    try:
        yield
    except OSError as error:
        raise unwritable(Path(path), error) from error


def unwritable(path: Path, error: OSError) -> InputError:
    """The error ``results.unwritable`` with the system's reason."""
    return InputError(
        "results.unwritable", "cannot be written", source=path, found=error.strerror or str(error),
        remedy="Make room or choose another `out`.",
    )  # fmt: skip


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """A binary file that appears at ``path`` only when the block ends well; errors as ``atomic_path``."""
    with atomic_path(path) as temporary, io.BufferedRandom(NewFile(temporary)) as file:
        yield file


@contextmanager
def nameless_file(folder: Path) -> Iterator[BinaryIO]:
    """A binary file in ``folder`` that is gone when nobody holds or maps it any more; OSError as the system says."""
    path = _temporary(folder)
    with io.BufferedRandom(NewFile(path)) as file:
        if os.name == "posix":  # Windows cannot remove an open file; there it stays until the folder is swept
            path.unlink()
        yield file


def _temporary(folder: Path, suffix: str = "") -> Path:
    """A name like ``TEMPORARY``; it keeps the suffix, by which ezc3d goes."""
    return folder / f".{secrets.token_hex(8)}.tmp{suffix}"


def flush_folder(folder: Path) -> None:
    """Names that were given or taken in ``folder`` are on the disk when this returns."""
    if os.name == "posix":  # Windows cannot open a folder
        _flush(folder, os.O_RDONLY)


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


def file_sha256(path: str | Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
