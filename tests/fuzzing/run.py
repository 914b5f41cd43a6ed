"""Damaged files read by torchid: none may crash, hang, raise an untyped error, or be read as other numbers unsaid.

    scripts/fuzz --kind c3d --count 20000           # mutants of one kind; all kinds without --kind
    scripts/fuzz --kind trc --truncate 1000         # files cut short
    scripts/fuzz --kind c3d --seed 7 --only 123 --keep mutant.c3d

The seed is printed; with it and its number every mutant is made again. A mutant is refused (a typed error), read with
a note, read equal, or read silently as something else, which must be one of the rules of `fuzzing/changes.py`. The exit
code is 1 where anything is bad or silent beyond these rules.
"""

import sys
import tempfile
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from harness.command import Among, Command, said_seed
from reliability_table.record import record

from fuzzing.seeds import KINDS, seeds
from fuzzing.workers import BATCH, Verdict, mutant, run

OUTCOMES = ("refused", "noted", "equal", "silent", "bad")
SHOWN = 12
CUT = ("c3d", "trc", "mot", "sto")
"""Kinds whose end is not marked in the file, so that a cut could pass."""


def main() -> None:
    """Make mutants, read them, and print what became of them."""
    args = Command(
        __doc__, kind=Among((*KINDS, "all"), "all"), count=(1000, "mutants of each kind (default 1000)"),
        truncate=(int, "so many cuts of each kind instead of mutants"),
        seed=(int, "of the draws; default: a new one, which is printed"),
        jobs=(1, "processes at a time (default 1)"), only=(int, "the mutant of this number alone"),
        keep=(Path, "write the mutant of --only there"),
        record=(False, "note the figures in tests/reliability_table/reliability.json"),
    ).asked()  # fmt: skip
    seed = said_seed(args.seed, 2**32)
    kinds = [kind for kind in KINDS if kind == args.kind or args.kind == "all" and (not args.truncate or kind in CUT)]
    if args.keep:
        _keep(kinds[0], args, seed)
    failed = 0
    for kind in kinds:
        numbers = range(args.truncate or args.count) if args.only is None else [args.only]
        begin = time.monotonic()
        found = verdicts(kind, numbers, seed, bool(args.truncate), args.jobs)
        failures = _print(kind, found, time.monotonic() - begin)
        failed += failures
        if args.record:
            _record(kind, found, failures, args, seed)
    sys.exit(1 if failed else 0)


def verdicts(kind: str, numbers: Sequence[int], seed: int, truncate: bool = False, jobs: int = 1) -> list[Verdict]:
    """Verdicts on the mutants of these numbers."""
    if jobs == 1:
        return run(kind, numbers, seed, truncate)
    parts = [numbers[k : k + BATCH] for k in range(0, len(numbers), BATCH)]
    with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
        waiting = [pool.submit(run, kind, part, seed, truncate) for part in parts]
        return [verdict for part in waiting for verdict in part.result()]


def failed(verdict: Verdict) -> bool:
    """Whether a verdict must not be."""
    unsaid = verdict.outcome == "silent" and ("!" in verdict.detail or verdict.how == "cut")
    return verdict.outcome == "bad" or unsaid


def _record(kind: str, found: list[Verdict], failures: int, args: Namespace, seed: int) -> None:
    """The row of this run in the table of `scripts/reliability`."""
    goal = f"G4 {kind}" if args.truncate else "G1 long" if kind == "c3d" else f"G2 {kind}"
    what = f"--truncate {args.truncate}" if args.truncate else f"--count {args.count}"
    bad = sum(one.outcome == "bad" for one in found)
    text = f"{len(found)} {'cuts' if args.truncate else 'mutants'}: {bad} bad, {failures - bad} unsaid beyond the rules"
    record(goal, text, not failures, f"scripts/fuzz --kind {kind} {what} --seed {seed}")


def _keep(kind: str, args: Namespace, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        sound = seeds(kind, Path(folder))
    one, damaged = mutant(kind, args.only or 0, seed, bool(args.truncate), sound)
    args.keep.write_bytes(damaged.content)
    for name, content in one.beside.items():
        (args.keep.parent / name).write_bytes(content)
    print(f"{args.keep}: of {one.name}, {damaged.how} at {damaged.place}")


def _print(kind: str, found: list[Verdict], seconds: float) -> int:
    """The table of a kind; returns how many mutants failed."""
    counts = Counter(one.outcome for one in found)
    slowest = max((one.seconds for one in found), default=0.0)
    figures = ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES)
    print(f"\n{kind}: {len(found)} mutants in {seconds:.0f} s: {figures}; slowest {slowest:.2f} s")
    bare = Counter(one.detail for one in found if one.outcome == "refused" and not one.remedy)
    if bare:
        print(f"  refused without a remedy: {', '.join(f'{code} ({count})' for code, count in bare.most_common())}")
    ruled = Counter(one.detail for one in found if one.outcome == "silent" and not failed(one))
    for rule, count in ruled.most_common():
        print(f"  {count:6} silent by rule: {rule}")
    wrong = [one for one in found if failed(one)]
    grouped: dict[tuple[str, str], list[Verdict]] = {}
    for one in wrong:
        grouped.setdefault((one.outcome, one.detail), []).append(one)
    for (outcome, detail), group in sorted(grouped.items(), key=lambda item: -len(item[1])):
        print(f"  {len(group):6} {outcome.upper()}: {detail}")
        places = Counter((one.how, one.place) for one in group)
        first = {(one.how, one.place): one for one in reversed(group)}
        for what, count in places.most_common(SHOWN):
            one = first[what]
            print(f"         {count:5} by {what[0]} at {what[1]}, such as --only {one.number} ({one.seed})")
    return len(wrong)


if __name__ == "__main__":
    main()
