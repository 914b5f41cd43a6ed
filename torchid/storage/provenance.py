"""Where a result comes from: versions, hashes of code and inputs, seed, cost; and the keys of stages made of them."""

import hashlib
import importlib.metadata
import json
import platform
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.storage.files import file_sha256, plain

DEPENDENCIES = ("torch", "pytorch-kinematics", "numpy", "scipy", "cvxpy", "clarabel", "ezc3d", "xarray", "h5netcdf")


@dataclass(frozen=True)
class StageTime:
    """What a stage cost."""

    seconds: float
    """On the clock, of the computation, also where its result was taken from an earlier run."""
    cpu_seconds: float
    """Of all processors together."""
    reused: bool
    key: str
    """Of the stored result; empty where none is stored."""


class Stopwatch:
    """Runs from when it is made."""

    def __init__(self) -> None:
        self._start = time.perf_counter(), time.process_time()

    def seconds(self) -> tuple[float, float]:
        """On the clock, and of all processors together."""
        return time.perf_counter() - self._start[0], time.process_time() - self._start[1]


def stage_key(**parts: Any) -> str:
    """SHA-256 of what a stage's result depends on: the parts, torchid's code and the versions of its libraries.

    Parts are options, tensors, hashes of inputs, the seed, the key of the stage before: dataclasses, tensors, JSON.
    """
    digest = hashlib.sha256(json.dumps([code_sha256(), versions()]).encode())
    for name in sorted(parts):
        digest.update(name.encode())
        _update(digest, parts[name])
    return digest.hexdigest()


def _update(digest: Any, value: Any) -> None:
    """Tensors by their bytes: as JSON text they would cost a hundred times as much."""
    if isinstance(value, torch.Tensor | np.ndarray):
        array = np.ascontiguousarray(value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value)
        digest.update(f"<{array.dtype}{array.shape}>".encode())
        digest.update(array.tobytes())
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            digest.update(f"<key {key!r}>".encode())
            _update(digest, entry)
    elif isinstance(value, list | tuple):
        digest.update(f"<{len(value)} entries>".encode())
        for entry in value:
            _update(digest, entry)
    elif hasattr(value, "__dataclass_fields__"):
        digest.update(f"<{type(value).__qualname__}>".encode())
        _update(digest, {name: getattr(value, name) for name in value.__dataclass_fields__})
    else:
        digest.update(repr(value if isinstance(value, float) else plain(value)).encode())


@cache
def code_sha256() -> str:
    """Hash of torchid's own source files, so that no result outlives the code that made it."""
    root = Path(__file__).parents[1]
    files = sorted(path for path in root.rglob("*") if path.suffix in (".py", ".yaml"))
    return hashlib.sha256("".join(f"{f.relative_to(root)}{file_sha256(f)}" for f in files).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Versions of torchid, Python and the libraries that compute."""
    found = {"torchid": _version("torchid"), "python": platform.python_version()}
    return found | {name: _version(name) for name in DEPENDENCIES}


@cache
def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def provenance(inputs: Iterable[str | Path], seed: int, times: Mapping[str, StageTime]) -> dict[str, Any]:
    """Content of ``provenance.json``: versions, platform, hashes of the input files, seed, times per stage."""
    return {
        "versions": versions(),
        "code_sha256": code_sha256(),
        "platform": platform.platform(),
        "threads": torch.get_num_threads(),
        "seed": seed,
        "written": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "inputs": {str(path): file_sha256(path) for path in inputs},
        "stages": {name: asdict(cost) for name, cost in times.items()},
    }
