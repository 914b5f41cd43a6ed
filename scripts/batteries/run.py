"""A battery of sessions with nothing, one effect, two, or one of no catalogue hidden, and how the diagnosis fares.

    scripts/battery --levels medium --each 4 --nulls 20 --out out/battery

Every session is written by the MuJoCo simulator, run from its files alone, and judged by its truth only then. A row per
session goes to ``rows.jsonl``, so that a battery that was stopped goes on. Tables are printed and written to
``battery.json`` with seeds, date and what they need of every session, beside ``reliability.png``. With ``--calibrate``,
on seeds of its own, it is said what hangs on the calibrated thresholds (``batteries/calibrate.py``).
"""

import datetime
import json
import time
from argparse import Namespace
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from harness.command import Among, Command
from harness.pool import performed
from harness.rows import write_json

from batteries import calibrate
from batteries.judge import document
from batteries.power import draw_reliability
from batteries.sessions import FOREIGN, KNOWN, OWN, Job, diagnosed, hidden_in, perform, written
from torchid.diagnosis.options import DiagnosisOptions
from torchid.effects.catalogue import BODILY


def jobs(asked: Namespace) -> Iterator[Job]:
    """In an order in which a battery that is stopped early has a little of everything."""
    seed = asked.first
    for k in range(max(asked.each, asked.nulls, asked.own, asked.pairs, asked.foreign, asked.skin)):
        for level in asked.levels:
            for kind, names, wanted in (
                ("single", asked.effects or KNOWN, asked.each),
                ("foreign", FOREIGN, asked.foreign),
            ):
                for name in names:
                    seed += 1
                    if k < wanted:
                        yield Job(kind, (name,), level, seed)
            seed += 1
            if k < asked.pairs:
                yield Job("double", _drawn(seed, KNOWN, 2), level, seed)
        seed += 1
        if k < asked.nulls:
            yield Job("null", (), "none", seed)
        if k < asked.own:
            yield Job("null", (), OWN, seed)
        if k < asked.skin:
            laboratory = tuple(name for name in KNOWN if name not in BODILY)
            yield from (Job("skin", names, "medium", seed) for names in ((), _drawn(seed, laboratory)))


def _drawn(seed: int, names: tuple[str, ...], size: int = 1) -> tuple[str, ...]:
    return tuple(str(one) for one in np.random.default_rng(seed).choice(names, size, replace=False))


def main() -> None:
    """Run what is missing, print tables."""
    factors, names = tuple(calibrate.FACTORS), calibrate.calibrated_names()
    command = Command(
        __doc__,
        effects=(Among(KNOWN, (), True), "only these"),
        levels=Among(("small", "medium", "large"), ["medium"], True),
        each=(1, "sessions per effect and level"),
        nulls=(2, "sessions with nothing hidden"),
        own=(0, "the same, written by torchid's own simulator"),
        pairs=(2, "sessions with two effects, per level"),
        foreign=(0, "sessions per effect outside the catalogue and level"),
        skin=(0, "sessions of living skin without effects, and with one of any kind, medium"),
        first=(int, "seed (default: the clock's; the first reserved one to calibrate)"),
        workers=2,
        keep=(False, "keep the sessions' folders"),
        out=(Path, "folder (default: out/battery; out/calibration to calibrate)"),
        calibrate=(False, "say what hangs on the calibrated thresholds instead"),
        sessions=(2 * len(KNOWN), "that calibrate"),
        factors=(Among((*factors, "off"), factors, True), "half, double, off"),
        thresholds=(Among({*names, *calibrate.OFF}, None, True, "NAME"), "only these"),
    )
    asked = command.asked()
    if asked.thresholds is None:
        asked.thresholds = list(calibrate.OFF) if "off" in asked.factors else names
    if asked.first is None:
        reserved = calibrate.RESERVED.start
        asked.first = reserved if asked.calibrate else int(time.time()) % reserved
    asked.out = asked.out or Path("out/calibration" if asked.calibrate else "out/battery")
    try:
        planned = {job.key: job for job in _planned(asked)}
    except ValueError as problem:
        command.parser.error(str(problem))
    (_calibrate if asked.calibrate else _battery)(asked, planned)


def _planned(asked: Namespace) -> list[Job]:
    """The sessions.

    Raises:
        ValueError: a calibration would have other seeds than those reserved for it, or a battery one of these.
    """
    if asked.calibrate:
        return [_job(one) for one in calibrate.plan(asked.first, asked.sessions)]
    planned = list(jobs(asked))
    if any(job.seed in calibrate.RESERVED for job in planned):
        raise ValueError(f"--first {asked.first}: some seeds of this battery are reserved for --calibrate")
    return planned


def _job(one: calibrate.Session) -> Job:
    if one.effect is None:
        return Job("null", (), OWN if one.own else "none", one.seed)
    return Job("single", (one.effect,), "medium", one.seed)


def _battery(asked: Namespace, planned: dict[str, Job]) -> None:
    work, rows, text = partial(perform, out=asked.out, keep=asked.keep, work=diagnosed), [], '{"tables": []}'
    for row in performed(planned, work, asked.workers, asked.out / "rows.jsonl"):
        rows.append(row)
        print(f"{len(rows):4d} {row.get('told', row.get('failed'))}", flush=True)
        text = document(rows, datetime.date.today().isoformat(), asked.first)
        (asked.out / "battery.json").write_text(text, encoding="utf-8")
        draw_reliability([r for r in rows if "failed" not in r], asked.out / "reliability.png")
    print("\n".join(json.loads(text)["tables"]))


def _calibrate(asked: Namespace, planned: dict[str, Job]) -> None:
    options, names, factors = DiagnosisOptions(), tuple(asked.thresholds), tuple(asked.factors)
    present, rows, found = calibrate.present_values(options, names), [], {"text": []}
    varied = partial(_varied, names=names, factors=factors)
    work = partial(perform, out=asked.out, keep=asked.keep, work=varied, more={"present": present})
    path = asked.out / f"rows_{'_'.join(factors)}.jsonl"
    for row in performed(planned, work, asked.workers, path, counts=lambda r: calibrate.judged_with(present, r)):
        rows.append(row)
        print(f"{len(rows):4d} {row['key']} {row.get('failed') or row['verdict']['named']}", flush=True)
        found = calibrate.document(rows, options, names, factors, datetime.date.today().isoformat())
        write_json(asked.out / "calibration.json", found)
    print("\n".join(found["text"]))


def _varied(job: Job, folder: Path, names: tuple[str, ...], factors: tuple[str, ...]) -> dict:
    """Verdicts with each of some thresholds changed."""
    some, config = calibrate.variants(DiagnosisOptions(), names, factors), written(job, folder)
    said = calibrate.diagnosed(config, some)
    return calibrate.row(hidden_in(job, folder), said, some)


if __name__ == "__main__":
    main()
