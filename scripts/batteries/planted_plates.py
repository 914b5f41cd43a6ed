"""Faults of force plates, written into copies of real files: bytes of a C3D, columns of a MOT.

Nothing here uses ``torchid.io.mend`` or ``torchid.agreement``: what these undo is not what plants.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchid.io.c3d_header import C3dHeader, read_header
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
        raw = struct.pack(f"<{len(values)}{kind}", *(int(v) if kind == "h" else float(v) for v in values))
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
        layout, kind = self.layout, np.dtype("<f4" if self.layout.is_float else "<i2")
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
        layout, kind = self.layout, np.dtype("<f4" if self.layout.is_float else "<i2")
        begin = self.header.start + (self.header.data_block - 1) * 512
        width = 4 * layout.points + layout.channels * layout.ratio
        raw = bytes(self.bytes[begin : begin + layout.frames * width * kind.itemsize])
        return np.frombuffer(raw, kind).reshape(-1, width)[:, 4 * layout.points :].reshape(-1, layout.channels)


def c3d_faults(loaded: list[int], mass_kg: float | None, others: list[Path]) -> list[Fault]:
    """Faults of a C3D; ``loaded`` are the plates (from 0) that somebody stands on."""

    def fault(name: str, change: Callable[[C3dCopy, int, Draw], None]) -> Fault:
        def plant(source: Path, target: Path, draw: Draw) -> None:
            copy = C3dCopy(source)
            change(copy, int(draw.choice(loaded)), draw)
            target.write_bytes(bytes(copy.bytes))

        return Fault(name, plant)

    def order(copy: C3dCopy, k: int, places: tuple[int, ...]) -> None:
        corners = copy.corners().copy()
        corners[k] = corners[k][list(places)]
        copy.set("FORCE_PLATFORM", "CORNERS", corners.ravel())

    def corner_unit(copy: C3dCopy, k: int, draw: Draw) -> None:
        corners = copy.corners().copy()
        corners[k] /= 1000.0
        copy.set("FORCE_PLATFORM", "CORNERS", corners.ravel())

    def origin(copy: C3dCopy, k: int, factor: float) -> None:
        origins = copy.numbers("FORCE_PLATFORM", "ORIGIN").reshape(-1, 3).copy()
        origins[k, 2] *= factor
        copy.set("FORCE_PLATFORM", "ORIGIN", origins.ravel())

    def mirror(copy: C3dCopy, k: int, axis: int) -> None:
        signs = [(0, 4, 5), (1, 3, 5)][axis]
        copy.scale(copy.channels()[k][list(signs)], -1.0)

    def exchange(copy: C3dCopy, k: int, draw: Draw) -> None:
        channels = copy.channels().copy()
        a, b = draw.choice(6, 2, replace=False)
        channels[k, [a, b]] = channels[k, [b, a]]
        copy.set("FORCE_PLATFORM", "CHANNEL", channels.ravel())

    def plates(copy: C3dCopy, k: int, draw: Draw) -> None:
        channels = copy.channels().copy()
        j = int(draw.choice([i for i in range(len(channels)) if i != k]))
        channels[[k, j]] = channels[[j, k]]
        copy.set("FORCE_PLATFORM", "CHANNEL", channels.ravel())

    def late(copy: C3dCopy, k: int, draw: Draw, whole: bool) -> None:
        columns = copy.channels().ravel() if whole else copy.channels()[k]
        copy.shift(columns[columns > 0], float(draw.choice([-1, 1]) * draw.uniform(0.05, 0.3)))

    def other(copy: C3dCopy, k: int, draw: Draw) -> None:
        columns = copy.channels().ravel()
        copy.shift(columns[columns > 0], 0.0, C3dCopy(others[int(draw.integers(len(others)))]))

    every = lambda copy: copy.channels()[copy.channels() > 0].ravel()  # noqa: E731
    found = [fault(name, lambda c, k, d, p=p: order(c, k, p)) for name, p in TURNS.items()]
    found += [fault(name, lambda c, k, d, p=p: order(c, k, p[int(d.integers(len(p)))])) for name, p in ORDERS.items()]
    found += [
        fault("mirrored", lambda c, k, d: mirror(c, k, int(d.integers(2)))),
        fault("channels exchanged", exchange), fault("corners in m", corner_unit),
        fault("origin's sign", lambda c, k, d: origin(c, k, -1.0)),
        fault("origin's z missing", lambda c, k, d: origin(c, k, 0.0)),
        fault("N mm", lambda c, k, d: c.scale(c.channels()[k][3:6], 1000.0)),
        fault("kN", lambda c, k, d: c.scale(every(c), 1e-3)),
        fault("volts", lambda c, k, d: c.scale(every(c), float(10 ** d.uniform(-3, -2.3)) / 10)),
        fault("reversed", lambda c, k, d: c.scale(every(c), -1.0)),
        fault("plate late", lambda c, k, d: late(c, k, d, False)),
        fault("all late", lambda c, k, d: late(c, k, d, True)),
    ]  # fmt: skip
    if mass_kg:
        found.append(fault("body weights", lambda c, k, d: c.scale(every(c), 1 / (9.80665 * mass_kg))))
    if others:
        found.append(fault("another trial's", other))
    return [*found, fault("plates exchanged", plates)]


def mot_faults(mass_kg: float | None, others: list[Path]) -> list[Fault]:
    """Faults of a MOT whose markers stand in a TRC of Y up."""

    def fault(name: str, change: Callable[[np.ndarray, list[str], Draw], np.ndarray]) -> Fault:
        def plant(source: Path, target: Path, draw: Draw) -> None:
            storage = read_storage(source)
            _write(target, storage, change(storage.values.copy(), list(storage.columns), draw))

        return Fault(name, plant)

    def late(source: Path, target: Path, draw: Draw) -> None:
        storage = read_storage(source)
        lag = float(draw.choice([-1, 1]) * draw.uniform(0.05, 0.3))
        _write(target, storage, storage.values, storage.time + lag)

    def other(source: Path, target: Path, draw: Draw) -> None:
        storage = read_storage(others[int(draw.integers(len(others)))])
        begin = read_storage(source).time[0]
        _write(target, storage, storage.values, storage.time - storage.time[0] + begin)

    def turned(values: np.ndarray, columns: list[str], matrix: np.ndarray) -> np.ndarray:
        for group, kind in vectors(columns):
            sign = np.linalg.det(matrix) if kind == "m" else 1.0
            values[:, group] = values[:, group] @ matrix.T * sign
        return values

    def scaled(values: np.ndarray, columns: list[str], **factors: float) -> np.ndarray:
        for group, kind in vectors(columns):
            values[:, group] *= factors.get(kind, 1.0)
        return values

    def about_y(angle: float) -> np.ndarray:
        c, s = round(np.cos(np.radians(angle))), round(np.sin(np.radians(angle)))
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], float)

    up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
    volts = lambda d: float(10 ** d.uniform(-3, -2.3)) / 10  # noqa: E731
    found = [
        fault("Z up beside Y up", lambda v, c, d: turned(v, c, up)),
        fault("axes turned", lambda v, c, d: turned(v, c, about_y(float(d.choice([90, 180, 270]))))),
        fault("left-handed", lambda v, c, d: turned(v, c, np.diag([[-1.0, 1, 1], [1.0, 1, -1]][int(d.integers(2))]))),
        fault("N mm", lambda v, c, d: scaled(v, c, m=1000.0)),
        fault("kN", lambda v, c, d: scaled(v, c, v=1e-3, m=1e-3)),
        fault("volts", lambda v, c, d: (lambda g: scaled(v, c, v=g, m=g))(volts(d))),
        fault("reversed", lambda v, c, d: scaled(v, c, v=-1.0, m=-1.0)),
        Fault("all late", late),
    ]
    if mass_kg:
        weight = 9.80665 * mass_kg
        found.append(fault("body weights", lambda v, c, d: scaled(v, c, v=1 / weight, m=1 / weight)))
    return [*found, *([Fault("another trial's", other)] if others else [])]


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
