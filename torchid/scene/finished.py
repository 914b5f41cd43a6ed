"""A finished run as the page needs it, read from its files a piece at a time."""

import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import xarray
from jaxtyping import Float

from torchid.errors import InputError
from torchid.scene.scene import Ground, Instant
from torchid.scene.solids import Solids, solids, sticks
from torchid.storage.netcdf import CHUNK

WRENCHES = ("measured", "predicted", "extended")


@dataclass(frozen=True)
class Segments:
    """What a run, or a stream, knows of the segments."""

    table: dict[str, dict[str, Any]]
    """As in ``inertia.json``."""

    @property
    def progress(self) -> Float[np.ndarray, " segments"]:
        """Return how much of the prior's uncertainty is gone, 0 to 1."""
        return np.array([float(one["progress"]) for one in self.table.values()])

    @property
    def solids(self) -> Solids:
        """Return the ellipsoids."""
        mass, com, inertia = (
            np.array([one[key] for one in self.table.values()], dtype=np.float64)
            for key in ("mass_kg", "com_m", "inertia_kgm2")
        )
        return solids(tuple(self.table), mass, com, inertia)


class FinishedTrial:
    """One trial of a run, whose frames are read when they are looked at."""

    def __init__(self, name: str, motion: Path, forces: Path, ends: Float[np.ndarray, "bodies 3"]) -> None:
        """Open a trial's files.

        Args:
            motion: its ``motion_*.nc``.
            forces: its ``forces_*.nc``, which need not be there.
            ends: far end of every body, in its axes [m].

        Raises:
            InputError: ``view.unreadable``.
        """
        self.name, self._ends = name, ends
        self._motion = _opened(motion)
        self._forces = _opened(forces) if forces.exists() else None
        self.time: Float[np.ndarray, " frames"] = self._motion["time"].values
        self._parents = np.atleast_1d(self._motion.attrs.get("parents", [])).astype(int).tolist()
        self._piece = lru_cache(maxsize=2)(self._read)

    def close(self) -> None:
        """Let go of the files."""
        self._motion.close()
        if self._forces is not None:
            self._forces.close()

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def ground(self) -> Ground:
        """Return plates and their corners."""
        if self._forces is None or "plate_corners" not in self._forces:
            return Ground((), ())
        corners = self._forces["plate_corners"].values
        known = tuple(one if np.isfinite(one).all() else None for one in corners)
        return Ground(known, tuple(str(name) for name in self._forces["plate"].values))

    @cached_property
    def wrenches(self) -> tuple[str, ...]:
        """Return which total forces there are: the extended model's only where it differs from the base's."""
        if self._forces is None:
            return ()
        same = np.array_equal(self._forces["extended"].values, self._forces["predicted"].values)
        return WRENCHES[:2] if same else WRENCHES

    def instant(self, frame: int) -> Instant:
        """Return what there is to be seen at a frame."""
        piece, k = self._piece(frame // CHUNK), frame % CHUNK
        distance = np.linalg.norm(piece["markers_modelled"][k] - piece["markers_measured"][k], axis=1)
        forces = {name: piece[name][k] for name in self.wrenches}
        scaled = piece["X_WB_scaled"][k] if "X_WB_scaled" in piece and self._parents else None
        return Instant(
            piece["X_WB"][k], piece["markers_measured"][k], distance,
            piece["plate_wrench"][k] if "plate_wrench" in piece else None,
            sticks=None if scaled is None else sticks(self._parents, scaled, self._ends), **forces,
        )  # fmt: skip

    def wrench(self, name: str, most: int) -> tuple[Float[np.ndarray, " some"], Float[np.ndarray, "some 6"]] | None:
        """Return a total wrench of the whole trial, at most so many instants of it; None where it has none."""
        if self._forces is None or name not in self.wrenches:
            return None
        step = max(1, -(-len(self.time) // most))
        return self.time[::step], self._forces[name][::step].values

    def _read(self, number: int) -> dict[str, np.ndarray]:
        part = slice(number * CHUNK, (number + 1) * CHUNK)
        names = ("X_WB", "X_WB_scaled", "markers_measured", "markers_modelled")
        piece = {name: self._motion[name][part].values for name in names if name in self._motion}
        if self._forces is not None:
            piece |= {name: self._forces[name][part].values for name in (*WRENCHES, "plate_wrench")}
        return piece


class FinishedRun:
    """The folder of a finished run."""

    def __init__(self, folder: Path) -> None:
        """Open a run.

        Args:
            folder: a config's ``out``.

        Raises:
            InputError: ``view.no_run`` where it has no inertia or no motion; ``view.unreadable``.
        """
        table, files = _json(folder, "inertia.json"), sorted(folder.glob("motion_*.nc"))
        if not files:
            raise _no_run(folder, "no motion_*.nc")
        self.folder = folder
        try:
            self.segments = Segments(table["segments"])
            self._ends = 2.0 * self.segments.solids.centre
        except (KeyError, TypeError, ValueError) as error:
            raise _unreadable(folder / "inertia.json", error) from None
        self._files = {_trial_name(file): file for file in files}
        self.trials = tuple(self._files)

    def trial(self, name: str) -> FinishedTrial:
        """Return a trial by its name."""
        motion = self._files[name]
        forces = motion.with_name(motion.name.replace("motion_", "forces_", 1))
        return FinishedTrial(name, motion, forces, self._ends)


def _trial_name(motion: Path) -> str:
    """What the user calls a trial; files of before have it in their own name alone."""
    try:
        with h5netcdf.File(motion, "r") as some:  # xarray would make ready to read all of it
            return str(some.attrs.get("trial", motion.name.removeprefix("motion_").removesuffix(".nc")))
    except (OSError, ValueError, KeyError) as error:
        raise _unreadable(motion, error) from None


def _json(folder: Path, name: str) -> dict[str, Any]:
    try:
        return json.loads((folder / name).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise _no_run(folder, f"no {name}") from None
    except (OSError, ValueError) as error:
        raise _unreadable(folder / name, error) from None


def _opened(path: Path) -> xarray.Dataset:
    try:
        return xarray.open_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        raise _unreadable(path, error) from None


def _no_run(folder: Path, found: str) -> InputError:
    return InputError(
        "view.no_run", "is not the folder of a finished run", source=folder, found=found,
        remedy="Give the `out` of a config that `torchid run` has finished",
    )  # fmt: skip


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(
        "view.unreadable", "cannot be read", source=path, found=str(error)[:200],
        remedy="Run the config again: its stages are kept",
    )  # fmt: skip
