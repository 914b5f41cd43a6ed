"""The n-th call that writes below a folder fails, as on a full disk."""

import errno
import os
from collections.abc import Callable
from multiprocessing import Value
from pathlib import Path
from typing import Any

from torchid.storage import files

NAMED = ("open", "replace", "mkdir", "unlink")
"""Functions of ``os`` whose first argument is the path."""
IDLE = {"mkdir": True, "unlink": False}
"""Those that write nothing, and are not counted, where the path is there already (or is not)."""


class Calls:
    """Counts the calls by which torchid writes below ``folder``; one of them fails.

    Counted are every opening, write and flush of a file, every name given or taken, and every folder made. The count is
    shared with the process that forked this one.
    """

    def __init__(self) -> None:
        self._count = Value("i", 0)

    @property
    def count(self) -> int:
        """Of the process that was watched last."""
        return self._count.value

    def watch(self, folder: Path, failing: int | None) -> None:
        """From now on: call number ``failing`` (from one) ends with ENOSPC. For a forked process, as it stays so."""
        self._count.value = 0

        def next_call(path: object) -> None:
            if Path(os.fsdecode(path)).is_relative_to(folder):  # type: ignore[arg-type]
                self._count.value += 1
                if self._count.value == failing:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

        for name in NAMED:
            setattr(os, name, _watched(getattr(os, name), next_call, IDLE.get(name)))
        os.fsync = _watched(os.fsync, lambda descriptor: next_call(_path_of(descriptor)))
        real_init, real_write = files.NewFile.__init__, files.NewFile.write

        def init(self: Any, path: Path) -> None:
            next_call(path)
            real_init(self, path)

        def write(self: Any, content: Any) -> int:
            next_call(self.name)
            return real_write(self, content)

        files.NewFile.__init__, files.NewFile.write = init, write  # type: ignore[method-assign]


def _watched(
    real: Callable[..., Any], before: Callable[[Any], None], idle_if_there: bool | None = None
) -> Callable[..., Any]:
    def call(first: Any, *args: Any, **kwargs: Any) -> Any:
        aside = "dir_fd" in kwargs  # relative to another folder: the sweeping of what nobody needs any more
        if not aside and (idle_if_there is None or os.path.lexists(first) != idle_if_there):
            before(first)
        return real(first, *args, **kwargs)

    return call


def _path_of(descriptor: int) -> str:
    return os.readlink(f"/proc/self/fd/{descriptor}")
