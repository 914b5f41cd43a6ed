"""How far two results of the same configs lie apart: every number of their files, and the causes that are named.

    python scripts/compare_runs.py OLD NEW

Each folder holds one `out` of `torchid run` a config. A number's distance is absolute below one and relative above.
Notes of reading are sentences and are not compared.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray

TABLES = ("geometry.json", "inertia.json")
SENTENCES = ("warnings",)
"""Keys whose values are for readers."""
ADDED = ("quality",)
"""Keys that are not in older results."""
ENOUGH = 1e-6


def apart(old: Any, new: Any, where: str) -> Iterator[tuple[float, str]]:
    """Distances of all numbers of two JSON documents, infinite where one has no partner."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted((old.keys() | new.keys()) - set(SENTENCES) - (set(ADDED) - old.keys())):
            if key in old and key in new:
                yield from apart(old[key], new[key], f"{where}/{key}")
            else:
                yield np.inf, f"{where}/{key}"
    elif isinstance(old, list) and isinstance(new, list):
        yield (0.0 if len(old) == len(new) else np.inf), where
        for k, pair in enumerate(zip(old, new, strict=False)):
            yield from apart(*pair, f"{where}/{k}")
    elif isinstance(old, int | float) and isinstance(new, int | float):
        yield abs(old - new) / max(1.0, abs(old)), where
    elif type(old) is not type(new):
        yield np.inf, where


def arrays_apart(old: Path, new: Path) -> Iterator[tuple[float, str]]:
    """Distances of all variables of two netCDF files; values that are missing in one only are infinitely far."""
    with xarray.open_dataset(old, engine="h5netcdf") as a, xarray.open_dataset(new, engine="h5netcdf") as b:
        for name in a.data_vars:
            if a[name].dtype.kind == "f":
                x, y = a[name].values, b[name].values
                known = np.isfinite(x)
                lost = x.shape != y.shape or bool((known != np.isfinite(y)).any())
                far = np.inf if lost else np.max(np.abs(x - y)[known] / np.maximum(1.0, np.abs(x[known])), initial=0.0)
                yield float(far), f"{old.name}:{name}"


def causes(folder: Path) -> list[tuple]:
    """What the diagnosis names, where, how surely, and whether it was applied."""
    path = folder / "diagnosis.json"
    named = json.loads(path.read_text())["causes"] if path.exists() else []
    return [(one["effect"], one["where"], one["level"], one["applied"]) for one in named]


def compared(old: Path, new: Path) -> tuple[float, str]:
    """The largest distance of two results, and where it is."""
    found = [(0.0, "")]
    for path in sorted((*(old / name for name in TABLES), *old.glob("*.nc"))):
        if not path.exists():
            continue
        other = new / path.name
        if not other.exists():
            found.append((np.inf, path.name))
        elif path.suffix == ".nc":
            found += arrays_apart(path, other)
        else:
            found += apart(json.loads(path.read_text()), json.loads(other.read_text()), path.name)
    return max(found)


def main(argv: list[str] | None = None) -> int:
    """Print a line for each config; 1 where a number is off by more than 1e-6 or causes differ."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    given, wrong = parser.parse_args(argv), 0
    for new in sorted(path for path in given.new.iterdir() if path.is_dir()):
        far, where = compared(given.old / new.name, new)
        same = causes(given.old / new.name) == causes(new)
        wrong |= far > ENOUGH or not same
        print(f"{new.name}: {far:.1e} {where} causes {'the same' if same else 'differ'}")
    return int(wrong)


if __name__ == "__main__":
    raise SystemExit(main())
