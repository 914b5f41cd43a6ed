"""The folder that a run writes: one run at a time, whole files, stages that a later run takes up again."""

import json
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from filelock import FileLock, Timeout

from torchid.errors import DataError, InputError
from torchid.files import atomic_write, safe_name, unwritable, write_json, write_text
from torchid.provenance import StageTime, Stopwatch
from torchid.snapshot import SnapshotError, load_snapshot, release, swap_out, write_snapshot

log = logging.getLogger(__name__)
Result = TypeVar("Result")

STATE = ".torchid"
"""Folder inside ``out`` for the lock, the stages and the list of files."""


class OutputFolder:
    """``with OutputFolder(out) as folder:`` creates and locks ``out`` for this run.

    The lock is the operating system's, so that a killed run leaves none behind. Files of an earlier run that this one
    did not write again are removed when the block ends well or with a DataError: nothing stale beside new results.

    Raises:
        InputError: ``results.locked`` when another run works there, ``results.unwritable`` when nobody can.
    """

    def __init__(self, out: str | Path) -> None:
        self.out = Path(out).resolve()
        self.state = self.out / STATE
        self.times: dict[str, StageTime] = {}
        self._written: set[str] = set()
        self._lock = FileLock(self.state / "lock", timeout=0)

    def __enter__(self) -> "OutputFolder":
        try:
            (self.state / "stages").mkdir(parents=True, exist_ok=True)
            self._lock.acquire()
        except Timeout as error:
            raise InputError(
                "results.locked",
                "another run is writing here",
                source=self.out,
                found=f"process {self._owner()}",
                remedy="Wait for it, or choose another `out`.",
            ) from error
        except OSError as error:
            raise unwritable(self.out, error) from error
        try:
            write_text(self.state / "pid", str(os.getpid()))
        except InputError:
            self._lock.release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None or isinstance(error, DataError):
                self._remove_stale()
            else:
                self._list_files(self._written | set(self._listed()))
        finally:
            self._lock.release()

    def path(self, name: str) -> Path:
        """Where the result file ``name`` goes; it counts as written by this run.

        Raises:
            InputError: ``results.outside`` when the name leaves the folder (use ``safe_name`` for names from data).
        """
        path = (self.out / name).resolve()
        if path == self.out or not path.is_relative_to(self.out) or path.is_relative_to(self.state):
            raise InputError(
                "results.outside", "a result must stay below `out`", source=self.out, found=name[:80],
                remedy="Rename the trial: its name becomes that of a file",
            )  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        self._written.add(path.relative_to(self.out).as_posix())
        return path

    def stage(self, name: str, key: str, compute: Callable[[], Result]) -> Result:
        """The stage's result: the stored one if its ``key`` is the same, else computed and stored.

        The result is anything that ``torchid.snapshot`` holds; its tensors stay in the file and are not to be changed
        in place. ``times`` tells its cost and whether it was reused.
        """
        file = self.state / "stages" / f"{safe_name(name)}.snapshot"
        stored = _read_stage(file, key)
        if stored is not None:
            clock, processors = stored["seconds"]
            self.times[name] = StageTime(clock, processors, True, key)
            return stored["result"]
        watch = Stopwatch()
        result = compute()
        seconds = watch.seconds()
        with atomic_write(file) as target:
            write_snapshot(target, {"key": key, "seconds": seconds, "result": result})
        self.times[name] = StageTime(*seconds, False, key)
        del result
        release()
        return load_snapshot(file)["result"]

    def aside(self, value: Result) -> Result:
        """The same value, its tensors in a file of this run: for what is as long as a recording.

        Raises:
            InputError: ``results.unwritable``.
        """
        try:
            return swap_out(value, self.state)
        except OSError as error:
            raise unwritable(self.out, error) from error
        finally:
            release()

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Puts the cost of the block into ``times``, as that of a stage whose result is not stored."""
        watch = Stopwatch()
        yield
        self.times[name] = StageTime(*watch.seconds(), False, "")

    def _owner(self) -> str:
        try:
            return (self.state / "pid").read_text()
        except OSError:
            return "unknown"

    def _listed(self) -> list[str]:
        """Files of earlier runs; a damaged list is as good as none, for it only serves to tidy up."""
        try:
            names = json.loads((self.state / "files.json").read_text())
        except (OSError, ValueError):
            return []
        return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []

    def _list_files(self, names: Iterable[str]) -> None:
        write_json(self.state / "files.json", sorted(names))

    def _remove_stale(self) -> None:
        for name in set(self._listed()) - self._written:
            path = (self.out / name).resolve()
            if path.is_relative_to(self.out) and not path.is_relative_to(self.state):
                path.unlink(missing_ok=True)
                log.info("removed %s of an earlier run", name)
        self._list_files(self._written)


def _read_stage(file: Path, key: str) -> dict[str, Any] | None:
    try:
        stored = load_snapshot(file)
    except FileNotFoundError:
        return None
    except (OSError, SnapshotError) as error:
        log.warning("stage %s is computed again: %s", file.stem, error)
        return None
    return stored if isinstance(stored, dict) and stored.get("key") == key else None
