"""A laboratory's faults planted alike in all of its sessions: does the cohort name them, where one session cannot?

    scripts/module test batteries.pooled --seed 5101                    # the six shared children
    scripts/module test batteries.pooled --seed 5101 --simulated 12     # twelve people by lot, of the own simulator
    scripts/module test batteries.pooled --seed 5101 --simulated 12 --cohorts 20 --kinds none
    scripts/module test batteries.pooled --summary                      # judge again what is kept

Every session is run as recorded and with each fault up to its evidence of the laboratory (``laboratory.nc``), which
is kept; then the sessions of each fault are pooled. Places, signs and directions are by lot, the same for all sessions
of a fault. Without a fault, nothing may be named. Each of several cohorts has places and signs of its own, and people
where these are simulated.
"""

import json
import shutil
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from harness.command import DATA, Command, said_seed
from harness.pool import performed
from harness.rows import read_lines
from planted_faults import real_forces as forces
from planted_faults import real_markers as markers
from planted_faults.real_files import Recorded, frames_kept, read_recorded, write_session
from planted_faults.real_kinds import UNPLANTED
from planted_faults.real_plates import RealPlate, used_plates
from planted_faults.real_sessions import CHILDREN, SESSIONS, File, RealSession

from batteries.remembered import remembering
from torchid.cohort.laboratories import Laboratory, laboratories
from torchid.cohort.pooling import SharedFault, pooled
from torchid.config import load_config
from torchid.diagnosis.verdict.records import EVEN
from torchid.errors import TorchidError
from torchid.extension.diagnosing import diagnose_outcome
from torchid.extension.statements import panel_of
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.session.laboratory import NAME, earlier_sessions, read_laboratory
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session

PLATE_KINDS = ("place", "turn", "gain", "crosstalk", "offset")
KINDS = (*PLATE_KINDS, "tilt", "clock", "scale")
"""Faults: a plate's place by 15 mm, turn by 2 degrees, gain by 3 %, crosstalk of 2 %, offset of 4 N; a tilt of half a
degree, a clock by 8 ms, the cameras' scale by 0.5 %."""
NEAR_M = 0.1
"""Choice. Distance of centres up to which two sessions have the same plate [m]."""


@dataclass(frozen=True)
class Case:
    """One session with one fault."""

    session: str
    kind: str
    seed: int

    @property
    def key(self) -> str:
        """Its name."""
        return f"{self.kind}-{self.seed}-{self.session}"


def planted(kind: str, recorded: Recorded, seed: int) -> tuple[Recorded, dict[str, Any]]:
    """A session with a fault of a kind, and the truth: effect, place and parameters."""
    draw = np.random.default_rng(zlib.crc32(f"{seed} {kind}".encode()))
    sign, angle, which = float(draw.choice([-1.0, 1.0])), float(draw.uniform(-np.pi, np.pi)), float(draw.uniform())
    if kind == UNPLANTED:
        return recorded, {}
    if kind in PLATE_KINDS:
        plate = _plate(recorded, which)
        changed, truth = _on_plate(kind, recorded, plate, sign, angle)
        return changed, _truth(truth, plate.frame.p_WF.tolist())
    changed, truth = {
        "tilt": lambda: forces.plant_tilt(recorded, angle, True, 0.5),
        "clock": lambda: forces.plant_clock(recorded, sign * 0.008),
        "scale": lambda: markers.plant_scale(recorded, 1.0 + sign * 0.005),
    }[kind]()
    return changed, _truth(truth, None)


def _plate(recorded: Recorded, which: float) -> RealPlate:
    """One that bears something in most sessions, by lot: their order is that of their places, to a centimetre."""
    some = sorted(used_plates(recorded), key=lambda one: one.frame.p_WF.round(decimals=2).tolist())
    return some[int(which * len(some))]


def _on_plate(kind: str, recorded: Recorded, plate: RealPlate, sign: float, angle: float) -> Any:
    level = np.array([np.cos(angle), np.sin(angle)])
    if kind == "place":
        return forces.plant_pose(recorded, plate, (0.015 * level).tolist(), 0.0)
    if kind == "turn":
        return forces.plant_pose(recorded, plate, (0.0, 0.0), sign * np.radians(2.0))
    if kind == "gain":
        return forces.plant_gain(recorded, [plate], 1.0 + sign * 0.03)
    if kind == "crosstalk":
        return forces.plant_crosstalk(recorded, plate, int(angle > 0.0), sign * 0.02)
    lean = np.array([*(0.8 * level), 0.6 * sign])
    return forces.plant_offset(recorded, plate, (4.0 * lean).tolist(), False)


def _truth(truth: Any, centre: Sequence[float] | None) -> dict[str, Any]:
    own = truth.right[0]
    return {"effect": own.effect, "centre": centre, "parameters": own.parameters}


def people(count: int, seed: int, folder: Path, first: int = 0) -> list[tuple[RealSession, Path]]:
    """Simulated sessions from a number on, each with the folder of its files; the shared children where none is asked
    for."""
    if not count:
        return [(one, DATA) for one in SESSIONS if one.name in CHILDREN]
    found = []
    for k in range(first, first + count):
        own = folder / f"person_{k}"
        if not (own / "config.json").is_file():
            made = simulate_session(OPTIONS, seed + k, own)
            assert made.config is not None
            (own / "config.json").write_text(json.dumps(_said(load_config(made.config), own)))
        said = json.loads((own / "config.json").read_text())
        moving = tuple(File(*one) for one in said["moving"])
        found.append((RealSession(f"person_{k}", said["subject"], said["markers"], moving, File(*said["static"])), own))
    return found


OPTIONS = SimulateOptions(fit=("sway_steps",), heldout=())
"""Choice. Standing, and steps over the plates for some seconds, as short as a clinic's walks."""


def _said(config: Any, folder: Path) -> dict[str, Any]:
    """What is needed of a simulated session's config."""
    files = {one.name: str(Path(one.file).relative_to(folder.resolve())) for one in config.trials}
    static = [one.name for one in config.trials if one.role == "static"]
    subject = config.subject.model_dump(exclude_none=True, exclude_defaults=True)
    return {
        "subject": subject, "markers": config.markers if isinstance(config.markers, str) else str(config.markers),
        "static": [static[0], files[static[0]]],
        "moving": [[name, file] for name, file in files.items() if name not in static],
    }  # fmt: skip


def perform(
    case: Case, some: dict[str, tuple[RealSession, Path]], out: Path, laboratory: Path | None = None
) -> dict[str, Any]:
    """Plant, run up to the first verdict, and keep the evidence; with the file of a laboratory, what it makes of it."""
    session, root = some[case.session]
    folder = out / "scratch" / case.key
    recorded = read_recorded(session, "none", root)
    kept = [frames_kept(trial) for trial in recorded.trials]
    faulty, truth = planted(case.kind, recorded, case.seed)
    shutil.rmtree(folder, ignore_errors=True)
    row: dict[str, Any] = {"key": case.key, **asdict(case), "truth": truth}
    try:
        config = load_config(write_session(faulty, session, folder, kept))
        with (
            patch("torchid.run.sequence.write_report"),
            patch("torchid.run.sequence.with_verdict", _first_verdict),
            remembering(out / "fits"),
        ):
            outcome = run_experiment(config.model_copy(update={"laboratory": laboratory}))
        assert outcome.diagnosis is not None
        row["named"] = [(c.effect, c.where, c.confidence) for c in outcome.diagnosis.causes]
        if outcome.diagnosis.earlier is None:
            (out / "evidence").mkdir(parents=True, exist_ok=True)
            shutil.copy(config.out / NAME, out / "evidence" / f"{case.key}.nc")
        else:
            row["earlier"] = asdict(outcome.diagnosis.earlier)
            row["plates"] = {p.frame.name: p.frame.p_WF.tolist() for p in outcome.diagnosis.plates}
    except TorchidError as error:
        row["failed"] = f"{error.code}: {error.message}"
    shutil.rmtree(folder, ignore_errors=True)
    return row


def _first_verdict(outcome: Outcome, folder: Any, key: str, progress: Any) -> Outcome:
    """The verdict without the model that is extended by it, which says nothing more of the laboratory."""
    earlier = earlier_sessions(outcome.config.laboratory, outcome.session)
    return replace(outcome, diagnosis=diagnose_outcome(outcome, folder.room, panel_of(outcome), earlier))


def tables(rows: Sequence[dict[str, Any]], evidence: Path) -> Iterator[str]:
    """A line for each fault: what all sessions together say, and how many say it alone."""
    for kind, seed in dict.fromkeys((row["kind"], row["seed"]) for row in rows):
        own = {r["session"]: r for r in rows if (r["kind"], r["seed"]) == (kind, seed) and "failed" not in r}
        found = {name: read_laboratory(evidence / f"{row['key']}.nc") for name, row in own.items()}
        home = max(laboratories(found, {}), key=lambda one: len(one.visits))
        faults = [one for one in pooled(home).faults if one.confidence > EVEN]
        truth = next(iter(own.values()))["truth"]
        said = "; ".join(_said_of(one, home, truth) for one in faults) or "nothing"
        alone = sum(
            any(effect == truth.get("effect") and sure > EVEN for effect, _, sure in r["named"]) for r in own.values()
        )
        right = not faults if not truth else bool(faults) and all(is_planted(one, home, truth) for one in faults)
        yield f"{kind:10s} seed {seed}, {len(own)} sessions: {'right' if right else 'wrong'}: {said}; alone {alone}"


def is_planted(one: SharedFault, home: Laboratory, truth: dict[str, Any]) -> bool:
    """Whether a fault is what was planted, at its place."""
    if one.effect != truth.get("effect"):
        return False
    if truth["centre"] is None:
        return True
    centre = torch.tensor(truth["centre"], dtype=torch.float64)
    near = {p.frame.name for p in home.plates if float((p.frame.p_WF - centre)[:2].norm()) < NEAR_M}
    return set(one.where) == near


def _said_of(one: SharedFault, home: Laboratory, truth: dict[str, Any]) -> str:
    """A fault with its confidence and, where it is right, how far its size is off."""
    said = f"{one.effect} ({', '.join(one.where)}) {one.confidence:.2f}"
    if not is_planted(one, home, truth):
        return said
    for key, true in truth["parameters"].items():
        wanted, value = (
            torch.as_tensor(x, dtype=torch.float64).reshape(-1) for x in (true, one.parameters[key]["value"])
        )
        zero = torch.ones_like(wanted) if key in ("gain", "scale") else torch.zeros_like(wanted)
        off = float((value - wanted).norm() / (wanted - zero).norm())
        said += f", {key} off by {100.0 * off:.0f} %"
    return said


def main(given: Sequence[str] | None = None) -> None:
    """Run what is missing, pool, print tables."""
    command = Command(
        __doc__, seed=(int, "of places, signs and people (default: drawn)"), jobs=2,
        simulated=(0, "people by lot of the own simulator; 0: the shared children"),
        cohorts=(1, "so many, with a seed each from the first on"),
        kinds=({"nargs": "+", "default": [UNPLANTED, *KINDS], "metavar": "KIND"}, ", ".join(KINDS)),
        out=(Path("out/pooled"), "folder of evidence and rows"), summary=(False, "only judge what is kept"),
    )  # fmt: skip
    asked = command.asked(given)
    if not asked.summary:
        asked.seed = said_seed(asked.seed)
        some: dict[str, tuple[RealSession, Path]] = {}
        jobs: dict[str, Case] = {}
        for number in range(asked.cohorts):
            who = people(asked.simulated, asked.seed, asked.out / "people", number * asked.simulated)
            some |= {one.name: (one, root) for one, root in who}
            every = (Case(one.name, kind, asked.seed + number) for kind in asked.kinds for one, _ in who)
            jobs |= {case.key: case for case in every}
        for number, row in enumerate(
            performed(jobs, partial(perform, some=some, out=asked.out), asked.jobs, asked.out / "rows.jsonl"), 1
        ):
            print(f"{number:4d}/{len(jobs)} {row['key']} {row.get('failed', '')}", flush=True)
    print("\n".join(tables(read_lines(asked.out / "rows.jsonl"), asked.out / "evidence")))


if __name__ == "__main__":
    main()
