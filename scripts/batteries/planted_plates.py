"""Faults of force plates, written into copies of real files: bytes of a C3D, columns of a MOT.

Nothing here uses ``torchid.io.mend`` or ``torchid.checks.plates_against_feet``: what these undo is not what plants.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchid.conventions import GRAVITY
from torchid.io.c3d_header import C3dHeader, Processor, read_header
from torchid.io.c3d_layout import resolve_layout
from torchid.io.files import FileBytes
from torchid.io.storage import Storage, read_storage, write_storage

Draw = np.random.Generator
TURNS = {"turned by 90": (3, 0, 1, 2), "turned by 180": (2, 3, 0, 1), "turned by 270": (1, 2, 3, 0)}
ORDERS = {"corners mirrored": ((1, 0, 3, 2), (3, 2, 1, 0)), "corners crossed": ((0, 1, 3, 2), (1, 0, 2, 3))}


@dataclass(frozen=True)
class Fault:
    """A fault by name, and what makes it: from a file and a draw to the faulty file's name."""

    name: str
    plant: Callable[[Path, Path, Draw], None]
    """From the right file, to the faulty one."""


class C3dCopy:
    """A C3D file whose parameters and analog samples can be changed in place."""

    def __init__(self, source: Path) -> None:
        self.bytes = bytearray(source.read_bytes())
        self.header: C3dHeader = read_header(FileBytes(source), source)
        self.layout = resolve_layout(self.header, FileBytes(source), False)

    def numbers(self, group: str, name: str) -> np.ndarray:
        """Values of a parameter."""
        return self.header.numbers(group, name)

    def set(self, group: str, name: str, values: np.ndarray) -> None:
        """Other values for a parameter that is as long."""
        parameter = self.header.find(group, name)
        assert parameter is not None
        kind = {2: "h", 4: "f"}[parameter.kind]
        order, dec = self.header.processor.order, self.header.processor is Processor.DEC and kind == "f"
        scaled = values * 4.0 if dec else values  # a DEC real: words exchanged, an exponent larger by two
        raw = struct.pack(f"{order}{len(values)}{kind}", *(int(v) if kind == "h" else float(v) for v in scaled))
        if dec:
            raw = np.frombuffer(raw, "<u2").reshape(-1, 2)[:, ::-1].tobytes()
        # After the name come two bytes of offset, kind, number of dimensions and the dimensions.
        named = name.encode() if self.bytes.find(name.encode()) >= 0 else name.lower().encode()
        at = self.bytes.find(parameter.raw, self.bytes.find(named))
        assert at > 0 and len(raw) == len(parameter.raw)
        self.bytes[at : at + len(raw)] = raw

    def channels(self) -> np.ndarray:
        """Channel numbers (plates, channels), counted from 1."""
        parameter = self.header.find("FORCE_PLATFORM", "CHANNEL")
        assert parameter is not None
        return self.numbers("FORCE_PLATFORM", "CHANNEL").reshape(-1, parameter.dims[0])

    def corners(self) -> np.ndarray:
        """Corners (plates, 4, 3) in the unit of the file."""
        return self.numbers("FORCE_PLATFORM", "CORNERS").reshape(-1, 4, 3)

    def scale(self, columns: np.ndarray, factor: float) -> None:
        """Other scales for channels, counted from 1."""
        scales = self.numbers("ANALOG", "SCALE").copy()
        scales[columns.astype(int) - 1] *= factor
        self.set("ANALOG", "SCALE", scales)

    def shift(self, columns: np.ndarray, seconds: float, other: "C3dCopy | None" = None) -> None:
        """Analog samples of channels later by some time (the first ones repeated), or another file's."""
        layout, kind = self.layout, np.dtype(self.header.processor.order + ("f4" if self.layout.is_float else "i2"))
        begin = self.header.start + (self.header.data_block - 1) * 512
        width = 4 * layout.points + layout.channels * layout.ratio
        size = layout.frames * width
        stored = np.frombuffer(bytes(self.bytes[begin : begin + size * kind.itemsize]), kind).reshape(-1, width).copy()
        analog = stored[:, 4 * layout.points :].reshape(-1, layout.channels)
        index = columns.astype(int) - 1
        source = analog[:, index] if other is None else other.samples()[:, index]
        at = np.arange(len(analog)) - round(seconds * layout.rate * layout.ratio)
        analog[:, index] = source[at.clip(0, len(source) - 1)]
        stored[:, 4 * layout.points :] = analog.reshape(len(stored), -1)
        self.bytes[begin : begin + size * kind.itemsize] = stored.tobytes()

    def samples(self) -> np.ndarray:
        """Analog samples (samples, channels) as stored."""
        layout, kind = self.layout, np.dtype(self.header.processor.order + ("f4" if self.layout.is_float else "i2"))
        begin = self.header.start + (self.header.data_block - 1) * 512
        width = 4 * layout.points + layout.channels * layout.ratio
        raw = bytes(self.bytes[begin : begin + layout.frames * width * kind.itemsize])
        return np.frombuffer(raw, kind).reshape(-1, width)[:, 4 * layout.points :].reshape(-1, layout.channels)


Change = Callable[[C3dCopy, int, Draw], None]
"""Changes a copy at plate k (from 0)."""


def _order(copy: C3dCopy, k: int, places: tuple[int, ...]) -> None:
    corners = copy.corners().copy()
    corners[k] = corners[k][list(places)]
    copy.set("FORCE_PLATFORM", "CORNERS", corners.ravel())


def _corner_unit(copy: C3dCopy, k: int, draw: Draw) -> None:
    corners = copy.corners().copy()
    corners[k] /= 1000.0
    copy.set("FORCE_PLATFORM", "CORNERS", corners.ravel())


def _origin(copy: C3dCopy, k: int, factor: float) -> None:
    origins = copy.numbers("FORCE_PLATFORM", "ORIGIN").reshape(-1, 3).copy()
    origins[k, 2] *= factor
    copy.set("FORCE_PLATFORM", "ORIGIN", origins.ravel())


def _mirror(copy: C3dCopy, k: int, draw: Draw) -> None:
    copy.scale(copy.channels()[k][list([(0, 4, 5), (1, 3, 5)][int(draw.integers(2))])], -1.0)


def _exchange(copy: C3dCopy, k: int, draw: Draw) -> None:
    channels = copy.channels().copy()
    a, b = draw.choice(6, 2, replace=False)
    channels[k, [a, b]] = channels[k, [b, a]]
    copy.set("FORCE_PLATFORM", "CHANNEL", channels.ravel())


def _exchange_plates(copy: C3dCopy, k: int, draw: Draw) -> None:
    channels = copy.channels().copy()
    j = int(draw.choice([i for i in range(len(channels)) if i != k]))
    channels[[k, j]] = channels[[j, k]]
    copy.set("FORCE_PLATFORM", "CHANNEL", channels.ravel())


def _late(copy: C3dCopy, columns: np.ndarray, draw: Draw) -> None:
    copy.shift(columns[columns > 0], float(draw.choice([-1, 1]) * draw.uniform(0.05, 0.3)))


def _every(copy: C3dCopy) -> np.ndarray:
    return copy.channels()[copy.channels() > 0].ravel()


def c3d_faults(loaded: list[int], mass_kg: float | None, others: list[Path]) -> list[Fault]:
    """Faults of a C3D; ``loaded`` are the plates (from 0) that somebody stands on."""
    changes: dict[str, Change] = {name: lambda c, k, d, p=p: _order(c, k, p) for name, p in TURNS.items()}
    changes |= {name: lambda c, k, d, p=p: _order(c, k, p[int(d.integers(len(p)))]) for name, p in ORDERS.items()}
    changes |= {
        "mirrored": _mirror,
        "channels exchanged": _exchange,
        "plates exchanged": _exchange_plates,
        "corners in m": _corner_unit,
        "origin's sign": lambda c, k, d: _origin(c, k, -1.0),
        "origin's z missing": lambda c, k, d: _origin(c, k, 0.0),
        "N mm": lambda c, k, d: c.scale(c.channels()[k][3:6], 1000.0),
        "kN": lambda c, k, d: c.scale(_every(c), 1e-3),
        "volts": lambda c, k, d: c.scale(_every(c), _volts(d)),
        "reversed": lambda c, k, d: c.scale(_every(c), -1.0),
        "plate late": lambda c, k, d: _late(c, c.channels()[k], d),
        "all late": lambda c, k, d: _late(c, _every(c), d),
    }
    if mass_kg:
        changes["body weights"] = lambda c, k, d: c.scale(_every(c), 1 / (GRAVITY * mass_kg))
    if others:
        changes["another trial's"] = lambda c, k, d: c.shift(
            _every(c), 0.0, C3dCopy(others[int(d.integers(len(others)))])
        )
    return [Fault(name, _c3d_plant(change, loaded)) for name, change in changes.items()]


def _c3d_plant(change: Change, loaded: list[int]) -> Callable[[Path, Path, Draw], None]:
    def plant(source: Path, target: Path, draw: Draw) -> None:
        copy = C3dCopy(source)
        change(copy, int(draw.choice(loaded)), draw)
        target.write_bytes(bytes(copy.bytes))

    return plant


def _volts(draw: Draw) -> float:
    return float(10 ** draw.uniform(-4.0, -3.3))


UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)


def mot_faults(mass_kg: float | None, others: list[Path]) -> list[Fault]:
    """Faults of a MOT whose markers stand in a TRC of Y up."""
    changes: dict[str, Callable[[np.ndarray, list[str], Draw], np.ndarray]] = {
        "Z up beside Y up": lambda v, c, d: _turned(v, c, UP),
        "axes turned": lambda v, c, d: _turned(v, c, _about_y(float(d.choice([90, 180, 270])))),
        "left-handed": lambda v, c, d: _turned(v, c, np.diag([[-1.0, 1, 1], [1.0, 1, -1]][int(d.integers(2))])),
        "N mm": lambda v, c, d: _scaled(v, c, m=1000.0),
        "kN": lambda v, c, d: _scaled(v, c, v=1e-3, m=1e-3),
        "volts": lambda v, c, d: (lambda g: _scaled(v, c, v=g, m=g))(_volts(d)),
        "reversed": lambda v, c, d: _scaled(v, c, v=-1.0, m=-1.0),
    }
    if mass_kg:
        weight = GRAVITY * mass_kg
        changes["body weights"] = lambda v, c, d: _scaled(v, c, v=1 / weight, m=1 / weight)
    found = [Fault(name, _mot_plant(change)) for name, change in changes.items()]
    return [*found, Fault("all late", _mot_late), *([Fault("another trial's", _mot_other(others))] if others else [])]


def _mot_plant(change: Callable[[np.ndarray, list[str], Draw], np.ndarray]) -> Callable[[Path, Path, Draw], None]:
    def plant(source: Path, target: Path, draw: Draw) -> None:
        storage = read_storage(source)
        _write(target, storage, change(storage.values.copy(), list(storage.columns), draw))

    return plant


def _mot_late(source: Path, target: Path, draw: Draw) -> None:
    storage = read_storage(source)
    _write(target, storage, storage.values, storage.time + float(draw.choice([-1, 1]) * draw.uniform(0.05, 0.3)))


def _mot_other(others: list[Path]) -> Callable[[Path, Path, Draw], None]:
    def plant(source: Path, target: Path, draw: Draw) -> None:
        storage = read_storage(others[int(draw.integers(len(others)))])
        _write(target, storage, storage.values, storage.time - storage.time[0] + read_storage(source).time[0])

    return plant


def _turned(values: np.ndarray, columns: list[str], matrix: np.ndarray) -> np.ndarray:
    for group, kind in vectors(columns):
        sign = np.linalg.det(matrix) if kind == "m" else 1.0
        values[:, group] = values[:, group] @ matrix.T * sign
    return values


def _scaled(values: np.ndarray, columns: list[str], **factors: float) -> np.ndarray:
    for group, kind in vectors(columns):
        values[:, group] *= factors.get(kind, 1.0)
    return values


def _about_y(angle: float) -> np.ndarray:
    c, s = round(np.cos(np.radians(angle))), round(np.sin(np.radians(angle)))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], float)


def vectors(columns: list[str]) -> list[tuple[list[int], str]]:
    """Triples of columns that form a vector, each as v, p or m."""
    found = []
    for k, name in enumerate(columns[:-2]):
        if name.endswith("x") and [c[-1] for c in columns[k : k + 3]] == ["x", "y", "z"]:
            stem = name[:-1].lower()
            kind = "m" if "torque" in stem or "moment" in stem or stem.endswith("_m") else stem[-1]
            found.append(([k, k + 1, k + 2], kind))
    return found


def _write(target: Path, storage: Storage, values: np.ndarray, time: np.ndarray | None = None) -> None:
    write_storage(target, storage.columns, storage.time if time is None else time, values)
