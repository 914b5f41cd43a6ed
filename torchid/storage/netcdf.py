"""NetCDF files written in pieces, by way of files that never fail in HDF5's hands."""

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import h5netcdf
import xarray

from torchid.errors import InputError
from torchid.storage.files import NewFile, atomic_path

CHUNK = 1024
"""Samples along the first dimension that a netCDF file packs together."""


def write_netcdf(path: str | Path, pieces: Iterable[xarray.Dataset]) -> None:
    """A netCDF-4 file through h5netcdf, deflated, atomically.

    Args:
        pieces: the dataset, cut along its dimension ``time`` where it is long; only one piece is held at a time.

    Raises:
        InputError: ``results.unwritable``.
    """
    with atomic_path(path) as temporary, _Lenient(temporary) as file:
        for k, piece in enumerate(pieces):
            if k == 0:
                long = [name for name in ("time",) if name in piece.sizes]
                piece.to_netcdf(file, engine="h5netcdf", encoding=_encoding(piece), unlimited_dims=long)
            else:
                _append(file, piece)
            file.complain()


def read_netcdf(path: Path, code: str, what: str, remedy: str) -> xarray.Dataset:
    """Return all of a netCDF file.

    Args:
        path: of the file.
        code: of the error where it cannot be read.
        what: it should be, in words.
        remedy: what to do where it is not.

    Raises:
        InputError: of that code.
    """
    try:
        with xarray.open_dataset(path, engine="h5netcdf") as file:
            return file.load()
    except (OSError, ValueError, KeyError) as error:
        raise InputError(code, f"this is no {what}", source=path, found=str(error)[:80], remedy=remedy) from None


class _Lenient(NewFile):
    """A new file whose writing never seems to fail, because HDF5 ends the process where it does.

    From the first failure on, what is written stays in memory, where reading finds it, until ``complain`` raises. That
    is at most one piece.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._error: BaseException | None = None
        self._kept: list[tuple[int, bytes]] = []

    def complain(self) -> None:
        """Raise the first failure, if there was one."""
        if self._error is not None:
            raise self._error

    def write(self, content: Any) -> int:
        """All of it; ``io.FileIO`` may write a part."""
        view, start = memoryview(content).cast("B"), self.tell()
        try:
            done = 0
            while self._error is None and done < len(view):
                done += super().write(view[done:]) or 0
        except BaseException as error:  # Ctrl-C too must not pass through HDF5
            self._error = error
        if self._error is not None:
            self._kept.append((start, bytes(view)))
            self.seek(start + len(view))
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """The file's bytes under those that it could not take."""
        view, start = memoryview(buffer).cast("B"), self.tell()
        count = super().readinto(view) or 0
        for offset, content in self._kept:
            first, last = max(offset, start), min(offset + len(content), start + len(view))
            if first < last:
                view[first - start : last - start] = content[first - offset : last - offset]
                count = max(count, last - start)
        self.seek(start + count)
        return count

    def read(self, size: int | None = -1) -> bytes:
        """By way of ``readinto``."""
        return io.RawIOBase.read(self, -1 if size is None else size)

    def truncate(self, size: int | None = None) -> int:
        """As ``io.FileIO``, failures kept back."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._error = self._error or error
            return size or 0


def _encoding(dataset: xarray.Dataset) -> dict[Any, dict[str, Any]]:
    numbers = {name: v for name, v in dataset.variables.items() if v.ndim and v.dtype.kind in "fiu"}
    sizes = {name: (min(max(1, len(v)), CHUNK), *map(int, v.shape[1:])) for name, v in numbers.items()}
    return {name: {"zlib": True, "complevel": 1, "chunksizes": size} for name, size in sizes.items()}


def _append(stored: _Lenient, piece: xarray.Dataset) -> None:
    with h5netcdf.File(stored, "a") as file:
        start = file.dimensions["time"].size
        file.resize_dimension("time", start + piece.sizes["time"])
        for name, variable in file.variables.items():
            if "time" in variable.dimensions:
                variable[start:] = piece[name].values.astype(variable.dtype)
