"""Result files that appear together, and never in the place of a file that is not torchid's."""

import json
import logging
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from torchid.errors import InputError
from torchid.storage.files import file_sha256, flush_folder, write_json, writing

log = logging.getLogger(__name__)

CONFIGS = ("config.yaml", "config.resolved.yaml")
"""The config of a run goes by the second name where a file of the user's has the first. An old one is the first file
to go and a new one the last to come, so that it never stands beside results of another, not even in a cut publication.
"""


class Publication:
    """Moves what was written into ``state / "new"`` to ``out``, all of it or, after a later ``finish``, all of it.

    ``state / "files.json"`` lists the SHA-256 of every file that torchid put into ``out``. A file with other bytes, be
    it one of the list that was edited, is the user's: it is never overwritten and never removed. While files are being
    moved, ``state / "publishing.json"`` is the list that will be; ``finish`` takes a cut publication up from there.

    Args:
        out: the folder of the results.
        state: torchid's own folder on the same disk.
        beside: whether what earlier runs put into ``out`` stays there.
    """

    def __init__(self, out: Path, state: Path, beside: bool = False) -> None:
        self.out, self.new = out, state / "new"
        self._beside = beside
        self._list, self._pending = state / "files.json", state / "publishing.json"

    def owns(self, name: str) -> bool:
        """Whether ``name`` in ``out`` is free, or holds what torchid put there."""
        path = self.out / name
        if not os.path.lexists(path):
            return True
        known = {(_listed(file) or {}).get(name) for file in (self._list, self._pending)} - {None}
        with writing(path):
            return bool(known) and path.is_file() and not path.is_symlink() and file_sha256(path) in known

    def refuse_foreign(self, names: Iterable[str]) -> None:
        """Raises InputError ``results.foreign`` where one of ``names`` is taken by something that is not torchid's."""
        foreign = [name for name in sorted(names) if not self.owns(name)]
        if foreign:
            more = f" and {len(foreign) - 1} more" if foreign[1:] else ""
            raise InputError(
                "results.foreign", "stands where a result goes, and torchid did not write it or it was changed since",
                source=self.out / foreign[0], found=f"{foreign[0]}{more}", remedy="Move it, or choose another `out`.",
            )  # fmt: skip

    def publish(self) -> None:
        """Everything in ``new`` takes its place; what earlier runs put there and this one did not write is removed.

        Raises:
            InputError: ``results.foreign``, with nothing changed; ``results.unwritable``, for ``finish`` to go on from.
        """
        with writing(self.new):
            found = [path for path in sorted(self.new.rglob("*")) if path.is_file()]
            names = {path.relative_to(self.new).as_posix(): file_sha256(path) for path in found}
        self.refuse_foreign(names)
        if self._beside:
            names = {name: digest for name, digest in (_listed(self._list) or {}).items() if self.owns(name)} | names
        write_json(self._pending, names)
        self.finish()

    def finish(self) -> None:
        """Go on where a publication was cut, if one was; then ``new`` is empty. Errors as ``publish``."""
        pending = _listed(self._pending)
        if pending is not None:
            self.refuse_foreign(pending)
            with writing(self.out):
                self._take_away(pending)
                for name in sorted(pending, key=_order):
                    self._put(name)
                flush_folder(self.out)
                os.replace(self._pending, self._list)
                flush_folder(self._list.parent)
        with writing(self.new):
            self._pending.unlink(missing_ok=True)  # damaged, if it is still there
            if self.new.exists():
                shutil.rmtree(self.new)
            self.new.mkdir(parents=True)

    def drop(self) -> None:
        """Give up what is in ``new``, unless a cut publication needs it; what cannot go now goes with ``finish``."""
        if not self._pending.exists():
            shutil.rmtree(self.new, ignore_errors=True)

    def _take_away(self, pending: dict[str, str]) -> None:
        """What earlier runs put there, but for what this publication has already put in its place."""
        for name in sorted(_listed(self._list) or (), key=_order, reverse=True):
            if (name not in pending or (self.new / name).exists()) and self.owns(name):
                (self.out / name).unlink(missing_ok=True)
                if name not in pending:
                    log.info("removed %s of an earlier run", name)

    def _put(self, name: str) -> None:
        if (self.new / name).exists():
            (self.out / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(self.new / name, self.out / name)


def _order(name: str) -> tuple[bool, str]:
    return name in CONFIGS, name


def _listed(file: Path) -> dict[str, str] | None:
    """A list of files; a damaged one is as good as none, for then nothing is torchid's."""
    if not file.exists():
        return None
    try:
        with writing(file):
            names = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        return None
    sound = isinstance(names, dict) and all(isinstance(digest, str) for digest in names.values())
    return names if sound else None
