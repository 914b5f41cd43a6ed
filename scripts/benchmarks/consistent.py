"""Motion that obeys its forces, on recordings: what it leaves of them, what it takes from markers, and its speed.

    cd scripts && python -m benchmarks.consistent                       # the recordings named below
    cd scripts && python -m benchmarks.consistent ../configs/demo.yaml  # others
    cd scripts && python -m benchmarks.consistent --forward             # replayed by Pinocchio as well (extra ``test``)

Every config is run with its diagnosis, from files to results. A line for each trial: residual force and moment and
distance of the markers, of the motion that follows markers and of the one that obeys its forces. ``--forward`` gives
the consistent motion's own torques, ground forces and what is left at the pelvis to Pinocchio, which integrates them
for 0.3 s from several instants: how far the pelvis and the worst other body are from the motion then, in the median.
Writes ``out/consistent.json``.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from harness.command import ROOT, Command
from harness.rows import Row, write_json
from harness.runs import ran

from torchid.errors import TorchidError
from torchid.session import Outcome
from torchid.torque.consistent import Agreement

NAMES = (
    "opencap_subject4", "opensim_rajagopal_walk", "hamner2013_subject04", "opensim_subject01_gait2354",
    "biomechzoo_hc030a", "biomechzoo_hc040a",
)  # fmt: skip
"""Configs whose recordings are walks, runs and squats."""


def rows(config: Path, forward: bool) -> Iterator[Row]:
    """A row for each trial of a config."""
    out = ROOT / "out" / "consistent" / config.stem
    outcome = ran(config, out, "diagnosis.enabled=true", "motion.consistent=true")
    spent = json.loads((out / "provenance.json").read_text())["stages"]["consistent"]["cpu_seconds"]
    frames = sum(len(one.motion.time) for one in outcome.consistent.values())
    for name, one in outcome.consistent.items():
        row = {"config": config.stem, "trial": name, "before": figures(one.before), "after": figures(one.after),
               "settled": one.settled, "trusted": one.trusted, "frames_per_s": frames / spent}  # fmt: skip
        yield row | ({"forward": replayed(outcome, name)} if forward else {})


def figures(at: Agreement) -> list[float]:
    """Force [N], moment [N m], markers [mm]."""
    return [at.force_N, at.moment_Nm, 1e3 * at.marker_m]


def replayed(outcome: Outcome, name: str) -> list[float] | None:
    """Turn [deg] and way [mm] of the pelvis, and the same of the worst other body, after 0.3 s: medians over several
    instants; None where nothing is known for so long."""
    if outcome.fit.model.tree.coupling is not None:
        return None  # Pinocchio knows no functions of coordinates
    from benchmarks.forward import drifts  # noqa: PLC0415 - brings Pinocchio

    found = drifts(outcome, name)
    return [median(column) for column in zip(*found, strict=True)] if found else None


def line(row: Row) -> str:
    """A row as a line."""
    both = "  ->  ".join("{:6.1f} N {:5.1f} N m {:5.1f} mm".format(*row[key]) for key in ("before", "after"))
    said = "" if row["settled"] else "  not settled"
    if row.get("forward"):
        said += "  pelvis {:.1f} deg {:.0f} mm, worst body {:.1f} deg {:.0f} mm".format(*row["forward"])
    return f"{row['config'][:22]:23}{row['trial'][:14]:15}{both}  trust {row['trusted']:.2f}{said}"


def main() -> None:
    """Print a line for each trial, then what was reached over all."""
    asked = Command(
        __doc__, ("configs",), configs=({"nargs": "*", "type": Path}, "without any, those named in the module"),
        forward=(False, "replay the motion by Pinocchio"),
    ).asked()  # fmt: skip
    found = []
    for config in asked.configs or [ROOT / "configs" / f"{name}.yaml" for name in NAMES]:
        try:
            own = list(rows(config, asked.forward))
        except TorchidError as error:
            print(f"{config.stem}: left out: {error}", flush=True)
            continue
        for row in own:
            print(line(row), flush=True)
        if own:
            print(f"{config.stem}: {own[0]['frames_per_s']:.0f} frames/s", flush=True)
        found += own
    for key, index, unit in (("force", 0, "N"), ("moment", 1, "N m"), ("markers", 2, "mm")) if found else ():
        values = [median(row[side][index] for row in found) for side in ("before", "after")]
        print(f"median {key}: {values[0]:.1f} -> {values[1]:.1f} {unit}")
    write_json(ROOT / "out" / "consistent.json", found)


if __name__ == "__main__":
    main()
