"""A battery on real recordings: faults that files can carry, planted at random, found from the files alone?

    scripts/battery --real                              # every kind in two sessions by lot, and all as recorded
    scripts/battery --real --each 0                     # every kind in every session
    scripts/battery --real --cases 20 --kinds gain mass # a random part of it
    scripts/battery --real --aside                      # the sets that nothing is tuned on
    scripts/battery --real --summary out/real_battery   # tables of what was run

Every session is run as recorded, with each trial left out in turn, and with one fault of a kind; the trial that is then
left out is drawn too. What a run says is kept, a line in ``verdicts.jsonl``, so that a battery that was stopped goes on
and other rules of judging need no other run; ``rows.jsonl`` has the judged rows, ``case`` the same for the same fault
with any version of torchid. ``docs/real_battery.md`` says what is planted and what counts. Ends with 1 where torchid
crashed.
"""

import json
import random
import shutil
import sys
import time
import zlib
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

from harness.command import DATA, Among, Command, said_seed
from harness.pool import performed
from harness.rows import read_lines, write_lines
from planted_faults.real_files import Recorded, frames_kept, read_recorded, write_session
from planted_faults.real_kinds import KINDS, UNPLANTED, Planted, plant
from planted_faults.real_sessions import SESSIONS, RealSession, sessions
from planted_faults.real_truth import Inapplicable, Truth

from batteries.real_judge import differences, judged, tables
from batteries.remembered import remembering
from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.run import run_experiment

Said = dict[str, Any]
"""What is kept of a run."""
Fault = Callable[[Recorded, RealSession, Sequence[slice]], Planted]
"""A session with a fault planted, from what was recorded and the frames of each trial that are written."""
SMALL = ("opensim_gait2354", "btk_flatfoot")
SMALL_KINDS = (UNPLANTED, "clock20", "gain", "mass")
"""Choice. Sessions that take least, and kinds that a balance of momentum sees: about two minutes on two cores."""
EACH = 2
"""Choice. Sessions in which each kind is planted, by lot: with all as recorded, an hour on two cores at 97 s a run."""
KEPT = ("causes", "plates", "baseline", "extended", "unexplained", "refuted", "nearest", "detectable", "trace")
"""Parts of ``diagnosis.json`` that are kept."""


@dataclass(frozen=True)
class Case:
    """One run: a fault in a session of which a trial is held out."""

    session: str
    way: str
    kind: str
    seed: int

    @property
    def key(self) -> str:
        """Its name, the same for the same fault."""
        return "-".join((self.session, self.way, self.kind, *([str(self.seed)] if self.kind != UNPLANTED else [])))


def cases(some: Sequence[RealSession], kinds: Sequence[str], seed: int) -> Iterator[Case]:
    """Every kind once in every session, with a trial left out by lot, and sessions as recorded with each left out."""
    for session in some:
        for kind in kinds:
            if kind == UNPLANTED:
                yield from (Case(session.name, way, kind, 0) for way in session.ways)
            else:
                # Of its own, so that leaving out a session or a kind changes no other case.
                own = zlib.crc32(f"{seed} {session.name} {kind}".encode())
                yield Case(session.name, random.Random(own).choice(session.ways), kind, own)  # noqa: S311 - a lot


def perform(case: Case, session: RealSession, root: Path, out: Path, fault: Fault | None = None) -> Said:
    """Plant, run from the files alone, and keep what was said; without a fault of its own, the case's kind."""
    folder, begun, spent = out / "scratch" / case.key, time.perf_counter(), time.process_time()
    kept: dict[str, Any] = {"case": case.key, **asdict(case)}
    try:
        truth, path = planted(case, session, root, folder, fault)
    except Inapplicable as why:
        return kept | {"inapplicable": str(why)}
    kept |= {"truth": truth.table(), "exit": 0, "message": ""}
    try:
        # Nobody reads the reports, which are a fifth of a run.
        with patch("torchid.run.sequence.write_report"), remembering(out / "fits"):
            run_experiment(load_config(path))
    except TorchidError as error:
        kept |= {"exit": error.exit_code, "message": f"{error.code}: {error.message}; {error.remedy}"[:400]}
    except Exception as error:  # a defect of torchid; the battery goes on, and the row says it
        kept |= {"exit": 1, "message": f"{type(error).__name__}: {error}"[:400]}
    kept |= _said(folder / "out")
    shutil.rmtree(folder, ignore_errors=True)
    return kept | {"seconds": time.perf_counter() - begun, "cpu_s": time.process_time() - spent}


def planted(
    case: Case, session: RealSession, root: Path, folder: Path, fault: Fault | None = None
) -> tuple[Truth, Path]:
    """Write a case's files; what is wrong with them, and their config.

    Raises:
        Inapplicable: the session has no place for the fault.
    """
    recorded = read_recorded(session, case.way, root)
    kept = [frames_kept(trial) for trial in recorded.trials]
    own = fault or (lambda *given: plant(case.kind, *given, case.seed))
    faulty, truth = own(recorded, session, kept)
    shutil.rmtree(folder, ignore_errors=True)
    return truth, write_session(faulty, session, folder, kept)


def _said(out: Path) -> Said:
    """What a run has written of diagnosis and residuals."""
    found: Said = {}
    if (out / "diagnosis.json").is_file():
        said = json.loads((out / "diagnosis.json").read_text())
        found["diagnosis"] = {key: said[key] for key in KEPT if key in said}
    if (out / "inertia.json").is_file():
        found["residuals"] = json.loads((out / "inertia.json").read_text())["residuals"]
    return found


def rows(verdicts: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Judged runs; each planted one beside its session as recorded."""
    before = {(v["session"], v["way"]): v for v in verdicts if v["kind"] == UNPLANTED}
    known = {one.name: one.known for one in SESSIONS}
    return [
        judged(v, known.get(v["session"], ()), before.get((v["session"], v["way"])))
        for v in verdicts
        if "inapplicable" not in v
    ]


def summary(out: Path) -> str:
    """Judge all that a folder keeps, write its rows, and return the tables."""
    verdicts = read_lines(out / "verdicts.jsonl")
    found = rows(verdicts)
    write_lines(out / "rows.jsonl", found)
    left_out = [v for v in verdicts if "inapplicable" in v]
    return "\n".join([*tables(found), f"no place for the fault: {len(left_out)} cases"])


def planned(arguments: Namespace, some: dict[str, RealSession]) -> list[Case]:
    """The cases that are asked for, in an order by lot: a battery that is stopped early has a little of everything."""
    names = arguments.sessions or (SMALL if arguments.small else tuple(some))
    kinds = arguments.kinds or (SMALL_KINDS if arguments.small else (UNPLANTED, *KINDS))
    found = list(cases([some[name] for name in names if name in some], kinds, arguments.seed))
    found = found if arguments.sessions or arguments.each == 0 else list(_each(found, arguments.each))
    random.Random(arguments.seed).shuffle(found)  # noqa: S311 - a lot
    return found[: arguments.cases]


def _each(found: Sequence[Case], number: int) -> Iterator[Case]:
    """All sessions as recorded, and of every kind those cases that come first by lot."""
    for kind in dict.fromkeys(case.kind for case in found):
        own = [case for case in found if case.kind == kind]
        yield from own if kind == UNPLANTED else sorted(own, key=lambda case: case.seed)[:number]


def main(given: Sequence[str] | None = None) -> None:
    """Run what is missing, print tables."""
    command = Command(
        __doc__,
        seed=(int, "of places, sizes and trials left out (default: drawn)"),
        jobs=2,
        kinds=(Among((UNPLANTED, *KINDS), None, True, "KIND"), ", ".join(KINDS)),
        sessions=({"nargs": "+", "metavar": "NAME"}, "only these"),
        each=(EACH, f"sessions per kind, by lot; 0: every one (default: {EACH})"),
        cases=(int, "only so many of all, by lot"),
        out=(Path("out/real_battery"), "folder of verdicts and rows"),
        small=(False, "two short sessions and three kinds: about two minutes"),
        aside=(False, "the sets kept aside, and no others"),
        summary=({"nargs": "+", "type": Path, "metavar": "FOLDER"},
                 "only tabulate what a folder keeps; of two, differences"),
    )  # fmt: skip
    asked = command.asked(given)
    if asked.summary:
        print("\n\n".join(map(summary, asked.summary)))
        for other in asked.summary[1:]:
            first, second = (read_lines(folder / "rows.jsonl") for folder in (asked.summary[0], other))
            print("\n".join(["", *differences(first, second)]))
        return
    some = sessions(DATA, asked.aside)
    strange = [name for name in asked.sessions or () if name not in some]
    if strange or not some:
        command.parser.error(f"no such session at {DATA}: {', '.join(strange)}; there are {', '.join(some) or 'none'}")
    asked.seed = said_seed(asked.seed)
    every = {case.key: case for case in planned(asked, some)}
    work = partial(_perform, some=some, root=DATA, out=asked.out)
    for number, kept in enumerate(performed(every, work, asked.jobs, asked.out / "verdicts.jsonl", "case"), 1):
        print(f"{number:4d}/{len(every)} {_in_a_line(kept)}", flush=True)
    print(summary(asked.out))
    sys.exit(any(row["result"] == "crashed" for row in read_lines(asked.out / "rows.jsonl")))


def _perform(case: Case, some: dict[str, RealSession], root: Path, out: Path) -> Said:
    return perform(case, some[case.session], root, out)


def _in_a_line(kept: dict[str, Any]) -> str:
    if "inapplicable" in kept:
        return f"{kept['case']}: no place ({kept['inapplicable']})"
    (row,) = rows([kept])
    causes = [f"{n['effect']} ({', '.join(n['where'])}) {n['confidence']:.2f} {n['is']}" for n in row["named"]]
    said = "; ".join(causes) or row["message"] or "nothing of the laboratory"
    return f"{row['case']} [{row['told']}] {row['result']}: {said}; {row['cpu_s']:.0f} s"


if __name__ == "__main__":
    main()
