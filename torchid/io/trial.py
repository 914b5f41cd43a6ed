"""One trial from whatever the laboratory exported."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from torchid.errors import InputError
from torchid.io.b3d import read_b3d
from torchid.io.bids_motion import read_bids_motion
from torchid.io.c3d import read_c3d
from torchid.io.files import MOTION_BIDS, container_of
from torchid.io.frame import METRES, length_unit
from torchid.io.grf import forces_from_storage
from torchid.io.labels import select_markers
from torchid.io.mend import PlateAs
from torchid.io.options import ReadOptions
from torchid.io.raw import MarkerTable, Measured, RawTrial, assemble
from torchid.io.storage import read_storage
from torchid.io.trc import read_trc
from torchid.recording import Forces, Trial

ROLES = ("static", "fit", "heldout")
SAME_TRIAL = 0.1
"""Relative difference in length up to which markers and forces, one in ms, are of the same trial."""


def read_trial(
    name: str, file: str | Path, forces: str | Path | None = None, role: str = "fit", options: ReadOptions | None = None
) -> Trial:
    """A trial in W, SI units and float64, from C3D, TRC, .b3d or Motion-BIDS, perhaps with ground reactions as MOT/STO.

    Args:
        name: of the trial.
        file: .c3d, .trc, ``_motion.tsv``, or a trial of a .b3d as if that were a folder.
        forces: .mot or .sto; beside a .c3d or .b3d, its own plates are left out.
        role: static, fit or heldout.
        options: what the file leaves open.

    Raises:
        InputError: a file cannot be read, or files contradict themselves or each other.
    """
    file, options = Path(file), options or ReadOptions()
    container = container_of(file)
    suffix = (container or file).suffix.lower()
    if role not in ROLES:
        raise InputError(
            "trial.role", "this role does not exist", place=f"trial {name}", found=role,
            remedy=f"Use one of {', '.join(ROLES)}",
        )  # fmt: skip
    bids = file.name.endswith(MOTION_BIDS)
    if suffix not in (".c3d", ".trc", ".b3d") and not bids:
        raise InputError(
            "trial.format", "markers are read from .c3d, .trc, .b3d and _motion.tsv files", source=file,
            found=file.suffix or "no suffix",
            remedy="Export the markers as C3D or TRC; forces (.mot, .sto) are given under forces:",
        )  # fmt: skip
    measured = _read_forces(None if forces is None else Path(forces), options)
    options = options if forces is None and container is None else replace(options, moments_read=True)
    if container is not None:
        table, own = read_b3d(container, "" if container == file else file.name, _moment_gain(options))
        return _from_table(name, file, table, own if forces is None else measured, role, options)
    if suffix == ".trc" or bids:
        table = read_bids_motion(file) if bids else read_trc(file)
        return _from_table(name, file, table, measured, role, options)
    return read_c3d(file, name, role, options, measured)


def _from_table(name: str, file: Path, table: MarkerTable, forces: Measured, role: str, options: ReadOptions) -> Trial:
    source = str(file)
    chosen = select_markers(list(table.labels), source, subject=options.subject, wanted=options.wanted)
    position = table.position[:, list(chosen.columns)]
    unit, said = length_unit(table.units, position, options, source)
    measured, force_notes, facts = forces
    rate = (len(table.time) - 1) / (table.time[-1] - table.time[0]) if len(table.time) > 1 else 0.0
    _refuse_other_clock(table.time, measured, source, dict(facts).get("forces", ""))
    raw = RawTrial(
        source=source,
        labels=chosen.labels,
        time=table.time,
        position=position * METRES[unit],
        forces=measured,
        up=table.up,
        customary=table.customary,
        notes=(*table.notes, *chosen.notes, *said, *force_notes),
        lines=table.lines,
        parameters=(("format", table.kind), ("units", unit), ("rate_hz", f"{rate:.10g}"), *table.facts, *facts),
    )
    return assemble(raw, name, role, options)


def _refuse_other_clock(time: np.ndarray, measured: Forces | None, file: str, forces: str) -> None:
    """Refuse files of one trial of which one lasts a thousand times as long as the other: its times are in ms."""
    if measured is None or len(time) < 2 or len(measured.time) < 2:
        return
    own, other = float(time[-1] - time[0]), float(measured.time[-1] - measured.time[0])
    longer, ratio = (forces, other / own) if other > own else (file, own / other)
    if abs(ratio / 1e3 - 1.0) <= SAME_TRIAL:
        raise InputError(
            "time.unit", "the times of markers and forces differ by a factor of a thousand", source=longer,
            place="column time", found=f"markers last {own:g}, forces {other:g}",
            remedy="Divide the times of this file by 1000; they must be in s",
        )  # fmt: skip


def _read_forces(path: Path | None, options: ReadOptions) -> Measured:
    if path is None:
        return None, (), ()
    if path.suffix.lower() not in (".mot", ".sto"):
        raise InputError(
            "trial.format", "forces are read from .mot and .sto files", source=path, found=path.suffix or "no suffix",
            remedy="Give a MOT or STO of ground reactions",
        )  # fmt: skip

    measured, notes = forces_from_storage(read_storage(path), str(path), _moment_gain(options))
    rate = f"{measured.rate:.10g}" if len(measured.time) > 1 else "0"
    return measured, notes, (("forces", str(path)), ("analog_rate_hz", rate))


def _moment_gain(options: ReadOptions) -> Callable[[int], float]:
    """Factor of the free moments of a plate, by its number: what the user says of file and plate."""

    def gain(number: int) -> float:
        return options.forces_as.moment_gain * options.plates.get(number, PlateAs()).moment_gain

    return gain
