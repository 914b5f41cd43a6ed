"""Sessions in which something is hidden: which there are, how they are written, and how they are run and judged."""

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from mujoco_laboratory.draws import draw_effect
from mujoco_laboratory.session import simulate
from mujoco_laboratory.sizes import SIZES

from batteries.gain import heldout_gains
from batteries.judge import judged
from torchid.config import Config, load_config
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session

KNOWN = tuple(name for name in SIZES if not name.startswith("offcat_"))
FOREIGN = tuple(name for name in SIZES if name.startswith("offcat_"))
SKIN_M = 0.01
"""How far skin slides on the thighs of a living body, at 90 degrees of each joint near."""
OWN = "own"
"""Of torchid's own simulator."""
OPTIONS = SimulateOptions(fit=("squats", "arms", "trunk", "sway_steps"), heldout=("hip_rom",), skin_motion_mm=0.0)


@dataclass(frozen=True)
class Job:
    """One session."""

    kind: str
    """null, single, double, foreign or skin."""
    names: tuple[str, ...]
    level: str
    seed: int

    @property
    def key(self) -> str:
        """Its folder."""
        return "-".join((self.kind, self.level, *self.names, str(self.seed)))


def written(job: Job, folder: Path) -> Config:
    """The session's files, and their config."""
    if job.level == OWN:
        skin = 1e3 * SKIN_M if job.kind == "skin" else 0.0
        made = simulate_session(replace(OPTIONS, skin_motion_mm=skin), job.seed, folder)
        assert made.config is not None
        return load_config(made.config)
    rng = np.random.default_rng((job.seed, 7))
    hidden = [draw_effect(name, job.level, rng) for name in job.names]
    return load_config(simulate(folder, job.seed, hidden, SKIN_M if job.kind == "skin" else 0.0))


def hidden_in(job: Job, folder: Path) -> list[dict]:
    """The truth, which nobody opens before the verdict."""
    return json.loads((folder / "truth" / "truth.json").read_text())["effects"] if job.names else []


def perform(job: Job, out: Path, keep: bool, work: Callable[[Job, Path], dict], more: dict | None = None) -> dict:
    """The row of a session: whose it is, what ``work`` makes of it in its folder, what that took, and more."""
    folder, begun = out / job.key, time.perf_counter()
    try:
        row = work(job, folder)
    except Exception as failure:  # a battery goes on; the row says what happened
        row = {"failed": f"{type(failure).__name__}: {failure}"}
    if not keep:
        shutil.rmtree(folder, ignore_errors=True)
    return {"key": job.key} | asdict(job) | row | {"seconds": time.perf_counter() - begun} | (more or {})


def diagnosed(job: Job, folder: Path) -> dict:
    """Simulate, run, and only then compare."""
    config = written(job, folder)
    outcome = run_experiment(config)
    spent = [time.seconds for name, time in outcome.times.items() if name.startswith("diagnosis")]
    hidden = hidden_in(job, folder)
    row = judged(hidden, json.loads((config.out / "diagnosis.json").read_text()))
    gained = _gained(outcome, hidden, folder / "perfect") if hidden else None
    return row | {"diagnosis_s": sum(spent) or None, "gained": gained}


def _gained(outcome: Outcome, truth: list[dict], scratch: Path) -> tuple[float, float] | None:
    """A verdict is not lost with what knowing better would have gained."""
    try:
        return heldout_gains(outcome, truth, scratch)
    except Exception as failure:
        print(f"no gain: {type(failure).__name__}: {failure}", flush=True)
        return None
