"""The same body from disjoint trials: do two identifications of one person differ by no more than both say?

    scripts/module test batteries.disjoint --seed 7
    scripts/module test batteries.disjoint --seed 7 --sessions HC040A hamner2013_subject04

Moving trials of a shared session are parted by lot into two halves, and each is fitted alone (geometry and inertia,
with the static trial) without the diagnosis. Prints how many differences of segment masses, centres of mass and main
moments of inertia lie within one and two of their standard deviations (68 and 95 % expected). Both halves begin with
the same tables: what these get wrong is in both, and is taken out of what the difference should scatter by.
"""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from harness.command import DATA, Among, Command, said_seed
from harness.pool import performed
from planted_faults.real_sessions import SESSIONS, File, RealSession

from torchid.config import Config
from torchid.config.loading import config_of_text
from torchid.errors import TorchidError
from torchid.inertia.fit import InertiaFit
from torchid.inertia.posterior import InertiaUncertainty, uncertainty
from torchid.run import run_experiment

NAMES = tuple(one.name for one in SESSIONS if len(one.moving) > 1)
"""Sessions with several moving trials."""
LEAST = 0.1
"""Choice. Standard deviation of a difference, as a part of what either half says of the value, from which on it counts:
what both have from their tables does not differ."""


def halves(session: RealSession, seed: int) -> tuple[Sequence[File], Sequence[File]]:
    """Moving trials of either half."""
    order = np.random.default_rng([seed, len(session.moving)]).permutation(len(session.moving)).tolist()
    first = sorted(order[: len(order) // 2])
    return [session.moving[k] for k in first], [one for k, one in enumerate(session.moving) if k not in first]


def config_of(session: RealSession, moving: Sequence[File], out: Path) -> Config:
    """A config of the static trial and some moving ones, all of them to be fitted."""
    files = [(one, "fit") for one in moving]
    files += [] if session.static is None else [(session.static, "static")]
    trials = [
        {"name": one.name, "role": role, "file": str(DATA / one.markers)}
        | ({} if one.forces is None else {"forces": str(DATA / one.forces)})
        for one, role in files
    ]
    text = {"subject": session.subject, "markers": session.markers, "trials": trials, "out": str(out.resolve()),
            "diagnosis": {"enabled": False}, **session.sections}  # fmt: skip
    return config_of_text(json.dumps(text), out / "config.json")


def asked(name: str, seed: int, out: Path) -> dict[str, Any]:
    """Differences of one person's values and their standard deviations; why there are none."""
    session = next(one for one in SESSIONS if one.name == name)
    parts = halves(session, seed)
    row = {"key": f"{name}-{seed}", "parts": [[one.name for one in part] for part in parts]}
    found = []
    try:
        for k, part in enumerate(parts):
            with patch("torchid.run.sequence.write_report"):
                identified = run_experiment(config_of(session, part, out / row["key"] / str(k))).identified
            assert identified is not None
            found.append(identified.fit)
    except TorchidError as refused:
        return row | {"refused": str(refused)}
    return row | {"found": compared(*found)}


def compared(a: InertiaFit, b: InertiaFit) -> dict[str, list[list[float]]]:
    """Differences and their standard deviations, by quantity.

    With C the covariance of either half's values about the truth, and P that of the tables, errors of the tables are in
    both by C P^-1, so that the difference scatters by C_a + C_b - C_a P^-1 C_b - C_b P^-1 C_a.
    """
    both = a.covariance @ torch.linalg.solve(a.prior.covariance / a.omega_2, b.covariance)
    apart = uncertainty(a.phi, a.covariance + b.covariance - both - both.mT)
    off = (a.mass - b.mass, a.com - b.com, _main(a.inertia_com) - _main(b.inertia_com))
    names = ("mass", "centre of mass", "moment of inertia")
    found = {}
    for name, difference, sd, own in zip(names, off, _values(apart), _values(a.sd), strict=True):
        counts = sd > LEAST * own
        found[name] = torch.stack([x[counts] for x in (difference, sd)]).tolist()
    return found


def _values(sd: InertiaUncertainty) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Deviations of masses, centres of mass and main moments of inertia."""
    return sd.mass, sd.com, _main(sd.inertia_com)


def _main(some: torch.Tensor) -> torch.Tensor:
    return torch.diagonal(some, dim1=1, dim2=2)


def table(rows: list[dict[str, Any]]) -> list[str]:
    """A line for each quantity."""
    lines = [f"{'':20s}{'values':>8s}{'1 sd':>7s}{'2 sd':>7s}{'> 4 sd':>8s}"]
    some = [row["found"] for row in rows if "found" in row]
    for name in some[0] if some else ():
        off, sd = np.concatenate([np.array(one[name]).reshape(2, -1) for one in some], axis=1)
        z = np.abs(off / sd)
        shares = [100 * float(x.mean()) if len(z) else float("nan") for x in (z < 1, z < 2, z > 4)]
        lines.append(f"{name:20s}{len(z):8d}{shares[0]:6.0f} {shares[1]:6.0f} {shares[2]:7.1f}")
    return lines + [f"{row['key']}: left out: {row['refused']}" for row in rows if "refused" in row]


def main() -> None:
    """Run what is missing, print the table."""
    given = Command(
        __doc__,
        seed=(int, "of the halves; by lot"),
        sessions=(Among(NAMES, NAMES, True, "NAME"), "only these"),
        jobs=2,
        out=(Path("out/disjoint"), "folder of what was found"),
    ).asked()
    seed, rows = said_seed(given.seed, 10**6), []
    jobs = {f"{name}-{seed}": name for name in given.sessions}
    work = partial(asked, seed=seed, out=given.out)
    for row in performed(jobs, work, given.jobs, given.out / "rows.jsonl"):
        rows.append(row)
        print(row["key"], row.get("refused", "done"), flush=True)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
