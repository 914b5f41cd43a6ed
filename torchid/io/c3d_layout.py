"""The layout of a C3D file's data section: where the numbers lie, and on which clock.

What the header, the parameters and the file's size say about it is reconciled; a file that declares more than it holds
is refused. Format: the C3D file format user guide (c3d.org), "The 3D/analog data section".
"""

from dataclasses import dataclass

import numpy as np

from torchid.errors import InputError, Note
from torchid.io.c3d_header import BLOCK, C3dHeader

SATURATED = 65535
MAX_RATE_MISMATCH = 0.02
"""Allowed relative difference of ANALOG:RATE from the video rate times the header's whole ratio."""
MAX_RATE = 1e6


@dataclass(frozen=True)
class Layout:
    """Where the numbers lie in the data section, and on which clock."""

    points: int
    channels: int
    ratio: int
    frames: int
    first_frame: int
    rate: float
    scale: float
    """Quantum of integer points in file units; reals where not above zero."""
    offset: int
    notes: tuple[Note, ...]

    @property
    def is_float(self) -> bool:
        """Stored as reals instead of 16-bit integers."""
        return self.scale <= 0.0

    @property
    def values(self) -> int:
        """Numbers per video frame."""
        return 4 * self.points + self.channels * self.ratio

    @property
    def bytes_per_frame(self) -> int:
        """Size of a video frame."""
        return self.values * (4 if self.is_float else 2)


def resolve_layout(header: C3dHeader, size: int, allow_truncated: bool = False) -> Layout:
    """The layout of the data section of a file of ``size`` bytes.

    Raises:
        InputError: ``c3d.rate``, ``c3d.scale``, ``c3d.data_start``, ``c3d.analog_rate`` where the layout cannot be
            known; ``c3d.truncated`` where frames are missing and ``allow_truncated`` is false.
    """
    notes: list[Note] = []
    points = int(_agree(header, "POINT", "USED", float(header.points), notes))
    rate = _rate(header, notes)
    channels, ratio = _analog_layout(header, rate, notes)
    scale = _scale(header, notes)
    offset = _data_offset(header, size, notes)
    layout = Layout(points, channels, ratio, 0, _first_frame(header, notes), rate, scale, offset, ())
    frames = _frames(header, layout, size - offset, allow_truncated, notes)
    return Layout(points, channels, ratio, frames, layout.first_frame, rate, scale, offset, tuple(notes))


def _agree(header: C3dHeader, group: str, name: str, stated: float, notes: list[Note]) -> float:
    """A parameter that the header repeats: the parameter wins, absence and disagreement are said."""
    value = header.number(group, name)
    if value is None or value < 0:
        notes.append(
            Note("c3d.parameter_missing", f"{group}:{name} is missing; {stated:g} of the header used", header.source)
        )
        return stated
    if abs(value - stated) > 1e-3 * abs(stated) + 1e-6:
        notes.append(
            Note("c3d.header_disagrees", f"{group}:{name} is {value:g}, the header says {stated:g}", header.source)
        )
    return value


def _rate(header: C3dHeader, notes: list[Note]) -> float:
    stated = header.rate if np.isfinite(header.rate) else 0.0
    rate = _agree(header, "POINT", "RATE", stated, notes) or stated
    if not 0.0 < rate < MAX_RATE:
        raise InputError(
            "c3d.rate",
            "the camera rate is missing",
            source=header.source,
            place="POINT:RATE",
            found=f"{rate:g}",
            remedy="Export the file again with its frame rate",
        )
    return rate


def _scale(header: C3dHeader, notes: list[Note]) -> float:
    stored = header.numbers("POINT", "SCALE")
    scale = float(stored[0]) if len(stored) else header.scale
    if not len(stored):
        notes.append(Note("c3d.parameter_missing", "POINT:SCALE is missing; that of the header used", header.source))
    if not np.isfinite(scale) or scale == 0.0 or scale > 1e3:
        raise InputError(
            "c3d.scale",
            "the scale of the points cannot be",
            source=header.source,
            place="POINT:SCALE",
            found=f"{scale:g}",
            remedy="Export the file again as reals",
        )
    return scale


def _analog_layout(header: C3dHeader, rate: float, notes: list[Note]) -> tuple[int, int]:
    """Channels and samples per video frame; the header's words are what the data were written with."""
    total, used = header.analog_per_frame, header.number("ANALOG", "USED")
    ratio = header.ratio
    if total and not ratio and used:
        ratio = int(total // used)
    if not total or not ratio:
        return 0, 0
    if total % ratio:
        raise InputError(
            "c3d.analog_rate",
            "the analog samples do not divide into frames",
            source=header.source,
            place="header words 3 and 10",
            found=f"{total} values, {ratio} samples per frame",
            remedy="Export the file again",
        )
    channels = total // ratio
    if used is not None and int(used) != channels:
        notes.append(Note("c3d.header_disagrees", f"ANALOG:USED is {used:g}, the data hold {channels}", header.source))
    analog_rate = header.number("ANALOG", "RATE")
    if not analog_rate:
        text = f"ANALOG:RATE is missing; {rate * ratio:g} Hz from the header's ratio used"
        notes.append(Note("c3d.parameter_missing", text, header.source))
    elif abs(analog_rate / ratio - rate) > MAX_RATE_MISMATCH * rate:
        raise InputError(
            "c3d.analog_rate",
            "analog and camera rates contradict each other",
            source=header.source,
            place="ANALOG:RATE",
            found=f"{analog_rate:g} Hz against {ratio} samples per frame at {rate:g} Hz",
            remedy="Export the file again; the ratio of the rates must be whole",
        )
    return channels, ratio


def _data_offset(header: C3dHeader, size: int, notes: list[Note]) -> int:
    block = header.data_block or int(header.number("POINT", "DATA_START") or 0)
    stated = header.number("POINT", "DATA_START")
    if stated is not None and int(stated) != block:
        notes.append(
            Note("c3d.header_disagrees", f"POINT:DATA_START is {stated:g}, the header says {block}", header.source)
        )
    if block < 2:
        raise InputError(
            "c3d.data_start",
            "the file does not say where its data begin",
            source=header.source,
            place="header word 9",
            found=str(block),
            remedy="Export the file again",
        )
    return header.start + (block - 1) * BLOCK


def _first_frame(header: C3dHeader, notes: list[Note]) -> int:
    start = header.numbers("TRIAL", "ACTUAL_START_FIELD", unsigned=True)
    first = int(start[0]) + 65536 * int(start[1]) if len(start) >= 2 else header.first_frame
    if len(start) >= 2 and first != header.first_frame and header.first_frame != SATURATED:
        text = f"TRIAL:ACTUAL_START_FIELD is {first}, the header's first frame {header.first_frame}"
        notes.append(Note("c3d.header_disagrees", text, header.source))
    if first < 1:
        notes.append(Note("c3d.first_frame", "the first frame is numbered 0; time starts at 0 s", header.source))
    return max(first, 1)


def _declared_frames(header: C3dHeader) -> list[int]:
    """Numbers of frames that the file states, the most trustworthy first; saturated words are left out."""
    found: list[float] = []
    start = header.numbers("TRIAL", "ACTUAL_START_FIELD", unsigned=True)
    end = header.numbers("TRIAL", "ACTUAL_END_FIELD", unsigned=True)
    if len(start) >= 2 and len(end) >= 2:
        found.append(end[0] + 65536 * end[1] - start[0] - 65536 * start[1] + 1)
    frames = header.number("POINT", "FRAMES")
    found.append(SATURATED if frames is None else frames)
    found.append(SATURATED if header.last_frame == SATURATED else header.last_frame - header.first_frame + 1)
    return [int(n) for n in found if np.isfinite(n) and n >= 0 and n != SATURATED]


def _frames(header: C3dHeader, layout: Layout, available: int, allow_truncated: bool, notes: list[Note]) -> int:
    """Frames to read: a declared number that fills the file, else the first declared that it holds."""
    size = layout.bytes_per_frame
    if size == 0:
        return 0
    present = max(available, 0) // size
    declared = _declared_frames(header) or [present]
    fitting = [n for n in declared if n <= present]
    filling = [n for n in fitting if available - n * size < max(size, BLOCK)]
    frames = (filling or fitting or [present])[0]
    if len(set(declared)) > 1:
        text = f"the file states {' / '.join(str(n) for n in declared)} frames and holds {present}; {frames} read"
        notes.append(Note("c3d.frames", text, header.source))
    if not fitting:
        _refuse_truncated(header, min(declared), present, allow_truncated, notes)
    elif available - frames * size > BLOCK and available - frames * size >= size:
        text = f"{available - frames * size} bytes follow the data and are not read"
        notes.append(Note("c3d.trailing", text, header.source))
    return frames


def _refuse_truncated(header: C3dHeader, declared: int, present: int, allow_truncated: bool, notes: list[Note]) -> None:
    """Fewer frames than declared: refused, except where exactly the last one is absent or the user allows it."""
    text = f"{declared} frames declared, {present} present"
    if declared - present > 1 and not allow_truncated:
        raise InputError(
            "c3d.truncated",
            "the data section ends early",
            source=header.source,
            place="data section",
            found=text,
            remedy="Copy or export the file again, or set allow_truncated: true to read what is there",
        )
    notes.append(Note("c3d.truncated", f"the data section ends early: {text}; read what is there", header.source))
