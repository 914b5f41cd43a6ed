"""Header and parameters of a C3D file: a bounded walk that never reads or allocates more than the file holds.

Format: the C3D file format user guide (c3d.org), chapters "The header section" and "The parameter section".
"""

import math
import struct
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

import numpy as np

from torchid.errors import InputError, Note
from torchid.io.files import FileBytes

BLOCK = 512
MAX_LEADING_ZEROS = 512
SIGNATURE = 0x50


class Processor(IntEnum):
    """How numbers are stored: the byte 83 + n of the parameter section."""

    INTEL = 84
    DEC = 85
    MIPS = 86

    @property
    def order(self) -> str:
        """Byte order of integers for numpy and struct."""
        return ">" if self is Processor.MIPS else "<"

    def floats(self, raw: bytes | memoryview) -> np.ndarray:
        """Four-byte reals of this processor as float32, flat.

        A DEC real has its two words swapped and an exponent larger by two (VAX F_floating).
        """
        if self is not Processor.DEC:
            return np.frombuffer(raw, self.order + "f4").astype(np.float32)
        words = np.frombuffer(raw, "<u2").reshape(-1, 2)[:, ::-1]
        with np.errstate(invalid="ignore"):
            return np.ascontiguousarray(words).view("<f4").ravel() / np.float32(4.0)


@dataclass(frozen=True)
class C3dParameter:
    """One parameter as stored: ``kind`` -1 characters, 1 bytes, 2 integers, 4 reals."""

    kind: int
    dims: tuple[int, ...]
    raw: bytes
    processor: Processor

    def numbers(self, unsigned: bool = False) -> np.ndarray:
        """Values as float64 in stored (first index fastest) order; empty for characters."""
        if self.kind == 1:
            return np.frombuffer(self.raw, np.uint8).astype(float)
        if self.kind == 2:
            return np.frombuffer(self.raw, self.processor.order + ("u2" if unsigned else "i2")).astype(float)
        with np.errstate(invalid="ignore"):
            return self.processor.floats(self.raw).astype(float) if self.kind == 4 else np.zeros(0)

    def strings(self) -> list[str]:
        """Texts, one per column, without trailing blanks; undecodable bytes become U+FFFD."""
        if self.kind != -1:
            return []
        width = self.dims[0] if self.dims else 1
        if width == 0:
            return [""] * min(math.prod(self.dims[1:]), 255)
        cells = [self.raw[k : k + width] for k in range(0, len(self.raw), width)]
        return [cell.decode("utf-8", "replace").replace("\0", " ").strip() for cell in cells]


@dataclass(frozen=True)
class C3dHeader:
    """What the first sections of a C3D file state, not yet checked against the size of its data."""

    source: str
    processor: Processor
    start: int
    """Bytes before the file proper (some systems wrote leading zeros)."""
    points: int
    analog_per_frame: int
    first_frame: int
    last_frame: int
    scale: float
    data_block: int
    ratio: int
    """Analog samples per video frame."""
    rate: float
    groups: dict[str, dict[str, C3dParameter]]
    notes: tuple[Note, ...] = field(default=())

    def find(self, group: str, name: str) -> C3dParameter | None:
        """A parameter, or None."""
        return self.groups.get(group, {}).get(name)

    def numbers(self, group: str, name: str, unsigned: bool = False) -> np.ndarray:
        """Values of a parameter and of its continuations NAME2, NAME3, ...; empty where absent."""
        parts = [p.numbers(unsigned) for p in self._continued(group, name)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def strings(self, group: str, name: str) -> list[str]:
        """Texts of a parameter and of its continuations NAME2, NAME3, ...; empty where absent."""
        return [text for p in self._continued(group, name) for text in p.strings()]

    def number(self, group: str, name: str) -> float | None:
        """First value of a parameter (integers unsigned), None where absent, empty or not finite."""
        values = self.numbers(group, name, unsigned=True)
        return float(values[0]) if len(values) and np.isfinite(values[0]) else None

    def spelled(self, group: str, name: str) -> str:
        """First value of a parameter (integers unsigned) as messages show it, NaN too."""
        values = self.numbers(group, name, unsigned=True)
        return f"{values[0]:g}" if len(values) else "absent"

    def _continued(self, group: str, name: str) -> list[C3dParameter]:
        found, k = [], 1
        while (parameter := self.find(group, name if k == 1 else f"{name}{k}")) is not None:
            found.append(parameter)
            k += 1
        return found


def read_header(data: bytes | FileBytes, source: str | Path) -> C3dHeader:
    """Header and parameters of the bytes of a C3D file.

    Raises:
        InputError: ``c3d.signature`` where it is no C3D file, ``c3d.truncated`` where these sections are cut off,
            ``c3d.processor`` where the number format is unknown.
    """
    notes: list[Note] = []
    start = _start(data, source, notes)
    parameters = start + (data[start] - 1) * BLOCK
    if parameters < start or parameters + 4 > len(data):
        raise _truncated(source, f"the parameter section starts at byte {parameters}", len(data))
    if data[parameters + 3] not in list(Processor):
        raise InputError(
            "c3d.processor", "the number format of the file is unknown", source=source, place=f"byte {parameters + 3}",
            found=str(data[parameters + 3]),
            remedy="Export the file again; 84, 85 and 86 (Intel, DEC, MIPS) are defined",
        )  # fmt: skip
    processor = Processor(data[parameters + 3])
    words = struct.unpack(processor.order + "10H", data[start : start + 20])
    scale, rate = processor.floats(data[start + 12 : start + 16])[0], processor.floats(data[start + 20 : start + 24])[0]
    stated = data[parameters + 2] * BLOCK
    end = max(parameters + stated, start + (words[8] - 1) * BLOCK)
    groups = _walk(data[parameters : min(end, len(data))], processor, end > len(data), stated, source, notes)
    return C3dHeader(
        source=str(source),
        processor=processor,
        start=start,
        points=words[1],
        analog_per_frame=words[2],
        first_frame=words[3],
        last_frame=words[4],
        scale=float(scale),
        data_block=words[8],
        ratio=words[9],
        rate=float(rate),
        groups=groups,
        notes=tuple(notes),
    )


def _start(data: bytes | FileBytes, source: str | Path, notes: list[Note]) -> int:
    """Where the file proper begins; refuses what is no C3D."""
    zeros = len(data[: MAX_LEADING_ZEROS + 1]) - len(data[: MAX_LEADING_ZEROS + 1].lstrip(b"\0"))
    for start in (0, zeros):
        if len(data) >= start + 2 * BLOCK and data[start] > 1 and data[start + 1] == SIGNATURE:
            if start:
                notes.append(Note("c3d.leading_zeros", f"{start} zero bytes before the header skipped", str(source)))
            return start
    raise InputError(
        "c3d.signature", "this is no C3D file", source=source, place="byte 1",
        found=f"{len(data)} bytes beginning with {bytes(data[:8])!r}",
        remedy="Give a .c3d file as the recording system exported it",
    )  # fmt: skip


def _truncated(source: str | Path, where: str, size: int) -> InputError:
    return InputError(
        "c3d.truncated", "the file ends within its header or parameters", source=source, place=where,
        found=f"{size} bytes", remedy="Copy or export the file again",
    )  # fmt: skip


def _walk(
    section: bytes, processor: Processor, cut: bool, stated: int, source: str | Path, notes: list[Note]
) -> dict[str, dict[str, C3dParameter]]:
    """All usable records of the parameter section by group and name, both in capitals.

    Records may go on beyond the ``stated`` bytes, up to where the data begin.
    """
    names: dict[int, str] = {}
    records: list[tuple[int, str, bytes]] = []
    position, closed, beyond = 4, False, 0
    while position + 4 <= len(section):
        length, group = struct.unpack("bb", section[position : position + 2])
        at = position + 2 + abs(length)
        if length == 0 or at + 2 > len(section):
            closed = length == 0
            break
        name = section[position + 2 : at].decode("utf-8", "replace").strip().upper()
        step = struct.unpack(processor.order + "H", section[at : at + 2])[0]
        end = min(at + step, len(section)) if step else len(section)
        if group < 0:
            names[-group] = name
        else:
            records.append((group, name, section[at + 2 : end]))
        beyond += position >= stated
        closed = step == 0
        if closed:
            break
        position = end
    if cut and not closed:
        raise _truncated(source, "parameter section", len(section))
    if not closed:
        text = "the parameter section ends without a last record; some may be missing"
        notes.append(Note("c3d.parameters", text, str(source)))
    if beyond:
        text = f"the parameter section is said to end after {stated} bytes; {beyond} records beyond it read as well"
        notes.append(Note("c3d.parameters", text, str(source)))
    return _collect(names, records, processor, source, notes)


def _collect(
    names: dict[int, str],
    records: list[tuple[int, str, bytes]],
    processor: Processor,
    source: str | Path,
    notes: list[Note],
) -> dict[str, dict[str, C3dParameter]]:
    groups: dict[str, dict[str, C3dParameter]] = {name: {} for name in names.values()}
    unusable, twice = [], []
    for group, name, body in records:
        parameter = _parameter(body, processor)
        if parameter is None or group not in names:
            unusable.append(name)
        else:
            if groups[names[group]].setdefault(name, parameter) != parameter:
                twice.append(f"{names[group]}:{name}")
            groups[names[group]][name] = parameter
    if unusable:
        listed = ", ".join(unusable[:5]) + (", ..." if len(unusable) > 5 else "")
        notes.append(
            Note("c3d.parameters", f"{len(unusable)} unusable parameter records ignored: {listed}", str(source))
        )
    if twice:
        text = f"parameters stand twice with different values, the last is read: {', '.join(twice[:5])}"
        notes.append(Note("c3d.parameters", text, str(source)))
    return groups


def _parameter(body: bytes, processor: Processor) -> C3dParameter | None:
    """The record's value, None where its size or type cannot be."""
    if len(body) < 2:
        return None
    kind, count = struct.unpack("bB", body[:2])
    dims = tuple(body[2 : 2 + count])
    if kind not in (-1, 1, 2, 4) or count > 7 or len(dims) < count:
        return None
    begin, size = 2 + count, math.prod(dims) * abs(kind)
    return C3dParameter(kind, dims, body[begin : begin + size], processor) if begin + size <= len(body) else None
