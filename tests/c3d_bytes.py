"""A builder of small C3D files byte by byte, for what real files and writing libraries do not show."""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

INTEL, DEC, MIPS = 84, 85, 86
BLOCK = 512


@dataclass
class C3dBuilder:
    """What goes into the file; every field may lie."""

    points: np.ndarray
    """(frames, points, 3) in file units; NaN is written as residual -1."""
    labels: list[str]
    analogs: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    """(samples, channels) as stored."""
    ratio: int = 0
    rate: float = 100.0
    scale: float = -0.1
    processor: int = INTEL
    first_frame: int = 1
    header_frames: int | None = None
    parameters: dict = field(default_factory=dict)
    """group -> name -> list of str, int or float array (any shape, first index fastest), or None to leave it out."""
    unsigned: bool = False

    def floats(self, values) -> bytes:
        """Reals as the processor stores them."""
        values = np.asarray(values, dtype=float).ravel()
        if self.processor == MIPS:
            return values.astype(">f4").tobytes()
        if self.processor == INTEL:
            return values.astype("<f4").tobytes()
        return (values * 4.0).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1].tobytes()

    @property
    def order(self) -> str:
        return ">" if self.processor == MIPS else "<"

    def ints(self, values) -> bytes:
        """Sixteen-bit integers as the processor stores them."""
        return (np.asarray(values, dtype=np.int64).ravel() & 0xFFFF).astype(self.order + "u2").tobytes()

    def build(self) -> bytes:
        """The file."""
        frames, count = self.points.shape[:2]
        standard = {
            "POINT": {
                "USED": np.array([count]), "FRAMES": np.array([min(frames, 65535)]), "SCALE": np.array([self.scale]),
                "RATE": np.array([self.rate]), "UNITS": ["mm"], "LABELS": self.labels, "DATA_START": np.array([0]),
            }
        }  # fmt: skip
        if self.analogs.size:
            channels = self.analogs.shape[1]
            standard["ANALOG"] = {
                "USED": np.array([channels]), "RATE": np.array([self.rate * self.ratio]), "GEN_SCALE": np.array([1.0]),
                "SCALE": np.ones(channels), "OFFSET": np.zeros(channels, int), "UNITS": ["N"] * channels,
                "LABELS": [f"C{k}" for k in range(channels)],
            }  # fmt: skip
        for group, entries in self.parameters.items():
            standard.setdefault(group, {}).update(entries)
        section = self._parameters(standard, 0)
        start = 2 + len(section) // BLOCK
        section = self._parameters(standard, start)
        return self._header(start) + section + self._data()

    def _header(self, start: int) -> bytes:
        frames, count = self.points.shape[:2]
        per_frame = self.ratio * (self.analogs.shape[1] if self.analogs.size else 0)
        last = self.first_frame + (frames if self.header_frames is None else self.header_frames) - 1
        words = [count, per_frame, self.first_frame, min(last, 65535), 10]
        head = bytes([2, 0x50]) + self.ints(words) + self.floats([self.scale])
        head += self.ints([start, self.ratio]) + self.floats([self.rate])
        return head.ljust(BLOCK, b"\0")

    def _parameters(self, groups: dict, start: int) -> bytes:
        body = b""
        for number, (group, entries) in enumerate(groups.items(), 1):
            name = group.encode()
            body += struct.pack("bb", len(name), -number) + name + struct.pack(self.order + "H", 3) + b"\0"
            for key, value in entries.items():
                if value is None:
                    continue
                value = np.array([start]) if key == "DATA_START" and group == "POINT" and value[0] == 0 else value
                record, name = self._value(value), key.encode()
                body += struct.pack("bb", len(name), number) + name
                body += struct.pack(self.order + "H", len(record) + 3) + record + b"\0"
        body += b"\0\0\0\0"
        size = -(-(len(body) + 4) // BLOCK)
        return (bytes([1, 0x50, size, self.processor]) + body).ljust(size * BLOCK, b"\0")

    def _value(self, value) -> bytes:
        if isinstance(value, list):
            width = max((len(text.encode()) for text in value), default=0)
            cells = b"".join(text.encode().ljust(width) for text in value)
            return struct.pack("bBBB", -1, 2, width, len(value)) + cells
        dims = bytes([value.ndim, *value.shape])
        flat = value.ravel(order="F")
        return b"\4" + dims + self.floats(flat) if value.dtype.kind == "f" else b"\2" + dims + self.ints(flat)

    def _data(self) -> bytes:
        frames, count = self.points.shape[:2]
        missing = np.asarray(np.isnan(self.points).any(axis=2))
        positions = np.where(missing[..., None], 0.0, self.points)
        if self.scale > 0:
            positions = np.round(positions / self.scale)
        block = np.concatenate([positions, np.where(missing, -1.0, 0.0)[..., None]], axis=2).reshape(frames, 4 * count)
        if self.analogs.size:
            block = np.concatenate([block, self.analogs.reshape(frames, -1)], axis=1)
        raw = self.ints(block.astype(np.int64)) if self.scale > 0 else self.floats(block)
        return raw + b"\0" * (-len(raw) % BLOCK)

    def save(self, path: Path) -> Path:
        """Write the file."""
        path.write_bytes(self.build())
        return path


def standing(frames: int = 20, markers: int = 8, seed: int = 0) -> np.ndarray:
    """Points [mm] of somebody 1.7 m tall who sways."""
    random = np.random.default_rng(seed)
    base = random.uniform([-250.0, -200.0, 20.0], [250.0, 200.0, 1700.0], (markers, 3))
    base[0, 2], base[1, 2] = 30.0, 1700.0
    sway = 5.0 * np.sin(np.arange(frames) / 7.0)[:, None, None] * random.normal(size=(markers, 3))
    return np.round((base + sway) * 10.0) / 10.0


def labels(count: int) -> list[str]:
    """Plain labels."""
    return [f"MK{chr(65 + k // 26)}{chr(65 + k % 26)}" for k in range(count)]
