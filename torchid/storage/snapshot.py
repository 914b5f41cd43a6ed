"""A stage's result as bytes and back: dataclasses of tensors without pickle.

A SHA-256 stands in front, then the length of a JSON document, the document, which holds the structure and says where
each array lies, and the arrays' plain bytes. Only dataclasses and enums of torchid that are already imported are
rebuilt, so that reading runs no foreign code.

Tensors of a file are mapped, not read: an hour of motion takes memory only while somebody looks at it (``release``).
"""

import ctypes
import dataclasses
import hashlib
import io
import json
import math
import mmap
import os
import sys
import weakref
from collections.abc import Iterator, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
import torch

Value = TypeVar("Value")
DIGEST, LENGTH, ALIGN = 32, 8, 64
PIECE = 1 << 22
"""Values of an array that are made contiguous at a time."""
SPARED = 512 << 20
"""Bytes of mapped tensors that stay in memory; chosen: what a session of short trials has. To read them again and again
took a fifteenth of an evaluation of twelve walks, while an hour's recording has ten times as many."""
_maps: "weakref.WeakSet[mmap.mmap]" = weakref.WeakSet()
_trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None


class SnapshotError(ValueError):
    """The bytes are no snapshot, or hold what this version of torchid does not know."""


def to_bytes(value: Any) -> bytes:
    """Snapshot of nested dataclasses, tuples, lists, dicts with text keys, tensors, arrays, numbers, texts and paths.

    Raises:
        TypeError: something else is inside.
    """
    buffer = io.BytesIO()
    write_snapshot(buffer, value)
    return buffer.getvalue()


def from_bytes(content: bytes) -> Any:
    """The value that ``to_bytes`` was given; tensors arrive on the CPU with the dtype they had.

    Raises:
        SnapshotError: see there.
    """
    return _checked(bytearray(content))


def write_snapshot(file: BinaryIO | io.BytesIO, value: Any) -> None:
    """The bytes of ``to_bytes`` into an empty file, without a copy of them in memory; errors as there."""
    digest = hashlib.sha256()
    file.write(bytes(DIGEST))
    for piece in _pieces(value):
        digest.update(piece)
        file.write(piece)
    file.seek(0)
    file.write(digest.digest())


def load_snapshot(path: str | Path) -> Any:
    """The value that was written to a file, its tensors mapped and not to be changed in place.

    Raises:
        SnapshotError: damaged.
        OSError: it cannot be read.
    """
    with Path(path).open("rb") as file:
        value = _checked(_map(file))
    release()  # the digest has looked at all of it
    return value


def swap_out(value: Value, file: BinaryIO) -> Value:
    """The same value, its tensors mapped from ``file``, which was empty and may be closed; not to be changed in place.

    Raises:
        TypeError: as ``to_bytes``.
        OSError: the file cannot be written.
    """
    file.write(bytes(DIGEST))
    for piece in _pieces(value):
        file.write(piece)
    file.flush()
    return _rebuild(_map(file))


def in_memory(shape: Sequence[int]) -> torch.Tensor:
    """Zeros (float64) of a shape, as ``make_room`` makes them, without a file."""
    return torch.zeros(*shape, dtype=torch.float64)


def make_room(file: BinaryIO, shape: Sequence[int]) -> torch.Tensor:
    """Zeros (float64) of a shape, mapped from ``file``, which was empty and may be closed.

    What is written into them goes to the file, so that ``unload`` gives their memory back while they are filled.

    Raises:
        OSError: the file has no room for them.
    """
    size = math.prod(shape) * torch.float64.itemsize
    if not size:
        return in_memory(shape)
    # All of it is taken at once: what the disk had no room for later would end the process.
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
    else:
        for start in range(0, size, PIECE):
            file.write(bytes(min(PIECE, size - start)))
        file.flush()
    return torch.from_numpy(np.frombuffer(_map(file, mmap.ACCESS_WRITE), np.float64).reshape(*shape))


def release() -> None:
    """Give back the memory of all mapped tensors, if they are many; whoever looks at them again has them from the file.

    What glibc keeps of freed memory goes with them: after an hour's recording that were 450 MiB in pieces. Where mapped
    tensors are few the session is short, and both stay.
    """
    if unload() and _trim is not None:
        _trim(0)


def unload() -> bool:
    """Give back the memory of all mapped tensors, if they are many, and no other: freed memory stays for what is next.

    Returns:
        Whether it was given back.
    """
    mapped = list(_maps)
    if sum(map(len, mapped)) <= SPARED:
        return False
    for one in mapped:
        one.madvise(mmap.MADV_DONTNEED)
    return True


def _map(file: Any, access: int = mmap.ACCESS_COPY) -> mmap.mmap:
    try:
        mapped = mmap.mmap(file.fileno(), 0, access=access)
    except ValueError as error:
        raise SnapshotError("the stored file is empty") from error
    if hasattr(mmap, "MADV_DONTNEED"):  # not on Windows
        _maps.add(mapped)
    return mapped


def _pieces(value: Any) -> Iterator[bytes | memoryview]:
    """Everything behind the digest."""
    arrays: dict[Any, tuple[int, np.ndarray]] = {}
    document = json.dumps(_encode(value, arrays)).encode("ascii")
    yield len(document).to_bytes(LENGTH, "little")
    yield document
    yield bytes(_begin(len(document)) - DIGEST - LENGTH - len(document))
    for _, array in arrays.values():
        rows = max(1, PIECE // max(1, array[:1].size)) if array.ndim else 1
        for start in range(0, len(array) if array.ndim else 1, rows):
            part = np.ascontiguousarray(array[start : start + rows] if array.ndim else array)
            if part.size:
                yield part.reshape(-1).view(np.uint8).data
        yield bytes(-array.nbytes % ALIGN)


def _begin(document: int) -> int:
    """Where the arrays begin behind a document of so many bytes."""
    end = DIGEST + LENGTH + document
    return end + -end % ALIGN


def _checked(content: bytearray | mmap.mmap) -> Any:
    if hashlib.sha256(memoryview(content)[DIGEST:]).digest() != content[:DIGEST]:
        raise SnapshotError("the stored file is damaged")
    return _rebuild(content)


def _rebuild(content: bytearray | mmap.mmap) -> Any:
    try:
        size = int.from_bytes(content[DIGEST : DIGEST + LENGTH], "little")
        document = json.loads(content[DIGEST + LENGTH : DIGEST + LENGTH + size])
        return _decode(document, content, _begin(size))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError) as error:
        # The digest has shown that the bytes are those once written: what they lack is only what they mean here.
        raise SnapshotError("it was stored by another version of torchid") from error


def _encode(value: Any, arrays: dict[Any, tuple[int, np.ndarray]]) -> Any:
    if isinstance(value, Enum):
        return {"enum": _class_name(type(value)), "name": value.name}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, torch.Tensor | np.ndarray):
        kind = "tensor" if isinstance(value, torch.Tensor) else "array"
        return {kind: _keep(value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value, arrays)}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, list | tuple):
        entries = [_encode(entry, arrays) for entry in value]
        return entries if isinstance(value, list) else {"tuple": entries}
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {"dict": {key: _encode(entry, arrays) for key, entry in value.items()}}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: _encode(getattr(value, f.name), arrays) for f in dataclasses.fields(value) if f.init}
        return {"class": _class_name(type(value)), "fields": fields}
    raise TypeError(f"{type(value).__name__} cannot go into a snapshot")


def _keep(array: np.ndarray, arrays: dict[Any, tuple[int, np.ndarray]]) -> list[Any]:
    """Where the array will lie: dtype, shape and offset. One that stands twice is kept once."""
    if array.dtype.hasobject:
        raise TypeError("an array of objects cannot go into a snapshot")
    key = array.__array_interface__["data"][0], array.shape, array.strides, array.dtype.str
    if key not in arrays:
        last = next(reversed(arrays.values()), None)
        arrays[key] = 0 if last is None else last[0] + last[1].nbytes + -last[1].nbytes % ALIGN, array
    return [array.dtype.str, list(array.shape), arrays[key][0]]


def _class_name(kind: type) -> str:
    if kind.__module__.split(".")[0] != "torchid":
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} is not torchid's and cannot go into a snapshot")
    return f"{kind.__module__}:{kind.__qualname__}"


def _decode(node: Any, content: bytearray | mmap.mmap, begin: int) -> Any:
    if isinstance(node, list):
        return [_decode(entry, content, begin) for entry in node]
    if not isinstance(node, dict):
        return node
    kind = next(iter(node))
    inside = node[kind]
    if kind in ("tensor", "array"):
        array = _array(inside, content, begin)
        return torch.from_numpy(array) if kind == "tensor" else array
    if kind == "path":
        return Path(inside)
    if kind == "tuple":
        return tuple(_decode(entry, content, begin) for entry in inside)
    if kind == "dict":
        return {key: _decode(entry, content, begin) for key, entry in inside.items()}
    if kind == "enum":
        return getattr(_class(inside, Enum), node["name"])
    return _class(inside)(**{key: _decode(entry, content, begin) for key, entry in node["fields"].items()})


def _array(kept: list[Any], content: bytearray | mmap.mmap, begin: int) -> np.ndarray:
    kind, shape, offset = kept
    size = math.prod(shape)
    if not size:
        return np.zeros(shape, kind)
    return np.frombuffer(content, np.dtype(kind), size, begin + offset).reshape(shape)


def _class(name: str, base: type = object) -> Any:
    module, _, qualname = name.partition(":")
    if module.split(".")[0] != "torchid":
        raise SnapshotError(f"{name} is not torchid's")
    found: Any = sys.modules[module]
    for part in qualname.split("."):
        found = getattr(found, part)
    if not (isinstance(found, type) and issubclass(found, base)):
        raise SnapshotError(f"{name} is no {base.__name__}")
    if base is object and not dataclasses.is_dataclass(found):
        raise SnapshotError(f"{name} is no dataclass")
    return found
