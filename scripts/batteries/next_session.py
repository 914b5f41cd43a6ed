"""A laboratory's file given to its next session: is its fault named there, and does a wrong file mislead?

    scripts/module test batteries.pooled --seed 5101 --out out/pooled          # first: evidence of every session
    scripts/module test batteries.next_session --out out/pooled                # then: each with the file of the others

Each session is run with what the others of the same fault say (``right file``), and, as it was recorded, with what
those with the fault say (``wrong file``): then it has to say that it is unlike them, or to name nothing that they have.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from harness.command import Command
from harness.pool import performed
from harness.rows import read_lines
from planted_faults.real_kinds import UNPLANTED

from batteries.pooled import NEAR_M, Case, people, perform
from torchid.cohort.laboratories import laboratories
from torchid.cohort.pooling import pooled
from torchid.diagnosis.verdict.records import EVEN
from torchid.session.laboratory import SessionEvidence, laboratory_dataset, read_laboratory
from torchid.storage.netcdf import write_netcdf

Row = dict[str, Any]


@dataclass(frozen=True)
class Next:
    """A session, and the kind of fault that the sessions before it have."""

    case: Case
    before: str

    @property
    def key(self) -> str:
        """Its name."""
        return f"{self.case.key}-after-{self.before}"


def file_for(one: Next, rows: Sequence[Row], out: Path) -> Path:
    """What all other sessions with the fault say of it, written."""
    keys = {r["session"]: r["key"] for r in rows if (r["kind"], r["seed"]) == (one.before, one.case.seed)}
    keys.pop(one.case.session, None)
    found = {name: read_laboratory(out / "evidence" / f"{key}.nc") for name, key in keys.items()}
    home = max(laboratories(found, {}), key=lambda lab: len(lab.visits))
    path = out / "before" / f"{one.key}.nc"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_netcdf(path, [laboratory_dataset(SessionEvidence(pooled(home).expected, home.plates, pooled=True))])
    return path


def _perform(one: Next, rows: Sequence[Row], some: dict[str, Any], out: Path) -> Row:
    return perform(one.case, some, out, file_for(one, rows, out)) | {"key": one.key, "before": one.before}


def tables(rows: Sequence[Row], first: Sequence[Row]) -> Iterator[str]:
    """A line for each fault, with the right file and with a wrong one."""
    truths = {(r["kind"], r["seed"]): r["truth"] for r in first}
    for kind, before, seed in dict.fromkeys((r["kind"], r["before"], r["seed"]) for r in rows):
        own = [r for r in rows if (r["kind"], r["before"], r["seed"]) == (kind, before, seed) and "failed" not in r]
        truth = truths[before, seed]
        named = [sum(_is(c, truth, r["plates"]) for c in r["named"]) for r in own]
        unlike = sum(r["earlier"]["unlike"] is not None for r in own)
        if kind == before:
            alone = {r["session"]: r for r in first if (r["kind"], r["seed"]) == (kind, seed)}
            silent = [not any(_is(c, truth, r["plates"]) for c in alone[r["session"]]["named"]) for r in own]
            right = sum(bool(n) for n, still in zip(named, silent, strict=True) if still)
            said = f"{sum(map(bool, named))} of {len(own)} named; of {sum(silent)} that alone are silent {right}"
            yield f"{kind:10s} right file: {said}; unlike {unlike}"
        else:
            misled = sum(bool(n) for n in named)
            yield f"{before:10s} wrong file: {misled} of {len(own)} misled; unlike {unlike}"


def _is(cause: tuple[str, Sequence[str], float], truth: Row, plates: dict[str, list[float]]) -> bool:
    """Whether a cause is more than possible, and what was planted."""
    effect, where, sure = cause
    if not truth or effect != truth["effect"] or sure <= EVEN:
        return False
    if truth["centre"] is None:
        return True
    away = {name: torch.dist(torch.tensor(p[:2]), torch.tensor(truth["centre"][:2])) for name, p in plates.items()}
    return set(where) == {name for name, apart in away.items() if apart < NEAR_M}


def main(given: Sequence[str] | None = None) -> None:
    """Run what is missing, print tables."""
    command = Command(
        __doc__, jobs=2, simulated=(0, "people of the simulator, as in the other battery"),
        out=(Path("out/pooled"), "folder of the other battery"), summary=(False, "only judge what is kept"),
    )  # fmt: skip
    asked = command.asked(given)
    first = [r for r in read_lines(asked.out / "rows.jsonl") if "failed" not in r]
    if not first:
        command.parser.error(f"no evidence in {asked.out}: run batteries.pooled first")
    if not asked.summary:
        some = {one.name: (one, root) for one, root in people(asked.simulated, first[0]["seed"], asked.out / "people")}
        cases = {(r["kind"], r["session"], r["seed"]): Case(r["session"], r["kind"], r["seed"]) for r in first}
        every = [Next(case, case.kind) for case in cases.values()]
        sound = [case for case in cases.values() if case.kind == UNPLANTED]
        every += [
            Next(case, kind) for case in sound for kind in dict.fromkeys(k for k, *_ in cases) if kind != UNPLANTED
        ]
        jobs = {one.key: one for one in every}
        work = partial(_perform, rows=first, some=some, out=asked.out)
        for number, row in enumerate(performed(jobs, work, asked.jobs, asked.out / "next.jsonl"), 1):
            print(f"{number:4d}/{len(jobs)} {row['key']} {row.get('failed', '')}", flush=True)
    print("\n".join(tables(read_lines(asked.out / "next.jsonl"), first)))


if __name__ == "__main__":
    main()
