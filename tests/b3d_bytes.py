"""A .b3d in bytes, by the schema that AddBiomechanics publishes (``SubjectOnDisk.proto``), in a few lines."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


def varint(value: int) -> bytes:
    """A whole number in seven bits a byte, the lowest first."""
    parts = [value & 127]
    while value := value >> 7:
        parts[-1] |= 128
        parts.append(value & 127)
    return bytes(parts)


def packed(number: int, stored: bytes | str) -> bytes:
    """A field of bytes: a text, a message or numbers of a list."""
    stored = stored.encode() if isinstance(stored, str) else stored
    return varint(number << 3 | 2) + varint(len(stored)) + stored


def whole(number: int, value: int) -> bytes:
    """A field of a whole number."""
    return varint(number << 3) + varint(value)


def double(number: int, value: float) -> bytes:
    """A field of a number."""
    return varint(number << 3 | 1) + np.float64(value).tobytes()


def doubles(number: int, values: np.ndarray) -> bytes:
    """A field of numbers of a list."""
    return packed(number, np.ascontiguousarray(values, "<f8").tobytes())


@dataclass
class B3dTrial:
    """One trial: what was seen, and what plates or bodies bore, Y up [m, N, N m]."""

    name: str
    position: np.ndarray
    force: np.ndarray
    point: np.ndarray
    torque: np.ndarray
    missing: list[int] = field(default_factory=list)
    by_body: bool = False
    corners: np.ndarray | None = None

    def header(self, period: float) -> bytes:
        """What the file's header says of it."""
        plates = 0 if self.by_body else self.force.shape[1]
        missing = self.missing or [0] * len(self.position)
        corners = b"" if self.corners is None else doubles(8, self.corners)
        return b"".join(
            [packed(1, self.name), packed(2, b"".join(map(varint, missing))), whole(3, len(self.position))]
            + [double(4, period), packed(5, whole(1, 0)), whole(7, plates), corners]
        )

    def frames(self, plates: int) -> list[tuple[bytes, bytes]]:
        """Sensors and the first pass of each frame."""
        return [(self._sensors(k, plates), self._pass(k)) for k in range(len(self.position))]

    def _sensors(self, k: int, plates: int) -> bytes:
        said = doubles(2, self.position[k])
        for number, values in ((7, self.point), (8, self.torque), (9, self.force)):
            stored = np.full((plates, 3), np.nan)
            if not self.by_body:
                stored[: values.shape[1]] = values[k]
            said += doubles(number, stored)
        return said

    def _pass(self, k: int) -> bytes:
        given = [np.zeros((2, 3))] * 3 if not self.by_body else [self.point[k], self.torque[k], self.force[k]]
        return doubles(1, np.zeros(4)) + b"".join(doubles(6 + n, values) for n, values in enumerate(given))


MODELS = ((0, "<OpenSimDocument/>"),)
"""Type and text of the model of the passes of a file that is asked for no model."""


def b3d_bytes(
    labels: tuple[str, ...],
    trials: list[B3dTrial],
    rate: float,
    plates: int = 2,
    models: tuple[tuple[int, str], ...] = MODELS,
) -> bytes:
    """A file of trials of a woman of 72.5 kg, 1.76 m and 31 years."""
    frames = [frame for trial in trials for frame in trial.frames(plates)]
    head = [whole(1, 4), whole(2, len(trials)), whole(3, len(frames[0][0])), whole(4, len(frames[0][1]))]
    head += [packed(5, (whole(1, kind) if kind else b"") + packed(2, text)) for kind, text in models]
    head += [packed(6, "calcn_r"), packed(6, "calcn_l")]
    head += [packed(9, trial.header(1.0 / rate)) for trial in trials]
    head += [whole(10, 4), packed(13, "female"), double(14, 1.76), double(15, 72.5), whole(16, 31)]
    head += [packed(17, label) for label in labels]
    header = b"".join(head)
    return len(header).to_bytes(8, "little") + header + b"".join(part for frame in frames for part in frame)


def write_b3d(path: Path, *args, **kwargs) -> Path:
    """``b3d_bytes`` into a file."""
    path.write_bytes(b3d_bytes(*args, **kwargs))
    return path
