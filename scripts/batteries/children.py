"""Six children who stand and walk over two plates, straight and turning: mass, held-out forces, frames that count.

    scripts/children                  # both walks fitted, and each held out in turn; 18 runs, one line each
    scripts/children --diagnosis      # the same with the diagnosis and its extension

Masses are compared with standing, frames with ``contacts.json``, which was made by eye from the same recordings and
which no fit has seen.
"""

import argparse
import json
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from torchid.config import load_config
from torchid.config.sections import PROJECT_DATA
from torchid.conventions import GRAVITY
from torchid.dynamics.rows import residual_rms
from torchid.errors import TorchidError
from torchid.run import run_experiment
from torchid.session.standing import standing_weight

CHILDREN = {
    "HC030A": (45.8, "01", "05", "22"), "HC031A": (27.7, "01", "06", "23"), "HC033A": (51.5, "01", "10", "22"),
    "HC038A": (56.8, "01", "11", "27"), "HC040A": (25.0, "04", "14", "40"), "HC044A": (39.4, "01", "15", "29"),
}  # fmt: skip
"""Recorded mass [kg]; static, straight and turning trial."""
SPLITS = {"both": ("fit", "fit"), "straight": ("fit", "heldout"), "turning": ("heldout", "fit")}
"""Roles of the straight and the turning walk."""


@dataclass(frozen=True)
class Row:
    """What one run came to."""

    child: str
    fitted: str
    standing_kg: float
    mass_kg: float
    heldout: float
    """Residual force of the held-out walk as a share of the weight; NaN where none is."""
    wrongly: int
    """Frames that count although ``contacts.json`` calls them not measured."""
    left_out: int
    measured: int
    """Frames that it calls fully measured, and how many of them are left out."""
    failure: str


def run(arguments: tuple[str, str, bool, Path]) -> Row:
    """One child, one split."""
    child, split, diagnosis, data = arguments
    torch.set_num_threads(1)
    mass, *numbers = CHILDREN[child]
    roles = ("static", *SPLITS[split])
    trials = [
        {"name": f"{child}{n}", "role": role, "file": str(data / f"{child}{n}.c3d")}
        for n, role in zip(numbers, roles, strict=True)
    ]
    document = {
        "subject": {"name": child, "mass_kg": mass, "mass_sd_kg": 0.5}, "markers": "plug_in_gait_oxford_foot",
        "trials": trials, "diagnosis": {"enabled": diagnosis}, "out": "out",
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.json"
        path.write_text(json.dumps(document))
        try:
            outcome = run_experiment(load_config(path))
        except TorchidError as error:
            return Row(child, split, np.nan, np.nan, np.nan, 0, 0, 0, str(error)[:200])
        weight = standing_weight(outcome.followed.values(), outcome.session, outcome.config.subject.mass_kg)
        held = [outcome.followed[n].wrench for n in outcome.session.part("heldout", "inertia")]
        force = residual_rms([w for w in held if w is not None], outcome.phi)[0]
        found = float(outcome.phi[:, 0].sum())
        truth = json.loads((data / "contacts.json").read_text())
        counts = np.array([
            _frames(truth[name], item.contact.used.numpy()) for name, item in outcome.followed.items()
            if item.contact is not None and name in truth
        ]).sum(axis=0)  # fmt: skip
    standing = weight.mass if weight else np.nan
    return Row(child, split, standing, found, force / (GRAVITY * standing), *(int(c) for c in counts), "")


def _frames(truth: dict[str, list[list[int]]], used: np.ndarray) -> tuple[int, int, int]:
    full, never = np.zeros(len(used), bool), np.zeros(len(used), bool)
    for mask, key in ((full, "fully_measured"), (never, "not_measured")):
        for first, last in truth[key]:
            mask[first : last + 1] = True
    return int((used & never).sum()), int((full & ~used).sum()), int(full.sum())


def main() -> None:
    """Run, print a line a run and the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--diagnosis", action="store_true")
    parser.add_argument("--only", default="", help="children whose code contains this")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rows", type=Path, help="write every run here, one JSON a line")
    arguments = parser.parse_args()
    data = Path(os.environ.get("TORCHID_DATA", PROJECT_DATA)) / "biomechzoo_pig"
    every = [(c, s, arguments.diagnosis, data) for c in CHILDREN if arguments.only in c for s in SPLITS]
    rows = []
    print(f"{'child':8}{'fitted':10}{'stands':>8}{'found':>8}{'off':>8}{'held out':>10}{'wrongly':>9}{'left out':>10}")
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for row in pool.map(run, every):
            rows.append(row)
            off = row.mass_kg / row.standing_kg - 1
            print(
                f"{row.child:8}{row.fitted:10}{row.standing_kg:8.2f}{row.mass_kg:8.2f}{off:8.1%}{row.heldout:10.1%}"
                f"{row.wrongly:9}{row.left_out:6}/{row.measured:<4}{row.failure}",
                flush=True,
            )
    if arguments.rows:
        arguments.rows.write_text("".join(json.dumps(asdict(row)) + "\n" for row in rows))
    rows = [row for row in rows if not row.failure]
    held = [row.heldout for row in rows if np.isfinite(row.heldout)]
    off = [abs(row.mass_kg / row.standing_kg - 1) for row in rows]
    print(f"mass off standing: at most {np.max(off):.1%}; held-out force: median {np.median(held):.1%}, at most "
          f"{np.max(held):.1%}; frames wrongly counted {sum(r.wrongly for r in rows)}, left out "
          f"{sum(r.left_out for r in rows) / max(1, sum(r.measured for r in rows)):.1%}")  # fmt: skip


if __name__ == "__main__":
    main()
