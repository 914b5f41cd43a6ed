"""The layout of a C3D file's data section: where the numbers lie, and on which clock.

What the header, the parameters and the file's size say about it is reconciled; a file that declares more than it holds
is refused. Format: the C3D file format user guide (c3d.org), "The 3D/analog data section".
"""

from dataclasses import dataclass, replace

import numpy as np

from torchid.errors import InputError, Note
from torchid.io.c3d_header import BLOCK, C3dHeader
from torchid.io.c3d_witnesses import MAX_RATE_MISMATCH, SATURATED, actual_field, choose_shape, declared_frames
from torchid.io.files import FileBytes

MAX_RATE = 1e6
"""A camera rate [Hz] beyond this is no rate."""
MAX_SCALE = 1e3
"""A quantum of integers [file units] beyond this is no scale."""
SAME = 1e-3
"""Relative difference of two statements of one number that rounding explains."""


@dataclass(frozen=True)
class C3dLayout:
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


def resolve_layout(header: C3dHeader, data: bytes | FileBytes, allow_truncated: bool = False) -> C3dLayout:
    """The layout of the data section of a file with this content.

    Raises:
        InputError: ``c3d.rate``, ``c3d.scale``, ``c3d.data_start``, ``c3d.analog_rate``, ``c3d.contradiction`` where
            the layout cannot be known; ``c3d.truncated`` where frames are missing and ``allow_truncated`` is false.
    """
    notes: list[Note] = []
    rate = _rate(header, notes)
    shape, said = choose_shape(header, data, rate)
    _say_missing(header, rate, shape.ratio, notes)
    _refuse_analog_rate(header, rate, shape.ratio)
    scale = _scale(header, shape.real) * (-1.0 if shape.real else 1.0)
    offset = header.start + (shape.block - 1) * BLOCK
    layout = C3dLayout(shape.points, shape.channels, shape.ratio, 0, 1, rate, scale, offset, ())
    frames = _frames(header, layout, len(data) - offset, allow_truncated, notes)
    first = _first_frame(header, frames, notes)
    return replace(layout, frames=frames, first_frame=first, notes=(*said, *notes))


def _say_missing(header: C3dHeader, rate: float, ratio: int, notes: list[Note]) -> None:
    missing = [f"POINT:{name}" for name in ("USED", "RATE", "SCALE") if not len(header.numbers("POINT", name))]
    for name in missing:
        notes.append(Note("c3d.parameter_missing", f"{name} is missing; that of the header used", header.source))
    if ratio and not header.number("ANALOG", "RATE"):
        text = f"ANALOG:RATE is missing; {rate * ratio:g} Hz from the samples per frame used"
        notes.append(Note("c3d.parameter_missing", text, header.source))


def _rate(header: C3dHeader, notes: list[Note]) -> float:
    """The camera rate [Hz]: of two that the file states, the one that ANALOG:RATE divided by word 10 repeats."""
    parameter = header.number("POINT", "RATE") or 0.0
    stated = [rate for rate in (parameter, header.rate) if 0.0 < rate < MAX_RATE]
    if not stated:
        raise InputError(
            "c3d.rate", "the camera rate is missing or none that a camera has", source=header.source,
            place="POINT:RATE", found=f"{header.spelled('POINT', 'RATE')}, in the header {header.rate:g}",
            remedy="Export the file again with its frame rate",
        )  # fmt: skip
    third = (header.number("ANALOG", "RATE") or 0.0) / header.ratio if header.ratio else 0.0
    repeated = [rate for rate in stated if abs(rate - third) <= MAX_RATE_MISMATCH * rate]
    chosen = (repeated or stated)[0]
    if abs(stated[0] - stated[-1]) > SAME * stated[0]:
        by = "ANALOG:RATE and header word 10" if repeated else "custom; nothing else in the file shows it"
        text = f"POINT:RATE is {stated[0]:g} Hz, the header says {stated[-1]:g} Hz; {chosen:g} Hz used, by {by}"
        notes.append(Note("c3d.header_disagrees", text, header.source))
    return chosen


def _scale(header: C3dHeader, real: bool) -> float:
    """Size of the scale; of integers it is their quantum, which parameter and header must state alike."""
    stated = [float(scale) for scale in (*header.numbers("POINT", "SCALE")[:1], header.scale)]
    if not np.isfinite(stated[0]) or stated[0] == 0.0 or stated[0] > MAX_SCALE:
        raise _bad_scale(header, "the scale of the points cannot be", f"{stated[0]:g}")
    size, other = abs(stated[0]), abs(stated[-1])
    if not real and 0.0 < other <= MAX_SCALE and abs(other - size) > SAME * size:
        text = "parameter and header state two scales of the points, and nothing else in the file shows which is right"
        raise _bad_scale(header, text, f"{size:g}, in the header {other:g}")
    return size


def _bad_scale(header: C3dHeader, message: str, found: str) -> InputError:
    return InputError(
        "c3d.scale", message, source=header.source, place="POINT:SCALE", found=found,
        remedy="Export the file again as reals",
    )  # fmt: skip


def _refuse_analog_rate(header: C3dHeader, rate: float, ratio: int) -> None:
    """An ANALOG:RATE that is no multiple of the camera rate, or that a camera rate stated once contradicts.

    A whole multiple is one of the witnesses of the samples per frame and may be outvoted; another puts the camera rate
    in doubt, and with it every velocity.
    """
    analog_rate, parameter = header.number("ANALOG", "RATE"), header.number("POINT", "RATE") or 0.0
    if not ratio or not analog_rate or abs(analog_rate / ratio - rate) <= MAX_RATE_MISMATCH * rate:
        return
    multiple = max(1, round(analog_rate / rate))
    whole = abs(analog_rate / multiple - rate) <= MAX_RATE_MISMATCH * rate
    if whole and abs(parameter - header.rate) <= SAME * rate:
        return
    raise InputError(
        "c3d.analog_rate", "analog and camera rates contradict each other", source=header.source, place="ANALOG:RATE",
        found=f"{analog_rate:g} Hz against {ratio} samples per frame at {rate:g} Hz",
        remedy="Export the file again; the ratio of the rates must be whole",
    )  # fmt: skip


def _first_frame(header: C3dHeader, frames: int, notes: list[Note]) -> int:
    """Number of the first frame: of two statements, the one whose last frame gives the number of frames read.

    Where none does, either end may be wrong: 1, as in a recording that was not trimmed, if one of the ends says so.
    """
    start, end = actual_field(header, "START"), actual_field(header, "END")
    stated = [] if start is None else [("TRIAL:ACTUAL_START_FIELD", start, SATURATED if end is None else end)]
    stated.append(("header word 4", header.first_frame, header.last_frame))
    known = [one for one in stated if SATURATED not in one]
    consistent = [one for one in known if one[2] - one[1] + 1 == frames]
    ends = [first for _, first, _ in stated if first != SATURATED] + [last - frames + 1 for _, _, last in known]
    chosen = consistent[0][1] if consistent else 1 if 1 in ends else (ends or [1])[0]
    wrong = [one for one in stated if one[1] != chosen and not (one[1] == SATURATED and consistent)]
    if wrong:
        text = ", ".join(f"{name} is {first}" for name, first, _ in wrong)
        notes.append(Note("c3d.header_disagrees", f"{text}; {chosen} is taken for the first frame", header.source))
    if chosen < 1:
        notes.append(Note("c3d.first_frame", "the first frame is numbered 0; time starts at 0 s", header.source))
    return max(chosen, 1)


def _frames(header: C3dHeader, layout: C3dLayout, available: int, allow_truncated: bool, notes: list[Note]) -> int:
    """Frames to read: of the declared numbers that fill the file the most frequent, else one that it holds."""
    size = layout.bytes_per_frame
    if size == 0:
        return 0
    present = max(available, 0) // size
    declared = [count for _, count in declared_frames(header)] or [present]
    fitting = [n for n in declared if n <= present]
    filling = [n for n in fitting if available - n * size < max(size, BLOCK)]
    frames = max(filling, key=declared.count) if filling else (fitting or [present])[0]
    if len(set(declared)) > 1:
        text = f"the file states {' / '.join(str(n) for n in declared)} frames and holds {present}; {frames} read"
        notes.append(Note("c3d.frames", text, header.source))
    if not fitting:
        _refuse_truncated(header, min(declared), present, allow_truncated, notes)
    else:
        _say_trailing(available - frames * size, available % BLOCK == 0, header.source, notes)
    return frames


def _say_trailing(left: int, whole: bool, source: str, notes: list[Note]) -> None:
    """Bytes after the data that do not just fill the last of a file's whole blocks: where some were put in or lost
    before them, all numbers from there on stand in other places."""
    if 0 < left < BLOCK and not whole:
        text = f"{left} bytes follow the data without filling a block: some were put in or lost, here or before"
        notes.append(Note("c3d.trailing", text, source))
    elif left >= BLOCK:
        notes.append(Note("c3d.trailing", f"{left} bytes follow the data and are not read", source))


def _refuse_truncated(header: C3dHeader, declared: int, present: int, allow_truncated: bool, notes: list[Note]) -> None:
    """Fewer frames than declared: refused, except where exactly the last one is absent or the user allows it."""
    text = f"{declared} frames declared, {present} present"
    if declared - present > 1 and not allow_truncated:
        raise InputError(
            "c3d.truncated", "the data section ends early", source=header.source, place="data section", found=text,
            remedy="Copy or export the file again, or set allow_truncated: true to read what is there",
        )  # fmt: skip
    notes.append(Note("c3d.truncated", f"the data section ends early: {text}; read what is there", header.source))
