"""Which files of a list or of a folder tree are recordings, and which forces belong to which markers."""

import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from torchid.errors import InputError
from torchid.io.b3d_header import read_header
from torchid.io.files import CONTAINERS, MOTION_BIDS, container_of, is_derivative, recording_name

MARKER_SUFFIXES = (".c3d", ".trc")
FORCE_SUFFIXES = (".mot", ".sto")
TEXT = (".trc", ".tsv")
"""Of them and of Motion-BIDS, those without forces of their own."""
KIND = re.compile(r"(grfs?|forces?|marker(s|data)?|trc|mot|kinetics)", re.IGNORECASE)
"""Words of a file's name that say what is in it, not which trial."""
TRACKING = re.compile(r"_tracksys-[^_]*|_motion$")
"""Parts of a name of Motion-BIDS that say with what was measured."""
FORCE_COLUMN = re.compile(r"force|(^|_)[vf][xyz]\d*$", re.IGNORECASE)
SAME_S = 0.02
"""Choice. Times by which beginnings and ends of one trial's files may differ: two frames at 100 Hz [s]."""
TRC_HEAD = "Frame#"
"""Word from which on a TRC has its columns."""
HEAD = 16384
"""Bytes at the start of a file in which its columns are named."""


def pair_files(files: list[Path]) -> list[tuple[Path, Path | None]]:
    """Each marker file with the force file that follows it, as in ``squat.trc squat_grf.mot``.

    A folder, or a file of many trials, stands for all recordings in it (``find_recordings``).

    Raises:
        InputError: ``check.order`` for a force file without markers before it, ``check.kind`` for anything else,
            ``check.empty`` for a folder without recordings.
    """
    pairs: list[tuple[Path, Path | None]] = []
    for before, file in zip([None, *files], files, strict=False):
        forces = file.suffix.lower() in FORCE_SUFFIXES and not container_of(file)
        if file.is_dir() or (container_of(file) == file and file.exists()):
            pairs += find_recordings(file)
        elif not forces and is_recording(file):
            pairs.append((file, None))
        elif forces and pairs and pairs[-1] == (before, None):
            pairs[-1] = (pairs[-1][0], file)
        elif forces:
            raise InputError(
                "check.order", "forces without markers", source=file,
                remedy="Name the recording before it (walk.trc, S1.b3d/walk), not a whole folder or .b3d file",
            )  # fmt: skip
        else:
            known = ", ".join(
                (*MARKER_SUFFIXES, MOTION_BIDS, *CONTAINERS, *FORCE_SUFFIXES, "a config (.yaml, .yml, .json), a folder")
            )
            raise InputError("check.kind", "not a known kind of file", source=file, remedy=f"Known: {known}.")
    return pairs


def find_recordings(folder: Path) -> list[tuple[Path, Path | None]]:
    """All marker files below a folder, each text file with the forces that its name and place give it.

    Text files are TRC and Motion-BIDS. A file of many trials (``torchid.io.files.CONTAINERS``) is a folder of them.

    A force file belongs to a TRC where both names are equal but for words such as ``grf``; it lies in the same folder,
    or in one beside it or below it that holds no markers itself (``MarkerData/walk.trc``, ``ForceData/walk_grf.mot``).
    Of those that are left over, a TRC and a force file belong together that begin and end at the same time, where no
    other does.

    Raises:
        InputError: ``check.empty``.
    """
    files = sorted(visible_files(folder))
    markers = [one for file in files for one in _recordings_in(file)]
    forces = [file for file in files if file.suffix.lower() in FORCE_SUFFIXES and _has_forces(file)]
    if not markers:
        raise InputError(
            "check.empty",
            "no recordings in this folder",
            source=folder,
            remedy="Name a folder with C3D, TRC, B3D or _motion.tsv files",
        )
    inhabited = {file.parent for file in markers}
    by_name = {file: _forces_of(file, forces, inhabited) for file in markers if file.suffix.lower() in TEXT}
    lone = [file for file, own in by_name.items() if own is None]
    by_time = _same_time(lone, [file for file in forces if file not in by_name.values()]) if lone else {}
    return [(file, by_name.get(file) or by_time.get(file)) for file in markers]


def is_recording(file: Path) -> bool:
    """Whether a path names a recording, of markers or of forces, or a file of many."""
    return _is_markers(file) or container_of(file) is not None or file.suffix.lower() in FORCE_SUFFIXES


def _is_markers(file: Path) -> bool:
    """Whether a file's name says that it holds markers of one trial."""
    return file.suffix.lower() in MARKER_SUFFIXES or file.name.endswith(MOTION_BIDS)


def _recordings_in(file: Path) -> list[Path]:
    """A marker file itself, or the trials that a file holds; reading one that holds none will tell why."""
    if container_of(file) != file:
        return [file] if _is_markers(file) else []
    try:
        return [file / trial.name for trial in read_header(file).trials]
    except InputError:
        return [file]


def shares_name(markers: Path, forces: Path) -> bool:
    """Whether names say that two files are of one trial.

    Args:
        markers: of a TRC.
        forces: of a MOT or STO.
    """
    return _trial(markers) == _trial(forces)


def _same_time(markers: list[Path], forces: list[Path]) -> dict[Path, Path]:
    """Pairs that begin and end at the same time, where that is told of one file on either side alone."""
    spans = {file: span for file in (*markers, *forces) if (span := _span(file)) is not None}
    alike = [
        (one, other) for one in markers for other in forces
        if one in spans and other in spans
        and all(abs(a - b) <= SAME_S for a, b in zip(spans[one], spans[other], strict=True))
    ]  # fmt: skip
    counts = Counter(file for pair in alike for file in pair)
    return {one: other for one, other in alike if counts[one] == counts[other] == 1}


def _span(file: Path) -> tuple[float, float] | None:
    """First and last time of a table of markers or forces; None where its rows do not tell."""
    column, head = (1, TRC_HEAD) if file.suffix.lower() == ".trc" else (0, "endheader")
    try:
        _, _, body = file.read_text(encoding="utf-8", errors="replace").partition(head)
        rows = [row for line in body.splitlines() if (row := line.split()) and row[0][0] in "+-.0123456789"]
        return (float(rows[0][column]), float(rows[-1][column]))
    except (OSError, ValueError, IndexError):
        return None


def unpaired_forces(folder: Path, pairs: Sequence[tuple[Path, Path | None]]) -> list[Path]:
    """The files of forces below a folder that belong to no markers by name and place.

    Args:
        folder: in which ``find_recordings`` looked.
        pairs: that it found.
    """
    taken = {forces for _, forces in pairs}
    files = (file for file in sorted(visible_files(folder)) if file.suffix.lower() in FORCE_SUFFIXES)
    return [file for file in files if file not in taken and _has_forces(file)]


def visible_files(folder: Path) -> Iterator[Path]:
    """Files below the folder, but for hidden ones, those in hidden folders and in results of BIDS; a file itself."""
    if folder.is_file():
        yield folder
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".") and not is_derivative(Path(place, name))]
        yield from (Path(place, name) for name in names if not name.startswith("."))


def _has_forces(file: Path) -> bool:
    """Whether the columns of a MOT or STO are forces, and not the coordinates of a motion."""
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD).decode("utf-8", "replace")
    except OSError:
        return True  # Reading it will tell why not.
    _, _, behind = head.lower().partition("endheader")
    columns = behind.partition("\n")[2].strip("\r\n").split("\n")[0].split()
    return any(FORCE_COLUMN.search(column) for column in columns)


def trial_name(file: Path) -> str:
    """The part of a file's name that says which trial it is: empty for ``markers.trc`` and ``grf.mot``."""
    stem = recording_name(file)
    stem = TRACKING.sub("", stem) if file.name.endswith(MOTION_BIDS) else stem
    parts = re.split(r"([\s_\-.]+)", stem)  # words and what stands between them
    kept = [k for k in range(0, len(parts), 2) if parts[k] and not KIND.fullmatch(parts[k])]
    return "".join((parts[k - 1] if n else "") + parts[k] for n, k in enumerate(kept))


def _trial(file: Path) -> str:
    """The same, as names are compared."""
    return re.sub(r"[\s_\-.]+", " ", trial_name(file)).casefold()


def _forces_of(markers: Path, forces: list[Path], inhabited: set[Path]) -> Path | None:
    """The force file of the same trial that is nearest: in the folder, in one below it, in one beside it."""
    trial, home = _trial(markers), markers.parent
    same = [file for file in forces if _trial(file) == trial]
    here = [file for file in same if file.parent == home]
    apart = [file for file in same if trial and file.parent not in inhabited]
    below = [file for file in apart if file.parent.parent == home]
    beside = [file for file in apart if file.parent.parent == home.parent]
    return next(iter([*here, *below, *beside]), None)
