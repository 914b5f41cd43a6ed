"""The folder that a run writes: one run at a time, whole files, stages that a later run takes up again."""

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from filelock import FileLock, Timeout
from torch import Tensor

from torchid.errors import DataError, InputError
from torchid.storage.files import TEMPORARY, atomic_write, nameless_file, safe_name, unwritable, write_text, writing
from torchid.storage.provenance import StageTime, Stopwatch
from torchid.storage.publication import Publication
from torchid.storage.snapshot import SnapshotError, load_snapshot, make_room, release, swap_out, write_snapshot

log = logging.getLogger(__name__)
Result = TypeVar("Result")

STATE = ".torchid"
"""Folder inside ``out`` for the lock, the stages, the list of files and what is not yet in its place."""


class OutputFolder:
    """``with OutputFolder(out) as folder:`` creates and locks ``out`` for this run.

    The lock is the operating system's, so that a killed run leaves none behind. Result files are written aside and
    appear together when the block ends well or with a DataError; those of an earlier run go then, and stay where the
    block ends otherwise. With ``beside`` they stay in any case: what is written then is no part of a run. What a killed
    run left is finished or swept when the next one begins.

    Raises:
        InputError: ``results.locked`` when another run works there, ``results.unwritable`` when nobody can,
            ``results.foreign`` when the block ends and a file of the user's stands where a result goes.
    """

    def __init__(self, out: str | Path, beside: bool = False) -> None:
        self.out = Path(out).resolve()
        self.state = self.out / STATE
        self.times: dict[str, StageTime] = {}
        self._publication = Publication(self.out, self.state, beside)
        self._lock = FileLock(self.state / "lock", timeout=0)

    def __enter__(self) -> "OutputFolder":
        try:
            (self.state / "stages").mkdir(parents=True, exist_ok=True)
            self._lock.acquire()
        except Timeout as error:
            raise InputError(
                "results.locked", "another run is writing here", source=self.out, found=f"process {self._owner()}",
                remedy="Wait for it, or choose another `out`.",
            ) from error  # fmt: skip
        except OSError as error:
            raise unwritable(self.out, error) from error
        try:
            self._sweep()
            self._publication.finish()
            write_text(self.state / "pid", str(os.getpid()))
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None or isinstance(error, DataError):
                self._publication.publish()
        finally:
            try:
                self._publication.drop()
            finally:
                self._lock.release()

    @property
    def staging(self) -> Path:
        """The folder whose content appears in ``out`` when the block ends well."""
        return self._publication.new

    def owns(self, name: str) -> bool:
        """Whether a result ``name`` would take the place of nothing, or of what torchid itself put there."""
        return self._publication.owns(name)

    def claim(self, names: Iterable[str]) -> None:
        """Make sure that results of these names can be put into ``out``; InputError ``results.foreign`` if not."""
        self._publication.refuse_foreign(names)

    def path(self, name: str) -> Path:
        """Where to write the result file ``name``; it appears in ``out`` when the block ends.

        Raises:
            InputError: ``results.outside`` when the name leaves the folder (use ``safe_name`` for names from data),
                ``results.unwritable``.
        """
        path = (self.out / name).resolve()
        if path == self.out or not path.is_relative_to(self.out) or path.is_relative_to(self.state):
            raise InputError(
                "results.outside", "a result must stay below `out`", source=self.out, found=name[:80],
                remedy="Rename the trial: its name becomes that of a file",
            )  # fmt: skip
        aside = self.staging / path.relative_to(self.out)
        with writing(aside):
            aside.parent.mkdir(parents=True, exist_ok=True)
        return aside

    def stage(self, name: str, key: str, compute: Callable[[], Result]) -> Result:
        """The stage's result: the stored one if its ``key`` is the same, else computed and stored.

        The result is anything that ``torchid.storage.snapshot`` holds; its tensors stay in the file and are not to be
        changed in place. ``times`` tells its cost and whether it was reused.
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

    def stored(self, name: str, key: str) -> Any | None:
        """The stored result of a stage, None where there is none of this ``key``."""
        found = _read_stage(self.state / "stages" / f"{safe_name(name)}.snapshot", key)
        return None if found is None else found["result"]

    def aside(self, value: Result) -> Result:
        """The same value, its tensors in a file of this run: for what is as long as a recording.

        Raises:
            InputError: ``results.unwritable``.
        """
        try:
            with writing(self.staging), nameless_file(self.staging) as file:
                return swap_out(value, file)
        finally:
            release()

    def room(self, shape: Sequence[int]) -> Tensor:
        """Zeros of a shape, to be filled in place, in a file of this run.

        Raises:
            InputError: ``results.unwritable``.
        """
        with writing(self.staging), nameless_file(self.staging) as file:
            return make_room(file, shape)

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

    def _sweep(self) -> None:
        """Remove what killed runs left half written."""
        with writing(self.state):
            for folder in (self.state, self.state / "stages"):
                for path in folder.glob(TEMPORARY):
                    path.unlink(missing_ok=True)


def _read_stage(file: Path, key: str) -> dict[str, Any] | None:
    try:
        stored = load_snapshot(file)
    except FileNotFoundError:
        return None
    except (OSError, SnapshotError) as error:
        log.warning("stage %s is computed again: %s", file.stem, error)
        return None
    return stored if isinstance(stored, dict) and stored.get("key") == key else None
