"""A stage's result as bytes and back: dataclasses of tensors in an npz without pickle.

The tensors are the npz's arrays; the structure around them is a JSON document beside them; a SHA-256 stands in front,
because zipfile and numpy meet damaged bytes with a dozen kinds of exception and with allocations of any size.
Only dataclasses and enums of torchid that are already imported are rebuilt, so that reading runs no foreign code.
"""

import dataclasses
import hashlib
import io
import json
import sys
import zipfile
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import torch

_DOCUMENT = "__document__"


class SnapshotError(ValueError):
    """The bytes are no snapshot, or hold what this version of torchid does not know."""


def to_bytes(value: Any) -> bytes:
    """Snapshot of nested dataclasses, tuples, lists, dicts with text keys, tensors, arrays, numbers, texts and paths.

    Raises:
        TypeError: something else is inside.
    """
    arrays: dict[str, np.ndarray] = {}
    document = json.dumps(_encode(value, arrays))
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **{_DOCUMENT: np.frombuffer(document.encode("ascii"), np.uint8)}, **arrays)
    content = buffer.getvalue()
    return hashlib.sha256(content).digest() + content


def from_bytes(content: bytes) -> Any:
    """The value that ``to_bytes`` was given; tensors arrive on the CPU with the dtype they had.

    Raises:
        SnapshotError: see there.
    """
    digest, content = content[:32], content[32:]
    if hashlib.sha256(content).digest() != digest:
        raise SnapshotError("damaged snapshot")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _decode(json.loads(arrays.pop(_DOCUMENT).tobytes()), arrays)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise SnapshotError(f"unreadable snapshot: {error}") from error


def _encode(value: Any, arrays: dict[str, np.ndarray]) -> Any:
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


def _keep(array: np.ndarray, arrays: dict[str, np.ndarray]) -> str:
    if array.dtype.hasobject:
        raise TypeError("an array of objects cannot go into a snapshot")
    name = f"a{len(arrays)}"
    arrays[name] = array
    return name


def _class_name(kind: type) -> str:
    if kind.__module__.split(".")[0] != "torchid":
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} is not torchid's and cannot go into a snapshot")
    return f"{kind.__module__}:{kind.__qualname__}"


def _decode(node: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(node, list):
        return [_decode(entry, arrays) for entry in node]
    if not isinstance(node, dict):
        return node
    kind = next(iter(node))
    content = node[kind]
    if kind == "tensor":
        return torch.from_numpy(np.array(arrays[content]))
    if kind == "array":
        return arrays[content]
    if kind == "path":
        return Path(content)
    if kind == "tuple":
        return tuple(_decode(entry, arrays) for entry in content)
    if kind == "dict":
        return {key: _decode(entry, arrays) for key, entry in content.items()}
    if kind == "enum":
        return getattr(_class(content, Enum), node["name"])
    return _class(node["class"])(**{key: _decode(entry, arrays) for key, entry in node["fields"].items()})


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
