"""Are faults of the stated size found? What verdicts say they would have shown is planted into the same recordings.

    PYTHONPATH=.:scripts:tests python -m batteries.detectable --sessions opensim_gait2354 --kinds plate_gain

Every session is run as recorded. Of each laboratory kind that has a size there (``detectable`` in ``diagnosis.json``),
one place is drawn, and the fault is planted at the stated size, and at half of it. Prints how many were named, on their
own or as what cannot be told from the cause. What a folder keeps is not run again.
"""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from harness.command import DATA, Among, Command, said_seed
from harness.pool import performed
from harness.rows import read_lines
from planted_faults.real_files import Recorded
from planted_faults.real_kinds import UNPLANTED, Given, Planted
from planted_faults.real_sessions import RealSession, sessions
from planted_faults.real_sizes import SIZED, plant_sized

from batteries.real import Case, Said, perform, rows
from torchid.diagnosis.evidence.planted_rules import CHANCE

FACTORS = {"whole": 1.0, "half": 0.5}
"""Parts of the stated size that are planted."""
FOUND = ("right", "later")
"""Results that count as named (``real_judge.RESULTS``)."""


@dataclass(frozen=True)
class Sized:
    """A case with the fault that is planted."""

    case: Case
    effect: str = ""
    key: str = ""
    size: float = 0.0
    channels: Mapping[str, str] | None = None
    """Name of the plate in each trial's file; None: not of a plate."""

    def plant(self, recorded: Recorded, session: RealSession, kept: Sequence[slice]) -> Planted:
        """The session with the fault."""
        on = Given(recorded, session, kept, np.random.default_rng(self.case.seed))
        return plant_sized(self.effect, self.key, self.size, self.channels, on)


def sized(verdict: Said, kinds: Sequence[str], seed: int) -> Iterator[Sized]:
    """Faults at the sizes that a session as recorded states, each kind at a place by lot."""
    said = verdict.get("diagnosis", {})
    for effect, key in SIZED:
        some = [d for d in said.get("detectable", ()) if (d["effect"], d["parameter"]) == (effect, key) and "size" in d]
        # Neither single trials nor all plates together: what no plate tells from the body's mass.
        some = [
            d for d in some if d["where"] == ["session"] or (len(d["where"]) == 1 and d["where"][0] in said["plates"])
        ]
        if not some or effect not in kinds:
            continue
        own = zlib.crc32(f"{seed} {verdict['session']} {effect} {key}".encode())
        one = some[int(np.random.default_rng(own).integers(len(some)))]
        plate = said["plates"].get(one["where"][0])
        for name, factor in FACTORS.items():
            case = Case(verdict["session"], verdict["way"], f"{effect}:{key}:{name}", own)
            yield Sized(case, effect, key, factor * one["size"], plate and plate["channels"])


def _perform(one: Sized, some: Mapping[str, RealSession], out: Path) -> Said:
    return perform(one.case, some[one.case.session], DATA, out, one.plant if one.effect else None)


def summary(verdicts: Sequence[Said]) -> str:
    """Share that was named at the stated size and at half of it, of all kinds and of each."""
    found = [row | dict(zip(("effect", "key", "part"), row["kind"].split(":"), strict=True))
             for row in rows(verdicts) if row["kind"] != UNPLANTED]  # fmt: skip
    lines = [f"share named; {CHANCE} is stated for the whole size"]
    for effect in ("all", *dict.fromkeys(row["effect"] for row in found)):
        own = [row for row in found if effect in ("all", row["effect"])]
        hits = {part: [row["result"] in FOUND for row in own if row["part"] == part] for part in FACTORS}
        lines.append(f"{effect:16s}" + "  ".join(f"{part} {sum(hit)}/{len(hit)}" for part, hit in hits.items()))
    lines += [f"{row['case']} [{row['told']}] {row['result']}" for row in found]
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, print the shares."""
    kinds = tuple(dict.fromkeys(effect for effect, _ in SIZED))
    some = sessions(DATA, aside=False)
    given = Command(
        __doc__,
        seed=(int, "of places and directions (default: drawn)"),
        jobs=2,
        kinds=(Among(kinds, kinds, True, "KIND"), ", ".join(kinds)),
        sessions=(Among(tuple(some), None, True, "NAME"), "only these"),
        cases=(int, "only so many planted runs, by lot"),
        out=(Path("out/detectable"), "folder of verdicts"),
    ).asked()
    seed, kept = said_seed(given.seed), given.out / "verdicts.jsonl"
    bare = [Case(name, some[name].ways[0], UNPLANTED, 0) for name in given.sessions or some]
    work = partial(_perform, some=some, out=given.out)
    first = list(performed({c.key: Sized(c) for c in bare}, work, given.jobs, kept, "case"))
    jobs = [one for verdict in first for one in sized(verdict, given.kinds, seed)]
    order = np.random.default_rng(seed).permutation(len(jobs))[: given.cases]
    planted = {jobs[k].case.key: jobs[k] for k in order}
    for one in performed(planted, work, given.jobs, kept, "case"):
        print(one["case"], one.get("inapplicable", ""), flush=True)
    print(summary([one for one in read_lines(kept) if one["case"] in {*planted, *(c.key for c in bare)}]))


if __name__ == "__main__":
    main()
