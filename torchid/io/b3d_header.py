"""What a .b3d of AddBiomechanics says before its frames: whom it shows, and where each trial stands.

The layout is that of ``dart/proto/SubjectOnDisk.proto`` and ``dart/biomechanics/SubjectOnDisk.cpp`` of nimblephysics
(Werling et al., 2023, PLOS ONE 18, e0295152): the header's length, the header, then for every frame of every trial a
message of sensors and one for each pass of processing, all of one size.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from torchid.errors import InputError
from torchid.io.files import FileBytes, unique_names
from torchid.io.protobuf import Message
from torchid.wording import listing

LENGTH = 8
"""Bytes in which the header's length is written."""
PASSES, PASS_TYPE, MODEL = 5, 1, 2
"""Fields of the passes of processing in the header; of the type and the model's text in a pass."""
TYPES = ("kinematics", "dynamics", "low-pass filter", "acceleration-minimising filter")
"""What the numbers of ``ProcessingPassType`` mean."""
FITTING = (0, 1)
"""Types of the passes that fit a model; a filter leaves it as it was."""
PART = re.compile(r"_split\d+$")
"""Ending of a file's name that holds a part of a subject's trials."""


@dataclass(frozen=True)
class B3dTrial:
    """Where a trial stands, and what the header says of it."""

    name: str
    frames: int
    start: int
    """Byte of its first frame."""
    stride: int
    """Bytes of a frame with its passes."""
    said: Message


@dataclass(frozen=True)
class B3dHeader:
    """What a file says before its frames."""

    file: FileBytes
    said: Message
    sensors: int
    """Bytes of the sensors of a frame."""
    passes: int
    """Bytes of a pass of a frame."""
    trials: tuple[B3dTrial, ...]

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """Whom it shows, as far as it says so."""
        mass, height = (next(iter(self.said.doubles(number)), 0.0) for number in (15, 14))
        age = self.said.whole(16)
        known = {
            "subject": PART.sub("", self.file.path.stem), "mass_kg": f"{mass:.6g}" if mass > 0.0 else "",
            "height_m": f"{height:.6g}" if height > 0.0 else "", "sex": self.said.text(13),
            "age_years": str(age) if age > 0 else "",
        }  # fmt: skip
        return tuple((key, value) for key, value in known.items() if value)


def read_header(path: Path) -> B3dHeader:
    """The header of a file, with its trials under names that differ and are no paths.

    Raises:
        InputError: ``file.unreadable``; ``b3d.header`` for another kind of file or an older layout;
            ``protobuf.damaged``; ``b3d.truncated`` for a file that ends before its last frame.
    """
    file = FileBytes(path)
    length = int.from_bytes(file[:LENGTH], "little")
    if not 0 < length <= file.size - LENGTH:
        raise _no_b3d(path, f"a header of {length} bytes in a file of {file.size}")
    said = Message(file[LENGTH : LENGTH + length], str(path))
    sensors, passes = said.whole(3), said.whole(4)
    parts = said.messages(9)
    if sensors <= 0 or passes < 0 or not parts:
        raise _no_b3d(path, f"{len(parts)} trials in frames of {sensors} bytes")
    trials, start = [], LENGTH + length
    names = unique_names([re.sub(r"[/\\\0]+", "_", part.text(1)).strip(" .") or "trial" for part in parts])
    for name, part in zip(names, parts, strict=True):
        stride = sensors + passes * len(part.texts(5))
        trials.append(B3dTrial(name, max(0, part.whole(3)), start, stride, part))
        start += trials[-1].frames * stride
    if start > file.size:
        raise InputError(
            "b3d.truncated", "the file ends before its last frame", source=path,
            found=f"{file.size} of {start} bytes", remedy="Download or export the file again",
        )  # fmt: skip
    return B3dHeader(file, said, sensors, passes, tuple(trials))


def read_b3d_model(path: Path) -> bytes:
    """The text of the OpenSim model in a file, as the last pass that fitted one left it.

    Raises:
        InputError: as ``read_header``; ``b3d.model`` where no pass of kinematics or dynamics holds a model.
    """
    passes = read_header(path).said.messages(PASSES)
    texts = [one.text(MODEL) for one in passes if one.whole(PASS_TYPE) in FITTING]
    found = next((text for text in reversed(texts) if text.strip()), None)
    if found is None:
        kinds = [one.whole(PASS_TYPE) for one in passes]
        named = listing([TYPES[kind] if kind in range(len(TYPES)) else f"type {kind}" for kind in kinds], 6)
        raise InputError(
            "b3d.model", "the file holds no OpenSim model of a pass of kinematics or dynamics", source=path,
            found=f"passes: {named}",
            remedy="Name the subject's .osim file under model:, or leave model: out",
        )  # fmt: skip
    return found.encode("utf-8")


def _no_b3d(path: Path, found: str) -> InputError:
    return InputError(
        "b3d.header", "this is no .b3d file of AddBiomechanics, or one of an older layout", source=path, found=found,
        remedy="Download it again; layouts since 2023 are read",
    )  # fmt: skip
