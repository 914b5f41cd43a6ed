"""The verdicts of forty fixed sessions and of every config, kept and compared: does a rebuilding change any of them?

    PYTHONPATH=.:scripts python -m batteries.verdicts run out/verdicts
    PYTHONPATH=.:scripts python -m batteries.verdicts compare scripts/batteries/verdicts.json out/verdicts
    PYTHONPATH=.:scripts python -m batteries.verdicts keep out/verdicts scripts/batteries/verdicts.json
    PYTHONPATH=.:scripts:tests python -m batteries.verdicts judge out/verdicts

``run`` simulates twenty effects of medium size, eight sessions with nothing hidden, six pairs and six effects outside
the catalogue, all of fixed seeds, runs them and the configs whose recordings are there, and keeps each one's
``diagnosis.json``. A verdict that is already there is not computed again. ``compare`` lists every difference of causes,
places and values beyond 1e-6 relative, of the verdicts that both sides have, and exits with 1 if there is one. ``keep``
writes a folder into one file; ``verdicts.json`` holds those before the diagnosis was rebuilt. ``judge`` says what was
named in the simulated sessions beside what was hidden there.
"""

import json
import math
import os
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import as_completed
from dataclasses import asdict
from pathlib import Path

import numpy as np
from harness.command import ROOT, Among, Command
from harness.pool import processes
from mujoco_laboratory.draws import draw_effect

from batteries.judge import judged, tables
from batteries.sessions import FOREIGN, KNOWN, OWN, Job, written
from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.run import run_experiment

FIRST = 310_000
"""Seed of the first session; no figure is quoted and nothing is tuned on the seeds from here on."""
LEFT_OUT = ("body_lag", "plate_crosstalk", "flywheel", "moving_ground", "marker_scale", "plate_drift",
            "body_weight_support", "wobbling_mass")  # fmt: skip
"""Effects whose relatives stand among the twenty that are run."""
TOLERANCE = 1e-6
COMPARED = ("causes", "baseline", "extended", "unexplained", "not_testable", "refuted", "nearest", "plates")


def sessions() -> Iterator[Job]:
    """Forty jobs: twenty single effects, eight with nothing, six pairs, six of no catalogue."""
    singles = [name for name in KNOWN if name not in LEFT_OUT]
    pairs = [(singles[k], singles[(3 * k + 7) % len(singles)]) for k in range(0, 18, 3)]
    kinds = [("single", (name,), "medium") for name in singles]
    kinds += [("null", (), level) for level in ("none", OWN) for _ in range(4)]
    kinds += [("foreign", (name,), "medium") for name in FOREIGN] + [("double", pair, "medium") for pair in pairs]
    return (Job(kind, names, level, FIRST + k) for k, (kind, names, level) in enumerate(kinds))


def _kept(key: str, source: Job | Path, out: Path) -> str:
    """Run one session or config and keep what it says; the line to print."""
    scratch = out / "scratch" / key
    config = written(source, scratch) if isinstance(source, Job) else load_config(source, (f"out={scratch}",))
    try:
        run_experiment(config)
    except TorchidError as failure:
        (scratch / "failed.txt").write_text(str(failure))
    said = config.out / "diagnosis.json"
    verdict = json.loads(said.read_text()) if said.exists() else {"failed": True}
    shutil.rmtree(scratch, ignore_errors=True)
    (out / f"{key}.json").write_text(json.dumps(verdict, indent=1))
    return f"{key}: {', '.join(_name(cause) for cause in verdict.get('causes', [])) or 'nothing named'}"


def _name(cause: dict) -> str:
    return f"{cause['effect']}({', '.join(cause['where'])})"


def run(out: Path, workers: int) -> None:
    """Keep the verdicts that are missing under ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    jobs: dict[str, Job | Path] = {path.stem: path for path in sorted((ROOT / "configs").glob("*.yaml"))}
    jobs |= {job.key: job for job in sessions()}
    jobs = {key: job for key, job in jobs.items() if not (out / f"{key}.json").exists()}
    with processes(workers) as pool:
        waiting = {pool.submit(_kept, key, job, out): key for key, job in jobs.items()}
        for done in as_completed(waiting):
            failed = done.exception()
            print(f"{waiting[done]}: {type(failed).__name__}: {failed}" if failed else done.result(), flush=True)


def differences(before: object, after: object, place: str = "") -> Iterator[str]:
    """Every place at which two verdicts differ, with what stands there."""
    if isinstance(before, dict) and isinstance(after, dict):
        # What is new in a record, such as the rule by which a cause was refuted, changes no verdict.
        for key in before:
            yield from differences(before.get(key), after.get(key), f"{place}/{key}")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for k, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from differences(one, other, f"{place}/{k}")
    elif not _equal(before, after):
        yield f"{place}: {before} -> {after}"


def _equal(one: object, other: object) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        if math.isnan(one) and math.isnan(other):
            return True
        return math.isclose(one, other, rel_tol=TOLERANCE, abs_tol=TOLERANCE * 1e-3)
    return one == other


def verdicts(path: Path) -> dict[str, dict]:
    """Verdicts of a folder, or of the file into which one was kept, by the name of their session."""
    if path.is_dir():
        return {one.stem: _compared(json.loads(one.read_text())) for one in sorted(path.glob("*.json"))}
    return json.loads(path.read_text())


def _compared(verdict: dict) -> dict:
    return {key: verdict[key] for key in COMPARED if key in verdict}


def keep(folder: Path, file: Path) -> None:
    """Write the verdicts of a folder into one file, a line each, numbers to nine digits."""
    lines = [f"{json.dumps(key)}: {json.dumps(_rounded(one))}" for key, one in verdicts(folder).items()]
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _rounded(own) for key, own in value.items()}
    if isinstance(value, list):
        return [_rounded(own) for own in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def compare(before: Path, after: Path) -> int:
    """Print what differs; the number of verdicts that do."""
    old, new = verdicts(before), verdicts(after)
    both, changed = sorted(old.keys() & new.keys()), 0
    for name in both:
        found = [line for key in old[name] for line in differences(old[name][key], new[name].get(key), key)]
        changed += bool(found)
        print(f"{name}: {len(found)} differences" if found else f"{name}: same")
        print("".join(f"    {line}\n" for line in found[:12]), end="")
    print(f"{len(both) - changed} of {len(both)} verdicts the same; {len(old) - len(both)} not run")
    return changed


def judge(path: Path) -> str:
    """Tables of the simulated sessions against what was hidden in them, and a line for each."""
    found, rows = verdicts(path), []
    for job in (job for job in sessions() if job.key in found):
        rng = np.random.default_rng((job.seed, 7))
        truth = [draw_effect(name, job.level, rng) for name in job.names]
        row = {"failed": ""} if "causes" not in found[job.key] else judged(truth, found[job.key])
        rows.append(asdict(job) | row)
    return "\n".join([*(f"{r['seed']} {r.get('told', 'failed')}" for r in rows), tables(rows)["text"]])


def main() -> None:
    """Run, compare, judge or keep."""
    folders = {"nargs": "+", "type": Path}
    workers = os.cpu_count() or 1
    words = Among(("run", "compare", "keep", "judge"))
    asked = Command(__doc__, ("what", "folders"), what=words, folders=folders, workers=workers).asked()
    if asked.what == "run":
        run(asked.folders[0], asked.workers)
    elif asked.what == "keep":
        keep(*asked.folders)
    elif asked.what == "judge":
        print(*map(judge, asked.folders), sep="\n\n")
    else:
        sys.exit(bool(compare(*asked.folders)))


if __name__ == "__main__":
    main()
