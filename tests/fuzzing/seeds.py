"""Sound files that are damaged: small ones made here, and short real ones where they are."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import yaml
from c3d_bytes import DEC, INTEL, MIPS, C3dBuilder
from harness.command import DATA
from trc_files import write_trc

from fuzzing.texts import CONFIG, FULL_CONFIG, MARKERS, MJCF, MJCF_PLAIN, URDF
from torchid.io.storage import write_storage
from torchid.model.marker_set import FOLDER
from torchid.model.urdf import read_urdf, write_urdf
from torchid.recording import Markers

KINDS = ("c3d", "trc", "mot", "sto", "config", "marker_set", "urdf", "mjcf")
FRAMES, MARKERS_SEEN, RATE = 24, 6, 100.0
REAL_BYTES = 400_000
"""Larger real files are left out: reading them would take most of the time."""


@dataclass(frozen=True)
class Seed:
    """A sound file of one kind."""

    name: str
    content: bytes
    suffix: str
    beside: dict[str, bytes] = field(default_factory=dict)
    """Other files that the reader needs, by name."""


def seeds(kind: str, folder: Path) -> list[Seed]:
    """All sound files of a kind; ``folder`` is for writers that need one."""
    made = {
        "c3d": _c3d,
        "trc": _trc,
        "mot": lambda at: _storage(at, ".mot"),
        "sto": lambda at: _storage(at, ".sto"),
        "config": _configs,
        "marker_set": _marker_sets,
        "urdf": _urdf,
        "mjcf": lambda at: [Seed("tree", MJCF.encode(), ".xml"), Seed("plain", MJCF_PLAIN.encode(), ".xml")],
    }
    return made[kind](folder)


def walker(frames: int = FRAMES) -> tuple[np.ndarray, np.ndarray]:
    """Markers (frames, markers, 3) [m], Z up, and the wrench (frames, 2, 6) of two plates under a person's feet."""
    random = np.random.default_rng(0)
    t = np.arange(frames) / RATE
    base = random.uniform([-0.2, -0.2, 0.3], [0.2, 0.2, 1.4], (MARKERS_SEEN, 3))
    base[:2] = [[0.1, 0.2, 0.05], [0.0, 0.0, 1.7]]
    swing = 0.05 * np.sin(3.0 * t[:, None, None] + random.uniform(0.0, 6.0, (1, MARKERS_SEEN, 3)))
    share = 0.5 + 0.4 * np.sin(4.0 * t)
    force = np.stack([20.0 * np.cos(5.0 * t), 10.0 * np.sin(6.0 * t), 700.0 + 30.0 * np.sin(9.0 * t)], axis=1)
    both = np.stack([force * share[:, None], force * (1.0 - share[:, None])], axis=1)
    point = np.zeros((frames, 2, 3))
    point[..., 0] = np.array([0.15, -0.15]) + 0.02 * np.sin(2.0 * t)[:, None]
    return base + swing, np.concatenate([both, np.cross(point, both)], axis=2)


def _c3d(folder: Path) -> list[Seed]:
    made = [
        Seed(f"{'integer' if scale > 0 else 'real'} {name}", _builder(processor, scale).build(), ".c3d")
        for name, processor in (("Intel", INTEL), ("DEC", DEC), ("MIPS", MIPS))
        for scale in (-0.1, 0.1)
    ]
    bare = _builder(INTEL, -1.0)
    bare.analogs, bare.ratio, bare.parameters = np.zeros((0, 0)), 0, {}
    made += [Seed("markers only", bare.build(), ".c3d"), Seed("Kistler", _builder(INTEL, -0.1, 3).build(), ".c3d")]
    return made + _real(".c3d")


def _builder(processor: int, scale: float, kind: int = 2) -> C3dBuilder:
    """A walker on two plates of type 2 or 3 with what programs usually write beside."""
    position, wrench = walker()
    analogs = np.repeat(_channels(wrench, kind), 2, axis=0)
    edge = np.array([[0.25, 0.3], [-0.25, 0.3], [-0.25, -0.3], [0.25, -0.3]])
    middle = np.array([0.3, -0.3])
    corners = np.zeros((3, 4, 2))
    for k in range(2):
        corners[:2, :, k] = (edge + [middle[k], 0.0]).T * 1000.0
    wide = analogs.shape[1] // 2
    units = ["N"] * 3 + ["Nmm"] * 3 if kind == 2 else ["N"] * 8
    names = [f"Marker{k}" for k in range(MARKERS_SEEN)]
    plates = {
        "USED": np.array([2]), "TYPE": np.array([kind, kind]), "CHANNEL": np.arange(1, 2 * wide + 1).reshape(2, wide).T,
        "CORNERS": corners, "ORIGIN": np.array([[0.0, 0.0], [0.0, 0.0], [-40.0, -40.0]]), "ZERO": np.array([1, 0]),
    }  # fmt: skip
    if kind == 3:
        plates["ORIGIN"] = np.array([[120.0, 120.0], [200.0, 200.0], [-40.0, -40.0]])
    return C3dBuilder(
        points=np.round(position * 10000.0) / 10.0, labels=names, analogs=np.round(analogs), ratio=2, rate=RATE,
        scale=scale, processor=processor,
        parameters={
            "POINT": {"DESCRIPTIONS": names, "X_SCREEN": ["+X"], "Y_SCREEN": ["+Z"]},
            "ANALOG": {"UNITS": units * 2}, "FORCE_PLATFORM": plates,
            "TRIAL": {"ACTUAL_START_FIELD": np.array([1, 0]), "ACTUAL_END_FIELD": np.array([FRAMES, 0])},
            "EVENT": {"USED": np.array([1]), "LABELS": ["Foot Strike"], "CONTEXTS": ["Left"],
                      "TIMES": np.array([[0.0], [0.1]])},
            "SUBJECTS": {"NAMES": ["S01"]}, "PROCESSING": {"Bodymass": np.array([71.4])},
        },
    )  # fmt: skip


def _channels(wrench: np.ndarray, kind: int) -> np.ndarray:
    """Analog channels of plates whose X is the world's, Y and Z its opposites, 40 mm above the transducer."""
    found = []
    for k, middle in enumerate((0.3, -0.3)):
        force = wrench[:, k, :3] * [1.0, -1.0, -1.0]
        about = wrench[:, k, 3:] - np.cross([middle, 0.0, 0.0], wrench[:, k, :3])
        moment = about * [1.0, -1.0, -1.0] + np.cross([0.0, 0.0, -0.04], force)
        if kind == 2:
            found.append(np.concatenate([force, moment * 1000.0], axis=1))
            continue
        half, quarter = 0.5 * force[:, :2], 0.25 * force[:, 2]
        side, front = 0.25 * moment[:, 0] / 0.2, 0.25 * moment[:, 1] / 0.12
        upright = [quarter + side - front, quarter + side + front, quarter - side + front, quarter - side - front]
        found.append(np.stack([half[:, 0], half[:, 0], half[:, 1], half[:, 1], *upright], axis=1))
    return np.concatenate(found, axis=1)


def _trc(folder: Path) -> list[Seed]:
    made = _markers(folder)
    lines = made.decode().split("\n")
    head = [*lines[:3], "Frame#\tTime\t" + "\t\t\t".join(f"Marker{k}" for k in range(MARKERS_SEEN)), lines[4]]
    in_mm = "\n".join([*head, "", *(_in_mm(line) for line in lines[6:])]).replace("\tm\t", "\tmm\t")
    gaps = "\r\n".join(_with_gap(k, line) for k, line in enumerate(lines))
    return [Seed("own", made, ".trc"), Seed("mm", in_mm.encode(), ".trc"), Seed("gaps", gaps.encode(), ".trc"),
            *_real(".trc")]  # fmt: skip


def _markers(folder: Path) -> bytes:
    position, _ = walker()
    labels = ("LASI", "RASI", "LKNE", "RKNE", "LHEE", "RHEE")[:MARKERS_SEEN]
    time = torch.arange(FRAMES, dtype=torch.float64) / RATE
    write_trc(folder / "walker.trc", Markers(labels, time, torch.from_numpy(position)))
    return (folder / "walker.trc").read_bytes()


def _in_mm(line: str) -> str:
    cells = line.split("\t")
    return "\t".join([*cells[:2], *(f"{float(cell) * 1000.0:.3f}" for cell in cells[2:])]) if len(cells) > 2 else line


def _with_gap(k: int, line: str) -> str:
    cells = line.split("\t")
    return "\t".join([*cells[:5], "", "", "", *cells[8:]]) if 10 <= k < 15 and len(cells) > 8 else line


def _storage(folder: Path, suffix: str) -> list[Seed]:
    """Ground reactions in two styles, beside the markers that belong to them."""
    _, wrench = walker()
    turned = wrench[..., [0, 2, 1, 3, 5, 4]] * [1.0, 1.0, -1.0, 1.0, 1.0, -1.0]
    columns, values = [], []
    for k in range(2):
        for what in "vpm":
            columns += [f"ground_force_{k + 1}_{what}{axis}" for axis in "xyz"]
        force, moment = turned[:, k, :3], turned[:, k, 3:]
        x, z = moment[:, 2] / force[:, 1], -moment[:, 0] / force[:, 1]
        point = np.stack([x, 0.0 * x, z], axis=1)
        values += [force, point, moment - np.cross(point, force)]
    table = np.round(np.concatenate(values, axis=1), 6)
    path = folder / f"walker{suffix}"
    write_storage(path, tuple(columns), np.arange(FRAMES) / RATE, table)
    own, beside = path.read_bytes(), {"beside.trc": _markers(folder)}
    body = own.decode().split("endheader\n")[1]
    simm = f"walker\ndatacolumns {table.shape[1] + 1}\ndatarows {FRAMES}\nrange 0.0 0.23\nendheader\n{body}"
    other = (
        simm if suffix == ".mot" else own.decode().replace("version=1", "version=3\nDataType=double\nOpenSimVersion=4")
    )
    return [Seed("own", own, suffix, beside), Seed("other", other.encode(), suffix, beside)]


def _configs(folder: Path) -> list[Seed]:
    beside = {"walk.c3d": b"-", "stand.trc": b"-", "stand.mot": b"-"}
    made = [Seed("plain", CONFIG.encode(), ".yaml", beside), Seed("full", FULL_CONFIG.encode(), ".yaml", beside)]
    flow = yaml.safe_dump(yaml.safe_load(CONFIG), default_flow_style=True, width=60)
    return [*made, Seed("flow", flow.encode(), ".yaml", beside)]


def _marker_sets(folder: Path) -> list[Seed]:
    built_in = [FOLDER / f"{name}.yaml" for name in ("arnold2013", "plug_in_gait")]
    return [Seed("own", MARKERS.encode(), ".yaml"), *(Seed(path.stem, path.read_bytes(), ".yaml") for path in built_in)]


def _urdf(folder: Path) -> list[Seed]:
    (folder / "a.urdf").write_text(URDF)
    model, _ = read_urdf(folder / "a.urdf")
    geometry = model.geometry.geometry(model.geometry.mean)
    write_urdf(model.tree, geometry, model.inertia.mean, folder / "b.urdf", {"toe": ("hand", (0.0, 0.1, 0.0))})
    return [Seed("by hand", URDF.encode(), ".urdf"), Seed("own", (folder / "b.urdf").read_bytes(), ".urdf")]


def _real(suffix: str) -> list[Seed]:
    """The shortest real recordings, where they are."""
    found = sorted(path for path in DATA.rglob(f"*{suffix}")) if DATA.is_dir() else []
    short = [path for path in found if path.stat().st_size < REAL_BYTES][:4]
    return [Seed(str(path.relative_to(DATA)), path.read_bytes(), suffix) for path in short]
