"""Whole evaluations in which no condition does anything: simulated recordings, read from C3D, judged as any others.

Recordings are those of ``evaluation_recordings.py``: trials scatter, and nothing differs between conditions. Files,
reading, tracking, contacts, cycles, torques and tests are those of ``torchid evaluate``; bands and reports, which
decide nothing, are left out.

The body is either ``apart``, identified once from other trials of the person and kept for ``PER_BODY`` evaluations, or
``reference``, identified anew for every evaluation from its reference trials as well, as it is where the other
condition wears a device: here a spring without stiffness.
"""

import json
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
import yaml
from harness.rows import add_line, read_lines
from scipy.stats import binomtest

from benchmarks.evaluation_recordings import perform
from torchid.config import Config, load_config
from torchid.errors import TorchidError
from torchid.evaluation.evaluate import gather, judge
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.statistics.answers import BodyAnswer
from torchid.evaluation.torque_shares.wearing import worn_devices
from torchid.evaluation.trials import condition_trials
from torchid.io.c3d_write import write_c3d
from torchid.run.sequence import compute_outcome
from torchid.session import Outcome
from torchid.session.opening import read_session
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession, session_config, simulate_session
from torchid.storage.results import OutputFolder

CYCLES = {"squats": {"coordinate": "pelvis_z", "turn": "low"}, "sway_steps": "gait"}
"""Movements, and how their cycles are found."""
CALIBRATION = {"apart": ("arms", "trunk", "sway_steps"), "reference": ("arms", "trunk")}
"""Trials that tell of the body alone."""
PER_BODY = 10
"""Choice. Evaluations of one person: given the body, they are independent."""
NOTHING = {"name": "nothing", "elements": [{"type": "spring", "name": "none", "between": ["pelvis", "thigh_l"],
           "coordinate": "hip_l_flexion", "stiffness_Nm_rad": 0.0}]}  # fmt: skip
"""A device that weighs and does nothing."""


@dataclass(frozen=True)
class Plan:
    """What every evaluation of a run has in common."""

    body: str = "reference"
    movements: tuple[str, ...] = tuple(CYCLES)
    """Taken in turn."""
    trials: int = 5
    """Of each condition: five against five can be told apart at 4.8 %, four against four at 2.9 % only."""
    seconds: float = 6.0
    """Of each trial: one to three cycles."""
    rate_hz: float = 50.0
    seed: int = 0

    def movement(self, number: int) -> str:
        """Of an evaluation."""
        return self.movements[number % len(self.movements)]

    @property
    def options(self) -> SimulateOptions:
        """Of all recordings."""
        return SimulateOptions(
            fit=CALIBRATION[self.body], heldout=(), duration_s=self.seconds, rate_hz=self.rate_hz, skin_motion_mm=3.0
        )  # fmt: skip

    @property
    def file(self) -> str:
        """Name of the file of results."""
        return f"evaluation_whole_{self.body}_{self.trials}.jsonl"


def run(plan: Plan, evaluations: int, folder: Path) -> dict:
    """Make the evaluations that the file of results lacks, and say what all in it have found."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / plan.file
    done = {(line["seed"], line["number"]) for line in read_lines(path)}
    with tempfile.TemporaryDirectory(prefix="torchid-") as work:
        for number in (k for k in range(evaluations) if (plan.seed, k) not in done):
            line = {"seed": plan.seed, "number": number, **evaluation(plan, number, Path(work))}
            add_line(path, line)
            print(json.dumps(line), flush=True)
    return summary(read_lines(path))


def summary(lines: list[dict]) -> dict:
    """The rate of evaluations with a finding, its exact 95 % interval (Clopper & Pearson 1934), and what was found."""
    good = [line for line in lines if "failed" not in line]
    said: dict = {
        "evaluations": len(good), "failed": [line["failed"] for line in lines if "failed" in line],
        "by_movement": {
            m: f"{sum(bool(x['identified']['found']) for x in good if x['movement'] == m)} of "
            f"{sum(x['movement'] == m for x in good)}" for m in sorted({x["movement"] for x in good})
        },
    }  # fmt: skip
    for body in ("identified", "template"):
        wrong = [line for line in good if line[body]["found"]]
        interval = binomtest(len(wrong), len(good)).proportion_ci(method="exact")
        said[body] = {
            "with_findings": len(wrong), "rate": len(wrong) / len(good), "low": interval.low, "high": interval.high,
            "found": Counter(name for line in wrong for name in line[body]["found"]),
            "courses": sum(line[body]["courses"] for line in good),
            "intervals_cover": float(np.mean([line[body]["covered"] for line in good])),
        }  # fmt: skip
    said["cycles"] = float(np.mean([line["cycles"] for line in good]))
    said["seconds"] = float(np.median([line["seconds"] for line in good]))
    return said


def evaluation(plan: Plan, number: int, work: Path) -> dict:
    """One evaluation as a line of results; bodies that are known already stay in ``work``."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(dir=work) as folder:
        try:
            found = evaluated(plan, number, Path(folder), work)
        except TorchidError as error:
            return {"movement": plan.movement(number), "failed": str(error)}
    return {
        "movement": plan.movement(number), "cycles": len(found.cycles),
        "identified": _said(found.identified, found), "template": _said(found.template, found),
        "seconds": round(time.perf_counter() - began, 1),
    }  # fmt: skip


def _said(answer: BodyAnswer, found: Evaluation) -> dict:
    one, level = answer.comparisons[0], found.config.evaluate.level
    low, high = (getattr(one.difference, end) for end in ("low", "high"))
    known = torch.isfinite(low)
    return {
        "found": [f"{one.columns[k].where} {one.columns[k].measure}" for k in one.found(level)],
        "courses": len(one.found_courses(level)),
        "least": float(one.tested.adjusted.nan_to_num(1.0).min()),
        "units": f"{len(one.units.second)} {one.units.kind}", "columns": int(one.tested.adjusted.isfinite().sum()),
        "covered": float(((low <= 0.0) & (high >= 0.0))[known].double().mean()),
    }  # fmt: skip


def evaluated(plan: Plan, number: int, folder: Path, work: Path) -> Evaluation:
    """Record, identify the body where it is not known already, follow and judge."""
    person = 1000 * plan.seed + number // PER_BODY
    session = calibration(plan, person)
    conditions = {f"{name}_{k}": name for name in ("without", "with") for k in range(plan.trials)}
    items = [
        perform(session.subject, plan.movement(number), plan.options, (plan.seed, number, k), name)
        for k, name in enumerate(conditions)
    ]
    config = written(plan, number, SimulatedSession(session.subject, (*session.trials, *items)), conditions, folder)
    outcome = known_body(plan, person, work) if plan.body == "apart" else identified(config, folder / "body")
    with OutputFolder(folder / "out") as results:
        trials = condition_trials(config, outcome, results, quiet)
        return judge(config, outcome, gather(config, outcome, trials, worn_devices(config)))


@lru_cache(maxsize=1)
def calibration(plan: Plan, person: int) -> SimulatedSession:
    """The trials that tell of the body alone; the last person's are kept."""
    return simulate_session(plan.options, person)


@lru_cache(maxsize=1)
def known_body(plan: Plan, person: int, work: Path) -> Outcome:
    """A person's body from those trials."""
    folder = work / f"person_{person}"
    folder.mkdir()
    return identified(written(plan, 0, calibration(plan, person), {}, folder), folder / "body")


def identified(config: Config, out: Path) -> Outcome:
    """The body of the run of ``torchid evaluate`` on a config, without its report."""
    config = config.body.model_copy(update={"out": out})
    with OutputFolder(out) as folder:
        outcome, failure = compute_outcome(config, read_session(config, folder.aside), folder, quiet)
    if failure is not None:
        raise failure
    return outcome


def written(plan: Plan, number: int, session: SimulatedSession, conditions: dict[str, str], folder: Path) -> Config:
    """Write recordings as C3D and read the config that lists them, with the condition of every trial that has one."""
    for item in session.trials:
        write_c3d(folder / f"{item.trial.name}.c3d", item.trial)
    (folder / "nothing.yaml").write_text(yaml.safe_dump(NOTHING))
    listed = session_config(session)
    entries = [t | ({"condition": conditions[t["name"]]} if t["name"] in conditions else {}) for t in listed["trials"]]
    worn = {} if plan.body == "apart" else {"device": "nothing.yaml"}
    more = {"conditions": {"without": {"reference": True}, "with": worn}} if conditions else {}
    asked = {"cycles": CYCLES[plan.movement(number)], "draws": 0}
    document = listed | more | {"trials": entries, "evaluate": asked, "diagnosis": {"enabled": False}}
    (folder / "config.yaml").write_text(yaml.safe_dump(document))
    return load_config(folder / "config.yaml")


def quiet(stage: str, fraction: float | None) -> None:
    """Nobody waits for these."""
    del stage, fraction
