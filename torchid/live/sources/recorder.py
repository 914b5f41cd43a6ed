"""What a stream brought, on the disk at once, as a recording like any other: a TRC, and a MOT for the plates."""

import logging
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from torchid.errors import InputError
from torchid.live.sources.intake import PlacedPacket
from torchid.recording import Plate
from torchid.storage.files import NewFile, writing

log = logging.getLogger(__name__)
FLUSH_S = 0.5
"""Choice. What a dead machine may cost at most; a dead process costs nothing that was written."""
CHANNELS = ("vx", "vy", "vz", "px", "py", "pz", "mx", "my", "mz")


class Recorder:
    """``with Recorder(folder, ...) as recorder:`` makes ``live.trc`` and ``live.mot`` and appends to them.

    Rows are whole lines, so that a file whose writer was killed reads up to its last whole row. Lost frames are rows
    that are missing, which reading turns into gaps. Vertical is Z, which a config says by ``up: z``. Plates are written
    by force and moment about the origin, so that nothing is lost near zero load; their corners have no place in a MOT.

    Once the files are there, no fault of the disk reaches the caller: whoever moves is not asked to do it again for the
    sake of a copy. The recording ends at its last whole row, a warning says so once, and ``fault`` has the reason.

    Raises:
        InputError: ``live.recorded`` where there is such a recording already: nothing is overwritten;
            ``results.unwritable`` where the files cannot be made.
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
        self.fault: str | None = None
        """Why nothing more is recorded, as the system has it."""

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(self, placed: PlacedPacket) -> None:
        """Append what was new in a packet, unless the recording has ended.

        Frames that come after their successors would break the order of rows; they are left out.
        """
        if self.fault is not None:
            return
        try:
            self._write(placed)
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """End the recording; what was written is on the disk when this returns, or ``fault`` says why not."""
        try:
            self._flush()
        except OSError as error:
            self._give_up(error)
        for file in self._files:
            with suppress(OSError):  # of a network's disk; its reason came with the flush
                file.close()

    @property
    def table(self) -> dict[str, Any]:
        """Return until when both files go and why no longer, by the keys of the line ``torchid live`` prints."""
        return {"until_s": round(self._row / self._rate, 2), "fault": self.fault}

    def _write(self, placed: PlacedPacket) -> None:
        lines, row = [], self._row
        for index, frame in zip(placed.index.tolist(), placed.markers.position.numpy(), strict=True):
            if index >= row:
                row = index + 1
                cells = ("" if x != x else f"{x:.7g}" for x in frame.ravel().tolist())
                lines.append("\t".join([str(index + 1), f"{index / self._rate:.10g}", *cells]) + "\n")
        _append(self._trc, "".join(lines))
        if self._mot is not None:
            _append(self._mot, "".join(self._samples(placed)))
        self._row = row
        now = self._row / self._rate
        if now - self._flushed_s > FLUSH_S:
            self._flushed_s = now
            self._flush()

    def _give_up(self, error: OSError) -> None:
        if self.fault is None:
            self.fault = error.strerror or str(error)
            log.warning(
                "the recording has ended at %.2f s (%s); the stream goes on without it",
                self._row / self._rate, self.fault,
            )  # fmt: skip

    @property
    def _files(self) -> list[NewFile]:
        return [file for file in (self._trc, self._mot) if file is not None]

    def _flush(self) -> None:
        for file in self._files:
            if not file.closed:
                os.fsync(file.fileno())

    def _samples(self, placed: PlacedPacket) -> list[str]:
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
    """Write whole lines, or none of them: a row that is cut in a number reads as another number."""
    content, end = memoryview(text.encode("utf-8", "replace")), file.tell()
    try:
        while content:
            content = content[file.write(content) :]
    except OSError:
        with suppress(OSError):  # the fault itself is what is said
            file.truncate(end)
        raise


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
