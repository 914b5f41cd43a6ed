"""How often `scripts/demo` is right: seeds by lot, whatever they hide, and nothing.

    PYTHONPATH=.:scripts python -m batteries.demos --seeds 40
    PYTHONPATH=.:scripts python -m batteries.demos --seeds 40 --first 7000 --out out/demos

Every demonstration is what a user sees who runs it with that seed. Prints a line for each, what was hidden and what was
named, and at the end how many verdicts were right, by what was hidden, with the time that they took. Seeds
that a folder keeps are not run again: name another one after a change.
"""

import json
import shutil
import time
from collections import Counter
from functools import partial
from pathlib import Path

from harness.command import Command, said_seed
from harness.pool import performed
from harness.rows import Row

from torchid.run import run_experiment, run_simulation
from torchid.run.demo import blind, demo_config
from torchid.simulate.hiding import judge


def _performed(seed: int, out: Path) -> Row:
    """Hide, run on the files alone, and only then compare."""
    config = demo_config(seed).model_copy(update={"out": out / str(seed)})
    begin = time.monotonic(), time.process_time()
    recordings = run_simulation(config)
    run_experiment(blind(config, recordings))
    taken = time.monotonic() - begin[0], time.process_time() - begin[1]
    truth = json.loads((recordings.parent / "truth" / "subject.json").read_text())["options"]["effects"]
    causes = json.loads((config.out / "diagnosis.json").read_text())["causes"]
    shutil.rmtree(config.out)
    right = judge(truth, [cause for cause in causes if cause["level"] != "possible"])[0]
    return {
        "key": str(seed), "hidden": [(one["effect"], *one["where"]) for one in truth], "right": right,
        "named": [(c["effect"], *c["where"], c["level"]) for c in causes], "wall_s": taken[0], "cpu_s": taken[1],
    }  # fmt: skip


def _in_a_line(row: Row) -> str:
    hidden = ", ".join(" ".join(one) for one in row["hidden"]) or "nothing"
    named = "; ".join(" ".join(one) for one in row["named"]) or "nothing"
    said = "right" if row["right"] else "WRONG"
    return f"{row['key']}: {hidden}: {said} (named {named}; {row['cpu_s']:.0f} s of CPU)"


def main() -> None:
    """Run what is missing, and count."""
    asked = Command(__doc__, seeds=40, first=(int, "seed (default: by lot)"), workers=2, out=Path("out/demos")).asked()
    first = said_seed(asked.first, 10**6)
    seeds = {str(k): k for k in range(first, first + asked.seeds)}
    rows = []
    for row in performed(seeds, partial(_performed, out=asked.out), asked.workers, asked.out / "rows.jsonl"):
        print(_in_a_line(row), flush=True)
        rows.append(row)
    kinds = Counter(row["hidden"][0][0] if row["hidden"] else "nothing" for row in rows)
    right = Counter(row["hidden"][0][0] if row["hidden"] else "nothing" for row in rows if row["right"])
    print("\n".join(f"{kind}: {right[kind]} of {count}" for kind, count in sorted(kinds.items())))
    print(f"right: {right.total()} of {len(rows)}; {sum(row['cpu_s'] for row in rows) / len(rows):.0f} s of CPU each")


if __name__ == "__main__":
    main()
