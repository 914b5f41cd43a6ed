"""Reading whole files within limits, and which files make up a recording."""

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import overload

from torchid.errors import InputError

MAX_BYTES = 4 << 30
CONTAINERS = (".b3d",)
"""Endings of files that hold many trials, each of which is named as if the file were a folder: ``S1.b3d/walk``."""
MOTION_BIDS = "_motion.tsv"
"""Ending of a file of positions of the Brain Imaging Data Structure."""
MOTION_BIDS_ABOUT = ("_channels.tsv", "_channels.json", "_motion.json")
"""Endings of files that describe one: its columns, what their words mean, and its rate."""
BIDS_DESCRIPTION = "dataset_description.json"
"""File in which a data set says what it is."""
BIDS_FOLDER = re.compile(r"motion|(sub|ses)-.*")
"""Folders of a data set that have another of it above."""


def container_of(path: Path) -> Path | None:
    """The file of many trials that a path names, or of which it names a trial; None for other paths."""
    return next((one for one in (path.parent, path) if one.suffix.lower() in CONTAINERS and not one.is_dir()), None)


def file_on_disk(path: Path) -> Path:
    """The file in which a recording lies: its own, or the one that holds it among others."""
    return container_of(path) or path


def files_on_disk(path: Path) -> tuple[Path, ...]:
    """All files on which a recording depends: the one it lies in, and those that are there to describe it.

    Args:
        path: of the recording.
    """
    about = MOTION_BIDS_ABOUT if path.name.endswith(MOTION_BIDS) else ()
    return file_on_disk(path), *(one for ending in about for one in described_in(path, ending))


def recording_name(path: Path) -> str:
    """The name of a recording without its ending; that of a trial among others, ``S1.b3d/speed_1.2``, has none."""
    return path.stem if container_of(path) in (None, path) else path.name


def bids_subject(path: Path) -> str | None:
    """The person in the name of a recording of Motion-BIDS, ``sub-01``; None where its name says none."""
    parts = path.name.split("_") if path.name.endswith(MOTION_BIDS) else []
    return next((part for part in parts if part.startswith("sub-")), None)


def bids_places(folder: Path) -> list[Path]:
    """A folder and those above it, up to the root of its data set; itself alone where it is none of a person's."""
    places = [folder]
    while BIDS_FOLDER.fullmatch(places[-1].name):
        places.append(places[-1].parent)
    return places


def described_in(file: Path, ending: str) -> list[Path]:
    """Files with this ending that describe a recording of Motion-BIDS, the nearest first.

    They lie beside it or above it, up to the root of its data set, and have no entity in their name that it lacks.
    """
    own = set(file.name.split("_"))
    found = [
        sorted(
            one for one in place.glob("*") if f"_{one.name}".endswith(ending) and set(one.name.split("_")[:-1]) <= own
        )
        for place in bids_places(file.absolute().parent)
    ]
    return [one for some in found for one in sorted(some, key=lambda one: -len(one.name.split("_")))]


def is_derivative(folder: Path) -> bool:
    """Whether a folder is a data set of BIDS that was computed from another, as torchid writes one."""
    try:
        said = json.loads((folder / BIDS_DESCRIPTION).read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(said, dict) and said.get("DatasetType") == "derivative"


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, with a number behind those that stood there before."""
    found: dict[str, None] = {}
    for name in names:
        free = (f"{name}_{number}" for number in count(2))
        own = name if name not in found else next(one for one in free if one not in found and one not in names)
        found[own] = None
    return list(found)


class FileBytes:
    """A file's bytes, indexed like ``bytes`` but read from the file where they are asked for."""

    def __init__(self, path: Path) -> None:
        """Raises InputError: ``file.unreadable`` where the file is absent, forbidden or larger than 4 GiB."""
        self.path = path
        with _readable(path):
            self.size = path.stat().st_size
            if self.size > MAX_BYTES:
                raise InputError(
                    "file.unreadable", "the file is too large", source=path, found=f"{self.size} bytes",
                    remedy="Split the recording",
                )  # fmt: skip
            path.open("rb").close()

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, index: int) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> bytes: ...
    def __getitem__(self, index: int | slice) -> int | bytes:
        if isinstance(index, int):
            return self[index : index + 1][0]
        start, stop, _ = index.indices(self.size)
        with _readable(self.path), self.path.open("rb") as file:
            file.seek(start)
            found = file.read(max(0, stop - start))
        if len(found) < stop - start:
            raise InputError(
                "file.unreadable", "the file became shorter while it was read", source=self.path,
                found=f"{len(found)} of {stop - start} bytes", remedy="Wait until it is written, then start again",
            )  # fmt: skip
        return found


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(
            "file.unreadable", "the file cannot be read", source=path, found=error.strerror or str(error),
            remedy="Check the path and the permissions",
        ) from error  # fmt: skip


def read_bytes(path: Path) -> bytes:
    """All of the file's bytes; errors as ``FileBytes``."""
    return FileBytes(path)[:]


def read_lines(path: Path) -> list[str]:
    """Lines of a text file in UTF-8 with or without byte order mark; undecodable bytes become U+FFFD."""
    text = read_bytes(path).decode("utf-8-sig", "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
