"""Six children who stand and walk over two plates, straight and turning: mass, held-out forces, frames that count.

    scripts/children                  # both walks fitted, and each held out in turn; 18 runs, one line each
    scripts/children --diagnosis      # the same with the diagnosis and its extension

Masses are compared with standing, frames with ``contacts.json``, which was made by eye from the same recordings and
which no fit has seen.
"""

import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from harness.command import DATA, Command
from harness.pool import processes
from harness.rows import write_lines
from harness.runs import ran
from planted_faults.real_sessions import CHILDREN, SESSIONS, of_child

from torchid.conventions import GRAVITY
from torchid.dynamics.rows import residual_rms
from torchid.errors import TorchidError
from torchid.session.standing import standing_weight

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


def run(asked: tuple[str, str, bool]) -> Row:
    """One child, one split."""
    child, split, diagnosis = asked
    own = next(one for one in SESSIONS if one.name == child)
    names = [Path(file.markers).stem for file, _ in own.roles("none")]
    document = of_child(child, zip(names, ("static", *SPLITS[split]), strict=True), DATA)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.json"
        path.write_text(json.dumps(document))
        try:
            outcome = ran(path, Path(folder) / "out", f"diagnosis.enabled={str(diagnosis).lower()}")
        except TorchidError as error:
            return Row(child, split, np.nan, np.nan, np.nan, 0, 0, 0, str(error)[:200])
        weight = standing_weight(outcome.followed.values(), outcome.session, outcome.config.subject.mass_kg)
        held = [outcome.followed[n].wrench for n in outcome.session.part("heldout", "inertia")]
        force = residual_rms([w for w in held if w is not None], outcome.phi)[0]
        found = float(outcome.phi[:, 0].sum())
        truth = json.loads((DATA / "biomechzoo_pig" / "contacts.json").read_text())
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
    arguments = Command(
        __doc__, diagnosis=False, only=("", "children whose code contains this"), jobs=2,
        rows=(Path, "write every run here, one JSON a line"),
    ).asked()  # fmt: skip
    every = [(c, s, arguments.diagnosis) for c in CHILDREN if arguments.only in c for s in SPLITS]
    rows = []
    print(f"{'child':8}{'fitted':10}{'stands':>8}{'found':>8}{'off':>8}{'held out':>10}{'wrongly':>9}{'left out':>10}")
    with processes(arguments.jobs) as pool:
        for row in pool.map(run, every):
            rows.append(row)
            off = row.mass_kg / row.standing_kg - 1
            print(
                f"{row.child:8}{row.fitted:10}{row.standing_kg:8.2f}{row.mass_kg:8.2f}{off:8.1%}{row.heldout:10.1%}"
                f"{row.wrongly:9}{row.left_out:6}/{row.measured:<4}{row.failure}",
                flush=True,
            )
    if arguments.rows:
        write_lines(arguments.rows, map(asdict, rows))
    rows = [row for row in rows if not row.failure]
    held = [row.heldout for row in rows if np.isfinite(row.heldout)]
    off = [abs(row.mass_kg / row.standing_kg - 1) for row in rows]
    print(f"mass off standing: at most {np.max(off):.1%}; held-out force: median {np.median(held):.1%}, at most "
          f"{np.max(held):.1%}; frames wrongly counted {sum(r.wrongly for r in rows)}, left out "
          f"{sum(r.left_out for r in rows) / max(1, sum(r.measured for r in rows)):.1%}")  # fmt: skip


if __name__ == "__main__":
    main()
