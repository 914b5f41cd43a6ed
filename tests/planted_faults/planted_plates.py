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

    def plates(self, name: str) -> np.ndarray:
        """A parameter of the plates: CHANNEL (plates, channels), from 1; CORNERS (plates, 4, 3), ORIGIN (plates, 3)."""
        parameter = self.header.find("FORCE_PLATFORM", name)
        assert parameter is not None
        shape = {"CORNERS": (4, 3), "ORIGIN": (3,)}.get(name, (parameter.dims[0],))
        return self.numbers("FORCE_PLATFORM", name).reshape(-1, *shape)

    def put(self, name: str, k: int | list[int], own: np.ndarray) -> None:
        """Another value of such a parameter for plate k, from 0, or for some plates."""
        values = self.plates(name).copy()
        values[k] = own
        self.set("FORCE_PLATFORM", name, values.ravel())

    def scale(self, columns: np.ndarray, factor: float) -> None:
        """Other scales for channels, counted from 1."""
        scales = self.numbers("ANALOG", "SCALE").copy()
        scales[columns.astype(int) - 1] *= factor
        self.set("ANALOG", "SCALE", scales)

    def shift(self, columns: np.ndarray, seconds: float, other: "C3dCopy | None" = None) -> None:
        """Analog samples of channels later by some time (the first ones repeated), or another file's."""
        layout, index = self.layout, columns.astype(int) - 1
        begin, stored = self.stored()
        analog = stored[:, 4 * layout.points :].reshape(-1, layout.channels)
        source = (self if other is None else other).samples()[:, index]
        at = np.arange(len(analog)) - round(seconds * layout.rate * layout.ratio)
        analog[:, index] = source[at.clip(0, len(source) - 1)]
        stored[:, 4 * layout.points :] = analog.reshape(len(stored), -1)
        self.bytes[begin : begin + stored.nbytes] = stored.tobytes()

    def stored(self) -> tuple[int, np.ndarray]:
        """Where the data begin, and a copy of them, a row a frame."""
        layout, kind = self.layout, np.dtype(self.header.processor.order + ("f4" if self.layout.is_float else "i2"))
        begin, width = self.header.start + (self.header.data_block - 1) * 512, 4 * layout.points
        width += layout.channels * layout.ratio
        raw = bytes(self.bytes[begin : begin + layout.frames * width * kind.itemsize])
        return begin, np.frombuffer(raw, kind).reshape(-1, width).copy()

    def samples(self) -> np.ndarray:
        """Analog samples (samples, channels) as stored."""
        return self.stored()[1][:, 4 * self.layout.points :].reshape(-1, self.layout.channels)


Change = Callable[[C3dCopy, int, Draw], None]
"""Changes a copy at plate k (from 0)."""


def _order(copy: C3dCopy, k: int, places: tuple[int, ...]) -> None:
    copy.put("CORNERS", k, copy.plates("CORNERS")[k][list(places)])


def _mirror(copy: C3dCopy, k: int, draw: Draw) -> None:
    copy.scale(copy.plates("CHANNEL")[k][list([(0, 4, 5), (1, 3, 5)][int(draw.integers(2))])], -1.0)


def _exchange(copy: C3dCopy, k: int, draw: Draw) -> None:
    own = copy.plates("CHANNEL")[k].copy()
    a, b = draw.choice(6, 2, replace=False)
    own[[a, b]] = own[[b, a]]
    copy.put("CHANNEL", k, own)


def _exchange_plates(copy: C3dCopy, k: int, draw: Draw) -> None:
    channels = copy.plates("CHANNEL")
    j = int(draw.choice([i for i in range(len(channels)) if i != k]))
    copy.put("CHANNEL", [k, j], channels[[j, k]])


def _late(copy: C3dCopy, columns: np.ndarray, draw: Draw) -> None:
    copy.shift(columns[columns > 0], float(draw.choice([-1, 1]) * draw.uniform(0.05, 0.3)))


def _every(copy: C3dCopy) -> np.ndarray:
    return copy.plates("CHANNEL")[copy.plates("CHANNEL") > 0].ravel()


def c3d_faults(loaded: list[int], mass_kg: float | None, others: list[Path]) -> list[Fault]:
    """Faults of a C3D; ``loaded`` are the plates (from 0) that somebody stands on."""
    changes: dict[str, Change] = {name: lambda c, k, d, p=p: _order(c, k, p) for name, p in TURNS.items()}
    changes |= {name: lambda c, k, d, p=p: _order(c, k, p[int(d.integers(len(p)))]) for name, p in ORDERS.items()}
    changes |= {
        "mirrored": _mirror,
        "channels exchanged": _exchange,
        "plates exchanged": _exchange_plates,
        "corners in m": lambda c, k, d: c.put("CORNERS", k, c.plates("CORNERS")[k] / 1000.0),
        "origin's sign": lambda c, k, d: c.put("ORIGIN", k, c.plates("ORIGIN")[k] * [1.0, 1.0, -1.0]),
        "origin's z missing": lambda c, k, d: c.put("ORIGIN", k, c.plates("ORIGIN")[k] * [1.0, 1.0, 0.0]),
        "N mm": lambda c, k, d: c.scale(c.plates("CHANNEL")[k][3:6], 1000.0),
        "kN": lambda c, k, d: c.scale(_every(c), 1e-3),
        "volts": lambda c, k, d: c.scale(_every(c), _volts(d)),
        "reversed": lambda c, k, d: c.scale(_every(c), -1.0),
        "plate late": lambda c, k, d: _late(c, c.plates("CHANNEL")[k], d),
        "all late": lambda c, k, d: _late(c, _every(c), d),
    }
    if mass_kg:
        changes["body weights"] = lambda c, k, d: c.scale(_every(c), 1 / (GRAVITY * mass_kg))
    if others:
        changes["another trial's"] = lambda c, k, d: c.shift(_every(c), 0.0, C3dCopy(_other(others, d)))
    return [Fault(name, _c3d_plant(change, loaded)) for name, change in changes.items()]


def _c3d_plant(change: Change, loaded: list[int]) -> Callable[[Path, Path, Draw], None]:
    def plant(source: Path, target: Path, draw: Draw) -> None:
        copy = C3dCopy(source)
        change(copy, int(draw.choice(loaded)), draw)
        target.write_bytes(bytes(copy.bytes))

    return plant


def _other(files: list[Path], draw: Draw) -> Path:
    return files[int(draw.integers(len(files)))]


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
        storage = read_storage(_other(others, draw))
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
