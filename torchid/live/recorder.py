"""What a stream brought, on the disk at once, as a recording like any other: a TRC, and a MOT for the plates."""

import os
from pathlib import Path
from types import TracebackType

import numpy as np

from torchid.errors import InputError
from torchid.files import NewFile, writing
from torchid.live.intake import Placed
from torchid.recording import Plate

FLUSH_S = 0.5
"""Choice. What a dead machine may cost at most; a dead process costs nothing that was written."""
CHANNELS = ("vx", "vy", "vz", "px", "py", "pz", "mx", "my", "mz")


class Recorder:
    """``with Recorder(folder, ...) as recorder:`` makes ``live.trc`` and ``live.mot`` and appends to them.

    Rows are whole lines, so that a file whose writer was killed reads up to its last whole row. Lost frames are rows
    that are missing, which reading turns into gaps. Vertical is Z, which a config says by ``up: z``. Plates are written
    by force and moment about the origin, so that nothing is lost near zero load; their corners have no place in a MOT.

    Raises:
        InputError: ``live.recorded`` where there is such a recording already: nothing is overwritten;
            ``results.unwritable``.
    """

    def __init__(
        self, folder: Path, labels: tuple[str, ...], rate_hz: float, plates: tuple[Plate, ...], force_rate_hz: float
    ) -> None:
        self.markers, self.forces = folder / "live.trc", folder / "live.mot"
        self._rate, self._force_rate, self._flushed_s, self._row = rate_hz, force_rate_hz, 0.0, 0
        there = [path for path in (self.markers, self.forces) if path.exists()]
        if there:
            raise InputError(
                "live.recorded", "there is a recording already, which is not overwritten", source=there[0],
                found=", ".join(path.name for path in there), remedy="Give --record another folder",
            )  # fmt: skip
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        self._trc = _new(self.markers, _trc_head(labels, rate_hz))
        self._mot = _new(self.forces, _mot_head(len(plates))) if plates else None
        self._sample = -1

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._flush()
        for file in self._files:
            file.close()

    def add(self, placed: Placed) -> None:
        """Append what was new in a packet.

        Frames that come after their successors would break the order of rows; they are left out.

        Raises:
            InputError: ``results.unwritable``.
        """
        lines = []
        for index, frame in zip(placed.index.tolist(), placed.markers.position.numpy(), strict=True):
            if index >= self._row:
                self._row = index + 1
                cells = ("" if x != x else f"{x:.7g}" for x in frame.ravel().tolist())
                lines.append("\t".join([str(index + 1), f"{index / self._rate:.10g}", *cells]) + "\n")
        with writing(self.markers):
            _append(self._trc, "".join(lines))
        if self._mot is not None:
            with writing(self.forces):
                _append(self._mot, "".join(self._samples(placed)))
        now = self._row / self._rate
        if now - self._flushed_s > FLUSH_S:
            self._flushed_s = now
            self._flush()

    @property
    def _files(self) -> list[NewFile]:
        return [file for file in (self._trc, self._mot) if file is not None]

    def _flush(self) -> None:
        with writing(self.markers.parent):
            for file in self._files:
                os.fsync(file.fileno())

    def _samples(self, placed: Placed) -> list[str]:
        """Rows of the samples that are newer than the newest written."""
        rows = []
        for index, wrench in zip(placed.sample.tolist(), placed.wrench.numpy(), strict=True):
            if index > self._sample:
                self._sample = index
                flat = np.concatenate([np.insert(w, 3, (0.0, 0.0, 0.0)) for w in wrench]).tolist()
                rows.append("\t".join([f"{index / self._force_rate:.10g}", *(f"{x:.7g}" for x in flat)]) + "\n")
        return rows


def _new(path: Path, head: str) -> NewFile:
    with writing(path):
        file = NewFile(path)
        _append(file, head)
    return file


def _append(file: NewFile, text: str) -> None:
    content = memoryview(text.encode("utf-8", "replace"))
    while content:
        content = content[file.write(content) :]


def _trc_head(labels: tuple[str, ...], rate_hz: float) -> str:
    keys = ("DataRate", "CameraRate", "NumMarkers", "Units", "OrigDataRate")
    facts = (f"{rate_hz:.10g}", f"{rate_hz:.10g}", str(len(labels)), "m", f"{rate_hz:.10g}")
    axes = "\t".join(f"{axis}{k + 1}" for k in range(len(labels)) for axis in "XYZ")
    lines = ["PathFileType\t4\t(X/Y/Z)\tlive.trc", "\t".join(keys), "\t".join(facts)]
    return "\n".join([*lines, "Frame#\tTime\t" + "\t\t\t".join(labels) + "\t\t", f"\t\t{axes}", "", ""])


def _mot_head(plates: int) -> str:
    names = [f"ground_force_{k + 1}_{channel}" for k in range(plates) for channel in CHANNELS]
    head = ["live", "version=1", f"nColumns={len(names) + 1}", "inDegrees=no", "endheader", "\t".join(["time", *names])]
    return "\n".join(head) + "\n"
