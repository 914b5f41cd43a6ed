"""Plants faults of force plates into the shared recordings and counts what is named.

    scripts/plate_faults                   # every fault once in every recording, at places drawn by lot
    scripts/plate_faults --only HC03 --faults turned   # some of them

A fault is named right if the one line advised, added to the trial and read again, gives the forces of the right file.
"""

import glob
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import yaml
from harness.command import DATA, Command, said_seed
from harness.pool import processes
from harness.rows import write_lines
from planted_faults.planted_plates import C3dCopy, Fault, c3d_faults, mot_faults
from rich.console import Console
from rich.progress import track

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.judge import judge
from torchid.checks.plates_against_feet.session import Recording as Again
from torchid.checks.plates_against_feet.session import judge_recording
from torchid.checks.recording import stated_mass
from torchid.config.sections import Config
from torchid.errors import TorchidError
from torchid.io import ReadOptions, read_trial
from torchid.io.resample import synchronise
from torchid.recording import Forces, Trial
from torchid.session.opening import setup_of

MASSES = {
    "opencap": 62.6, "hamner": 80.47, "gait2354": 72.6, "rajagopal": 85.07, "arnold": 72.84, "welk": 57.2,
}  # fmt: skip
"""On record [kg], for recordings whose files do not say."""
UNMENDABLE = {"volts": "volts", "another trial's": "another trial"}
"""Faults that no line mends, and the word that names them."""
UNREADABLE = ("forces.short", "trial.no_overlap", "markers.subjects", "units.missing", "axes.unknown", "c3d.scale")
"""Files among the recordings that hold no walk: they test readers."""
SMALL = 0.2
"""Not named, and the forces or moments differ by less than this share from the right ones."""
CLOSE = 0.03
"""Forces are right if they differ from the right ones by less than this share (root mean square)."""
CLOSE_LAG_S = 0.02
"""Or if they are right but for a lag of this size: feet are no better clock."""


@dataclass(frozen=True)
class Recording:
    """Files of one trial."""

    name: str
    file: Path
    forces: Path | None
    mass_kg: float | None

    def read(self, faulty: Path | None = None, options: ReadOptions | None = None) -> Trial:
        """The trial, with a faulty file in place of the one that holds the forces."""
        file, forces = (faulty or self.file, None) if self.forces is None else (self.file, faulty or self.forces)
        return synchronise(read_trial(self.name, file, forces, "fit", options))


def recordings(root: Path) -> Iterator[Recording]:
    """Every recording with force plates."""
    for file in sorted(glob.glob(str(root / "**/*.c3d"), recursive=True)):
        yield Recording(Path(file).stem, Path(file), None, _mass(file))
    for file in sorted(glob.glob(str(root / "**/*.trc"), recursive=True)):
        path = Path(file)
        found = [
            p
            for p in (path.with_name("grf.mot"), path.with_name("grf_walk.mot"), path.with_name(f"{path.stem}_grf.mot"),
                      path.parent.parent / "ID" / f"{path.stem}_grf.mot")
            if p.is_file()
        ]  # fmt: skip
        if found:
            yield Recording(f"{path.parent.name}/{path.stem}", path, found[0], _mass(file))


def _mass(file: str) -> float | None:
    return next((mass for key, mass in MASSES.items() if key in file), None)


def options_of(line: str) -> ReadOptions:
    """The options of a trial to which an advised line was added, by way of a config."""
    entry = {"name": "t", "file": "t.c3d", **yaml.safe_load(f"{{{line}}}")}
    document = json.dumps({"subject": {"name": "s"}, "markers": "opencap", "trials": [entry]})
    config = Config.model_validate_json(document)
    return replace(setup_of(config).reading(config.trials[0]), wanted=frozenset())


def outcome(recording: Recording, fault: Fault, seed: int) -> dict[str, object]:
    """What becomes of one planted fault."""
    draw = np.random.default_rng(seed)
    right = recording.read()
    with tempfile.TemporaryDirectory() as folder:
        faulty = Path(folder) / f"faulty{(recording.forces or recording.file).suffix}"
        fault.plant(recording.forces or recording.file, faulty, draw)
        row: dict[str, object] = {"recording": recording.name, "fault": fault.name, "seed": seed}
        try:
            trial = recording.read(faulty)
        except TorchidError as error:
            return row | {"result": "refused", "said": str(error)[:300]}
        mass = recording.mass_kg or stated_mass(right)
        found = judge(trial, mass, lambda change: _again(recording, faulty, change))
        said = "; ".join(f"{f.what}. {f.remedy()}" for f in found)
        row |= {"changed": _difference(trial.forces, right.forces), "said": said[:600]}
        if not found:
            return row | {"result": "small" if float(str(row["changed"])) < SMALL else "silent"}
        if any(not f.changes for f in found):
            told = UNMENDABLE.get(fault.name, "")
            return row | {"result": "named" if told and told in said else "unnamed"}
        lines = [f.lines()[0] for f in found]
        try:
            mended = recording.read(faulty, options_of(lines[0]))
        except TorchidError as error:
            return row | {"result": "unreadable", "said": f"{said[:300]} -> {error}"}
        helps = not judge(mended, mass, lambda change: _again(recording, faulty, change))
        same = _same(mended, right)
        alone = all(len(f.changes) == 1 for f in found)
        among = same or any(_same(recording.read(faulty, options_of(c.line)), right) for c in found[0].changes[1:])
        result = "named" if same and alone else "among" if among else "wrong"
        return row | {"result": result, "helps": helps, "lines": lines}


def _again(recording: Recording, faulty: Path, change: Change) -> Trial | None:
    try:
        return recording.read(faulty, options_of(change.line))
    except TorchidError:
        return None


def _difference(a: Forces | None, b: Forces | None) -> float:
    """Root mean square difference of wrenches as a share of the right ones, forces and moments apart, the larger."""
    if a is None or b is None or a.wrench.shape != b.wrench.shape:
        return float("inf")
    x, y = (f.wrench.nan_to_num().reshape(-1, 2, 3) for f in (a, b))
    return float(((x - y).square().mean(dim=(0, 2)) / y.square().mean(dim=(0, 2))).sqrt().max())


def _same(mended: Trial, right: Trial) -> bool:
    if mended.forces is None or right.forces is None:
        return False
    if _difference(mended.forces, right.forces) < CLOSE:
        return True
    reach = max(1, round(CLOSE_LAG_S * right.markers.rate))
    for shift in range(-reach, reach + 1):
        moved = Forces(right.forces.time, torch.roll(right.forces.wrench, shift, 0), right.forces.plates)
        inner = slice(60, -60)
        if _difference(mended.forces.samples(inner), moved.samples(inner)) < 4 * CLOSE:
            return True
    return False


def cases(root: Path, only: str, faults: str, seed: int) -> Iterator[tuple[Recording, str, int]]:
    """Every fault in every recording that can have it."""
    draw = np.random.default_rng(seed)
    for recording in recordings(root):
        for name in _faults(recording, root):
            number = int(draw.integers(2**31))
            if only in recording.name and faults in name:
                yield recording, name, number


def _faults(recording: Recording, root: Path) -> dict[str, Fault]:
    every = list(recordings(root))
    if recording.forces is not None:
        others = [
            r.forces for r in every if r.forces and r.forces != recording.forces and _near(r.file, recording.file)
        ]
        return {f.name: f for f in mot_faults(recording.mass_kg, others)}
    try:
        trial = recording.read()
    except TorchidError:
        return {}
    if trial.forces is None or len(trial.markers.time) < 6:
        return {}
    loaded = [k for k in range(len(trial.forces.plates)) if float(trial.forces.wrench[:, k, 2].nan_to_num().max()) > 50]
    others = [
        r.file for r in every
        if r.forces is None and r.file != recording.file and r.file.parent == recording.file.parent
        and r.name[:5] == recording.name[:5] and r.name[5:] != recording.name[5:] and _alike(r.file, recording.file)
    ]  # fmt: skip
    found = c3d_faults(loaded, recording.mass_kg or stated_mass(trial), others) if loaded else []
    return {f.name: f for f in found if not (f.name == "plates exchanged" and len(trial.forces.plates) < 2)}


def _alike(a: Path, b: Path) -> bool:
    """Both have the same analog channels."""
    return all(C3dCopy(a).layout.channels == C3dCopy(x).layout.channels > 0 for x in (a, b))


def _near(a: Path, b: Path) -> bool:
    return a.parent == b.parent or a.parent.parent == b.parent.parent


def _run(case: tuple[Recording, str, int]) -> dict[str, object]:
    recording, name, seed = case
    return outcome(recording, _faults(recording, DATA)[name], seed)


def accused(recording: Recording) -> str:
    """What is said about a recording as it is, by the judgement that a run makes."""
    try:
        trial = recording.read()
    except TorchidError as error:
        return f"not read: {error.code}" if error.code not in UNREADABLE else ""
    again = Again(lambda options: recording.read(None, options), ReadOptions(), recording.mass_kg or stated_mass(trial))
    return "; ".join(f.what for f in judge_recording(trial, again))


def main() -> None:
    """Plant, judge, count."""
    arguments = Command(
        __doc__, only=("", "recordings whose name contains this"), faults=("", "faults whose name contains this"),
        seed=int, jobs=2, rows=(Path, "write every case here, one JSON a line"),
    ).asked()  # fmt: skip
    everything = list(cases(DATA, arguments.only, arguments.faults, said_seed(arguments.seed)))
    with processes(arguments.jobs) as pool:
        rows = list(track(pool.map(_run, everything), "planting", len(everything), console=Console(stderr=True)))
        right = [r for r in recordings(DATA) if arguments.only in r.name]
        wrongly = [(r.name, said) for r, said in zip(right, pool.map(accused, right), strict=True) if said]
    if arguments.rows:
        write_lines(arguments.rows, rows)
    _print(rows, right, wrongly)


def _print(rows: list[dict[str, object]], right: list[Recording], wrongly: list[tuple[str, str]]) -> None:
    results = ("named", "among", "wrong", "unnamed", "refused", "unreadable", "silent", "small")
    print(f"{'fault':22}" + "".join(f"{r:>12}" for r in results))
    for fault in (*dict.fromkeys(str(row["fault"]) for row in rows), "all"):
        own = [row["result"] for row in rows if fault in ("all", row["fault"])]
        print(f"{fault:22}" + "".join(f"{own.count(r) or '':>12}" for r in results))
    print(f"unplanted: {len(right)} recordings, accused: {wrongly or 'none'}")


if __name__ == "__main__":
    main()
