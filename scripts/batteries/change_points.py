"""A fault that begins, or ends, between two sessions of a laboratory: is it named, and is the date right?

    scripts/module test batteries.pooled --seed 5103 --simulated 12 --out out/pooled     # first: evidence of sessions
    scripts/module test batteries.change_points --seed 5110 --draws 20 --out out/pooled

Sessions that the other battery keeps get dates by lot. Those before a date by lot are as recorded, those from then on
have the fault, or the other way round. Counted for each fault: how often it is named at its place, and how often its
first and last session are right, and within one session.
"""

import zlib
from collections.abc import Iterator, Sequence
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from harness.command import Command, said_seed
from harness.rows import read_lines
from planted_faults.real_kinds import UNPLANTED

from batteries.pooled import is_planted
from torchid.cohort.laboratories import Laboratory, laboratories
from torchid.cohort.pooling import SharedFault, pooled
from torchid.diagnosis.verdict.records import EVEN
from torchid.session.laboratory import read_laboratory

Row = dict[str, Any]
FEWEST = 2
"""Choice. Sessions on either side of a change."""
FIRST = date(2026, 1, 5)


def drawn(faulty: Sequence[Row], sound: Sequence[Row], evidence: Path, draw: np.random.Generator) -> tuple[str, int]:
    """What one laboratory by lot says: ``unnamed``, ``wrong``, or ``named``, and how many sessions its date is off."""
    keys = {kind: {row["session"]: row["key"] for row in rows} for kind, rows in (("with", faulty), ("without", sound))}
    names = sorted(keys["with"].keys() & keys["without"].keys())
    order = [names[k] for k in draw.permutation(len(names))]
    change, begins = int(draw.integers(FEWEST, len(order) - FEWEST + 1)), bool(draw.integers(2))
    having = order[change:] if begins else order[:change]
    found = {
        name: read_laboratory(evidence / f"{keys['with' if name in having else 'without'][name]}.nc") for name in order
    }
    labels = {name: {"session": (FIRST + timedelta(days=k)).isoformat()} for k, name in enumerate(order)}
    home = max(laboratories(found, labels), key=lambda one: len(one.visits))
    faults = [one for one in pooled(home).faults if one.confidence > EVEN]
    right = [one for one in faults if is_planted(one, home, faulty[0]["truth"])]
    if not right:
        return ("wrong" if faults else "unnamed"), len(order)
    return "named", _off(right[0], home, having)


def _off(fault: SharedFault, home: Laboratory, having: Sequence[str]) -> int:
    """Sessions by which the farther end of a fault is wrong."""
    at = {one.name: k for k, one in enumerate(home.visits)}
    ends = (at[fault.first], at[fault.last])
    true = (min(at[name] for name in having if name in at), max(at[name] for name in having if name in at))
    return max(abs(own - other) for own, other in zip(ends, true, strict=True))


def table(rows: Sequence[Row], evidence: Path, seed: int, draws: int) -> Iterator[str]:
    """A line for each fault of each cohort, and one for all."""
    every: list[tuple[str, int]] = []
    for kind, own in dict.fromkeys((row["kind"], row["seed"]) for row in rows if row["kind"] != UNPLANTED):
        faulty, sound = ([r for r in rows if (r["kind"], r["seed"]) == (one, own)] for one in (kind, UNPLANTED))
        both = {row["session"] for row in faulty} & {row["session"] for row in sound}
        if len(both) < 2 * FEWEST:
            yield f"{kind}, seed {own}: {len(both)} sessions with it and without are too few"
            continue
        draw = np.random.default_rng((seed, own, zlib.crc32(kind.encode())))
        found = [drawn(faulty, sound, evidence, draw) for _ in range(draws)]
        every += found
        yield _line(f"{kind}, seed {own}", found)
    yield _line("all", every)


def _line(name: str, found: Sequence[tuple[str, int]]) -> str:
    off = [away for said, away in found if said == "named"]
    wrong = sum(said == "wrong" for said, _ in found)
    return (
        f"{name:24s} {len(off)} of {len(found)} named, {wrong} something else alone; date right in {off.count(0)}, "
        f"within one session in {sum(away <= 1 for away in off)}"
    )


def main(given: Sequence[str] | None = None) -> None:
    """Draw, pool, print the table."""
    command = Command(
        __doc__, seed=(int, "of dates and changes (default: drawn)"), draws=(20, "laboratories of each fault"),
        out=(Path("out/pooled"), "folder of the other battery"),
    )  # fmt: skip
    asked = command.asked(given)
    rows = [row for row in read_lines(asked.out / "rows.jsonl") if "failed" not in row]
    if not rows:
        command.parser.error(f"no evidence in {asked.out}: run batteries.pooled first")
    for line in table(rows, asked.out / "evidence", said_seed(asked.seed), asked.draws):
        print(line, flush=True)


if __name__ == "__main__":
    main()
