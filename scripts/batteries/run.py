"""A battery of sessions with nothing, one effect, two, or one of no catalogue hidden, and how the diagnosis fares.

    scripts/battery --levels medium --each 4 --nulls 20 --out out/battery

Every session is written by the MuJoCo simulator, run from its files alone, and judged by its truth only then. A row per
session goes to ``rows.jsonl``, so that a battery that was stopped goes on. Tables are printed and written to
``battery.json`` with seeds, date and what they need of every session in a line, beside ``reliability.png``. With
``--calibrate``, on seeds of its own, it is said what hangs on the calibrated thresholds (``batteries/calibrate.py``).
"""

import argparse
import datetime
import json
import shutil
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch

from batteries import calibrate
from batteries.gain import heldout_gains
from batteries.judge import document, judged
from batteries.mujoco_session import draw_effect, simulate
from batteries.power import draw_reliability
from batteries.sizes import SIZES
from torchid.config import Config, load_config
from torchid.diagnosis.options import DiagnosisOptions
from torchid.effects.catalogue import BODILY
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session
from torchid.storage.allocator import keep_memory

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


def jobs(arguments: argparse.Namespace) -> Iterator[Job]:
    """In an order in which a battery that is stopped early has a little of everything."""
    seed = arguments.first
    for k in range(
        max(arguments.each, arguments.nulls, arguments.own, arguments.pairs, arguments.foreign, arguments.skin)
    ):
        for level in arguments.levels:
            for name in arguments.effects or KNOWN:
                seed += 1
                if k < arguments.each:
                    yield Job("single", (name,), level, seed)
            for name in FOREIGN:
                seed += 1
                if k < arguments.foreign:
                    yield Job("foreign", (name,), level, seed)
            seed += 1
            if k < arguments.pairs:
                pair = np.random.default_rng(seed).choice(KNOWN, 2, replace=False)
                yield Job("double", (str(pair[0]), str(pair[1])), level, seed)
        seed += 1
        yield from _quiet(arguments, k, seed)


def _quiet(arguments: argparse.Namespace, k: int, seed: int) -> Iterator[Job]:
    """Sessions that hide nothing, and those in which skin slides."""
    if k < arguments.nulls:
        yield Job("null", (), "none", seed)
    if k < arguments.own:
        yield Job("null", (), OWN, seed)
    if k < arguments.skin:
        yield from (Job("skin", names, "medium", seed) for names in ((), _drawn(seed)))


def _drawn(seed: int) -> tuple[str]:
    return (str(np.random.default_rng(seed).choice([name for name in KNOWN if name not in BODILY])),)


def perform(
    job: Job, out: Path, keep: bool, varied: tuple[str, ...] = (), factors: tuple[str, ...] = tuple(calibrate.FACTORS)
) -> dict:
    """Simulate, run, and only then compare; given thresholds to vary, verdicts with each of them changed."""
    torch.set_num_threads(1)
    keep_memory()
    folder, begun = out / job.key, time.perf_counter()
    try:
        row = _varied(job, folder, varied, factors) if varied else _row(job, folder)
    except Exception as failure:  # a battery goes on; the row says what happened
        row = {"failed": f"{type(failure).__name__}: {failure}"}
    if not keep:
        shutil.rmtree(folder, ignore_errors=True)
    return asdict(job) | row | {"seconds": time.perf_counter() - begun}


def _row(job: Job, folder: Path) -> dict:
    config = _simulated(job, folder)
    outcome = run_experiment(config)
    stages = {name: spent.seconds for name, spent in outcome.times.items()}
    said = json.loads((config.out / "diagnosis.json").read_text())
    hidden = _hidden(job, folder)
    row = judged(hidden, said) | {"diagnosis_s": stages.get("diagnosis")}
    row["gained"] = _gained(outcome, hidden, folder / "perfect") if hidden else None
    return row


def _varied(job: Job, folder: Path, names: tuple[str, ...], factors: tuple[str, ...]) -> dict:
    some, config = calibrate.variants(DiagnosisOptions(), names, factors), _simulated(job, folder)
    said = calibrate.diagnosed(config, some)
    return calibrate.row(_hidden(job, folder), said, some)


def _hidden(job: Job, folder: Path) -> list[dict]:
    """The truth, which nobody opens before the verdict."""
    return json.loads((folder / "truth" / "truth.json").read_text())["effects"] if job.names else []


def _simulated(job: Job, folder: Path) -> Config:
    if job.level == OWN:
        made = simulate_session(OPTIONS, job.seed, folder)
        assert made.config is not None
        return load_config(made.config)
    rng = np.random.default_rng((job.seed, 7))
    hidden = [draw_effect(name, job.level, rng) for name in job.names]
    return load_config(simulate(folder, job.seed, hidden, SKIN_M if job.kind == "skin" else 0.0))


def _gained(outcome: Outcome, truth: list[dict], scratch: Path) -> tuple[float, float] | None:
    """A verdict is not lost with what knowing better would have gained."""
    try:
        return heldout_gains(outcome, truth, scratch)
    except Exception as failure:
        print(f"no gain: {type(failure).__name__}: {failure}", flush=True)
        return None


def main() -> None:
    """Run what is missing, print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="*", choices=KNOWN, help="only these")
    parser.add_argument("--levels", nargs="*", default=["medium"], choices=["small", "medium", "large"])
    parser.add_argument("--each", type=int, default=1, help="sessions per effect and level")
    parser.add_argument("--nulls", type=int, default=2, help="sessions with nothing hidden")
    parser.add_argument("--own", type=int, default=0, help="the same, written by torchid's own simulator")
    parser.add_argument("--pairs", type=int, default=2, help="sessions with two effects, per level")
    parser.add_argument("--foreign", type=int, default=0, help="sessions per effect outside the catalogue and level")
    parser.add_argument(
        "--skin", type=int, default=0, help="sessions of living skin without effects, and with one of any kind, medium"
    )
    parser.add_argument("--first", type=int, help="seed (default: the clock's; the first reserved one to calibrate)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", action="store_true", help="keep the sessions' folders")
    parser.add_argument("--out", type=Path, help="folder (default: out/battery; out/calibration to calibrate)")
    parser.add_argument("--calibrate", action="store_true", help="say what hangs on the calibrated thresholds instead")
    parser.add_argument("--sessions", type=int, default=2 * len(KNOWN), help="that calibrate")
    factors, names = tuple(calibrate.FACTORS), calibrate.calibrated_names()
    parser.add_argument("--factors", nargs="+", default=factors, choices=(*factors, "off"), help="half, double, off")
    parser.add_argument("--thresholds", nargs="+", choices={*names, *calibrate.OFF}, metavar="NAME", help="only these")
    arguments = parser.parse_args()
    if arguments.thresholds is None:
        arguments.thresholds = list(calibrate.OFF) if "off" in arguments.factors else names
    if arguments.first is None:
        reserved = calibrate.RESERVED.start
        arguments.first = reserved if arguments.calibrate else int(time.time()) % reserved
    arguments.out = arguments.out or Path("out/calibration" if arguments.calibrate else "out/battery")
    try:
        planned = _planned(arguments)
    except ValueError as problem:
        parser.error(str(problem))
    arguments.out.mkdir(parents=True, exist_ok=True)
    (_calibrate if arguments.calibrate else _battery)(arguments, planned)


def _planned(arguments: argparse.Namespace) -> list[Job]:
    """The sessions.

    Raises:
        ValueError: a calibration would have other seeds than those reserved for it, or a battery one of these.
    """
    if arguments.calibrate:
        return [_job(one) for one in calibrate.plan(arguments.first, arguments.sessions)]
    planned = list(jobs(arguments))
    if any(job.seed in calibrate.RESERVED for job in planned):
        raise ValueError(f"--first {arguments.first}: some seeds of this battery are reserved for --calibrate")
    return planned


def _job(one: calibrate.Session) -> Job:
    if one.effect is None:
        return Job("null", (), OWN if one.own else "none", one.seed)
    return Job("single", (one.effect,), "medium", one.seed)


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that begin nothing more where their caller fails: else it would wait for all that is planned."""
    with ProcessPoolExecutor(workers) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _battery(arguments: argparse.Namespace, planned: list[Job]) -> None:
    path = arguments.out / "rows.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {Job(r["kind"], tuple(r["names"]), r["level"], r["seed"]).key for r in rows}
    with _pool(arguments.workers) as pool:
        waiting = [pool.submit(perform, job, arguments.out, arguments.keep) for job in planned if job.key not in done]
        for one in as_completed(waiting):
            rows.append(one.result())
            with path.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            print(f"{len(rows):4d} {rows[-1].get('told', rows[-1].get('failed'))}", flush=True)
            written(arguments.out, arguments.first, rows)
    print(written(arguments.out, arguments.first, rows))


def _calibrate(arguments: argparse.Namespace, planned: list[Job]) -> None:
    options, names, rows = DiagnosisOptions(), tuple(arguments.thresholds), []
    factors = tuple(arguments.factors)
    work = partial(perform, out=arguments.out, keep=arguments.keep, varied=names, factors=factors)
    present, path = calibrate.present_values(options, names), arguments.out / f"rows_{'_'.join(factors)}.jsonl"
    with _pool(arguments.workers) as pool:
        for row in calibrate.finished({job.key: job for job in planned}, path, present, pool, work):
            rows.append(row)
            print(f"{len(rows):4d} {row['key']} {row.get('failed') or row['verdict']['named']}", flush=True)
            found = calibrate.document(rows, options, names, factors, datetime.date.today().isoformat())
            (arguments.out / "calibration.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    print("\n".join(found["text"]))


def written(out: Path, first: int, rows: list[dict]) -> str:
    """The tables of all rows so far; with seeds, date and short rows in ``battery.json``."""
    text = document(rows, datetime.date.today().isoformat(), first)
    (out / "battery.json").write_text(text, encoding="utf-8")
    draw_reliability([r for r in rows if "failed" not in r], out / "reliability.png")
    return "\n".join(json.loads(text)["tables"])


if __name__ == "__main__":
    main()
