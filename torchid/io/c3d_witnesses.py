"""Where the numbers of a C3D file lie, weighed from what its header, parameters, labels, numbers and size say.

They repeat each other, and in files from the field some of them are wrong. Every combination of stated values that fits
the size of the file is a candidate; the one that most witnesses back is read, and whoever says otherwise is named.
Format: the C3D file format user guide (c3d.org), "The header section" and "The parameter section".
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from torchid.errors import InputError, Note
from torchid.io.c3d_header import BLOCK, C3dHeader
from torchid.io.files import FileBytes

SATURATED = 65535
"""A 16-bit count at its end says nothing."""
MAX_RATE_MISMATCH = 0.02
"""Allowed relative difference of ANALOG:RATE from a whole multiple of the video rate: NTSC rates are rounded."""
SAMPLE_BYTES = 1 << 14
"""So much of the data section tells reals from integers: four thousand words."""
REAL_SIZE = (1e-12, 1e9)
"""Sizes of a number other than zero that a file of mm, N and V may hold. Two 16-bit integers taken for one real are
denormal where the second is small, as a residual is, and not a number where it is a small negative one."""
ODD_SHARE = (0.02, 0.2)
"""Share of words outside ``REAL_SIZE`` below which they are reals and above which they are integers: reals have none
but damage, integers at least their residuals, a half."""
ENOUGH_WORDS = 16
"""Fewer words other than zero show nothing."""
QUIET_NAN = (0x7FC00000, 0xFFC00000)
"""How programs write a missing real."""
PHRASES = {
    "points": "{} points", "samples": "{} analog values per frame", "ratio": "{} analog samples per frame",
    "channels": "{} analog channels", "real": "{}", "block": "data from block {}",
}  # fmt: skip


@dataclass(frozen=True)
class C3dShape:
    """One way the data section may be laid out."""

    points: int
    channels: int
    ratio: int
    """Analog samples per video frame; 0 without channels."""
    real: bool
    """Reals of four bytes, else integers of two."""
    block: int
    """Where the data begin: the first block of the file is 1."""
    frames: int

    @property
    def samples(self) -> int:
        """Analog values per video frame."""
        return self.channels * self.ratio

    @property
    def frame_bytes(self) -> int:
        """Size of a video frame."""
        return (4 * self.points + self.samples) * (4 if self.real else 2)

    def left(self, header: C3dHeader, size: int) -> int:
        """Bytes of the file after the last frame, negative where it is too short."""
        return size - header.start - (self.block - 1) * BLOCK - self.frames * self.frame_bytes

    def fits(self, header: C3dHeader, size: int) -> bool:
        """The frames end with the file, or with less than a block to fill a file of whole blocks."""
        left = self.left(header, size)
        return left == 0 or (0 < left < BLOCK and (size - header.start) % BLOCK == 0)

    def __str__(self) -> str:
        kind = "reals" if self.real else "integers"
        analog = f"{self.channels} channels x {self.ratio}" if self.channels else "no channels"
        return f"{self.points} points and {analog} as {kind} from block {self.block}, {self.frames} frames"


@dataclass(frozen=True)
class C3dStatement:
    """What one witness says about one field of a `Shape`."""

    name: str
    field: str
    value: int
    weak: bool = False
    """Often otherwise in sound files, so that it may support but not accuse."""

    def backs(self, shape: C3dShape) -> bool:
        """It says what ``shape`` is; without channels nothing is said about their rate."""
        return getattr(shape, self.field) == self.value and not (self.field == "ratio" and not shape.channels)

    def accuses(self, shape: C3dShape) -> bool:
        """It says otherwise; frames are counted elsewhere, where the file may also be too short or too long."""
        silent = self.weak or self.field == "frames" or (self.field == "ratio" and not shape.channels)
        return not silent and getattr(shape, self.field) != self.value

    def __str__(self) -> str:
        return f"{self.name} says {_spelled(self.field, self.value)}"


def _spelled(field: str, value: int) -> str:
    return ("reals" if value else "integers") if field == "real" else str(value)


def choose_shape(header: C3dHeader, data: bytes | FileBytes, rate: float) -> tuple[C3dShape, list[Note]]:
    """The shape that fits the file's size and that most witnesses back; where none fits, the one that all back.

    Raises:
        InputError: ``c3d.contradiction`` where several shapes are backed alike, or where witnesses disagree and none
            fits; ``c3d.data_start`` where no witness says where the data begin.
    """
    said = _statements(header, data, rate)
    shapes = list(_candidates(header, said, len(data)))
    if not shapes:
        raise InputError(
            "c3d.data_start", "the file does not say where its data begin", source=header.source,
            place="header word 9 and POINT:DATA_START",
            found=f"{header.data_block} and {header.spelled('POINT', 'DATA_START')}", remedy="Export the file again",
        )  # fmt: skip
    fitting = [shape for shape in shapes if shape.fits(header, len(data))]
    support = {shape: sum(one.backs(shape) for one in said) for shape in fitting or shapes}
    best = [shape for shape, count in support.items() if count == max(support.values())]
    tied = len({(s.points, s.channels, s.ratio, s.real, s.block) for s in best}) > 1
    disputed = any(one.accuses(best[0]) for one in said)
    # A file that was cut and is disputed is not called cut: to allow that would read what nobody knows.
    if tied or (disputed and not fitting and not 0 <= best[0].left(header, len(data)) < BLOCK):
        raise _contradiction(header, said, best, bool(fitting), len(data))
    return best[0], _disagreements(header, said, best[0], bool(fitting))


def _statements(header: C3dHeader, data: bytes | FileBytes, rate: float) -> list[C3dStatement]:
    """Everything that is said; absent, saturated and impossible values say nothing."""
    analog_rate = header.number("ANALOG", "RATE") or 0.0
    multiple = round(analog_rate / rate)
    whole = multiple >= 1 and abs(analog_rate / multiple - rate) <= MAX_RATE_MISMATCH * rate
    scale = header.number("POINT", "SCALE")
    found = [
        ("header word 2", "points", header.points),
        ("POINT:USED", "points", header.number("POINT", "USED")),
        ("header word 3", "samples", header.analog_per_frame),
        ("header word 10", "ratio", header.ratio or None),
        ("ANALOG:USED", "channels", header.number("ANALOG", "USED")),
        ("ANALOG:RATE", "ratio", multiple if whole else None),
        ("POINT:SCALE", "real", scale < 0 if scale else None),
        ("the scale in the header", "real", header.scale < 0 if header.scale else None),
        ("header word 9", "block", header.data_block or None),
        ("POINT:DATA_START", "block", header.number("POINT", "DATA_START") or None),
        *((name, "frames", count) for name, count in declared_frames(header)),
    ]
    strong = [C3dStatement(name, field, int(value)) for name, field, value in found if value is not None and value >= 0]
    labels = len(header.strings("POINT", "LABELS"))
    numbers = _stored_as_reals(header, data, [one.value for one in strong if one.field == "block"])
    weak = [("the number of POINT:LABELS", "points", labels or None), ("the numbers themselves", "real", numbers)]
    return strong + [C3dStatement(name, field, int(v), weak=True) for name, field, v in weak if v is not None]


def declared_frames(header: C3dHeader) -> list[tuple[str, int]]:
    """Numbers of frames that the file states, the most trustworthy first; saturated words are left out."""
    found: list[tuple[str, float]] = []
    start, end = actual_field(header, "START"), actual_field(header, "END")
    if start is not None and end is not None:
        found.append(("TRIAL:ACTUAL_END_FIELD", end - start + 1))
    frames = header.number("POINT", "FRAMES")
    found.append(("POINT:FRAMES", SATURATED if frames is None else frames))
    last = SATURATED if header.last_frame == SATURATED else header.last_frame - header.first_frame + 1
    found.append(("header words 4 and 5", last))
    return [(name, int(n)) for name, n in found if np.isfinite(n) and n >= 0 and n != SATURATED]


def actual_field(header: C3dHeader, which: str) -> int | None:
    """TRIAL:ACTUAL_START_FIELD or TRIAL:ACTUAL_END_FIELD, whose two words make one number; None where absent."""
    words = header.numbers("TRIAL", f"ACTUAL_{which}_FIELD", unsigned=True)
    return int(words[0]) + 65536 * int(words[1]) if len(words) >= 2 and np.isfinite(words[:2]).all() else None


def _stored_as_reals(header: C3dHeader, data: bytes | FileBytes, blocks: list[int]) -> bool | None:
    """Whether the first numbers of the data section look like reals, None where they show neither."""
    begin = header.start + (blocks[0] - 1) * BLOCK if blocks and blocks[0] > 1 else len(data)
    raw = data[begin : begin + SAMPLE_BYTES]
    raw = raw[: len(raw) // 4 * 4]
    with np.errstate(invalid="ignore"):
        size = np.abs(header.processor.floats(raw).astype(float))
    filled = ~np.isin(np.frombuffer(raw, header.processor.order + "u4"), (0, *QUIET_NAN))
    if filled.sum() < ENOUGH_WORDS:
        return None
    odd = 1.0 - float(((size > REAL_SIZE[0]) & (size < REAL_SIZE[1]))[filled].mean())
    return True if odd < ODD_SHARE[0] else False if odd > ODD_SHARE[1] else None


def _candidates(header: C3dHeader, said: list[C3dStatement], size: int) -> Iterator[C3dShape]:
    """Every combination of stated values. Word 3 may hold channels where it should hold values per frame.

    Labels count where there are more of them than points are stated: with fewer, a file that was cut might seem whole.
    """
    most = max(one.value for one in said if one.field == "points" and not one.weak)
    heard = [one for one in said if not (one.weak and one.field == "points" and one.value < most)]

    def values(field: str) -> list[int]:
        return list(dict.fromkeys(one.value for one in heard if one.field == field))

    pairs: dict[tuple[int, int], None] = {}
    for total, ratio in product(values("samples"), values("ratio") or [1]):
        pairs |= {(total // ratio, ratio): None} if total % ratio == 0 else {}
        pairs |= {(channels, ratio): None for channels in (total, *values("channels"))}
    pairs |= {(n, total // n): None for n in values("channels") for total in values("samples") if n and total % n == 0}
    analog = dict.fromkeys((n, ratio) if n * ratio else (0, 0) for n, ratio in pairs)
    starts = [block for block in values("block") if block >= 2]
    for points, (channels, ratio), real, block in product(values("points"), analog, values("real") or [1], starts):
        empty = C3dShape(points, channels, ratio, bool(real), block, 0)
        present = max(empty.left(header, size), 0) // empty.frame_bytes if empty.frame_bytes else 0
        for frames in values("frames") or [present]:
            yield C3dShape(points, channels, ratio, bool(real), block, frames)


def _disagreements(header: C3dHeader, said: list[C3dStatement], shape: C3dShape, fits: bool) -> list[Note]:
    """One note for every witness that says otherwise than ``shape``, with those that outvote it."""
    notes = []
    for one in (one for one in said if one.accuses(shape)):
        others = [other.name for other in said if other.field == one.field and other.backs(shape)]
        backers = ", ".join([*others, *(["the file's size"] if fits else [])])
        chosen = PHRASES[one.field].format(_spelled(one.field, getattr(shape, one.field)))
        text = f"{one}, but {chosen} are read" + (f", by {backers}" if backers else "")
        notes.append(Note("c3d.header_disagrees", text, header.source))
    return notes


def _contradiction(
    header: C3dHeader, said: list[C3dStatement], best: list[C3dShape], fits: bool, size: int
) -> InputError:
    disputed = {one.field for one in said if any(one.accuses(shape) for shape in best)}
    stated = ", ".join(str(one) for one in said if one.field in disputed)
    shapes = "; or ".join(str(shape) for shape in best[:4])
    verdict = "these fit the file's size alike" if fits else "none fits the file's size"
    return InputError(
        "c3d.contradiction", "header and parameters contradict each other about the layout of the data",
        source=header.source, place="data section", found=f"{stated}: {shapes}; {verdict}, {size} bytes",
        remedy="Copy or export the file again, so that header and parameters agree",
    )  # fmt: skip
