"""Do stated deviations hold? Simulated people with nothing hidden, identified from their files, against their truth.

    scripts/module test batteries.coverage --seed 91000
    scripts/module test batteries.coverage --seed 91000 --each 20 --jobs 2 --out out/coverage

People are drawn by lot by torchid's own simulator and by the MuJoCo laboratory, as many with skin that slides by 10 mm,
and run without the diagnosis. Prints for masses, centres of mass, main moments of inertia and joint centres how many
lie within one and within 1.96 of the stated standard deviations (68 and 95 % expected), and beyond four, beside the
median deviation and the root mean square error. What a folder keeps is not run again.
"""

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from harness.command import Command, said_seed
from harness.pool import performed
from mujoco_laboratory.session import Undone

from batteries.sessions import OWN, Job, written
from torchid.errors import TorchidError
from torchid.geometry.result import GeometryFit
from torchid.model.pseudo import com, inertia_com
from torchid.run import run_experiment
from torchid.session import Outcome

QUANTITIES = {"mass": "kg", "centre of mass": "m", "moment of inertia": "kg m^2", "joint centre": "m"}
KINDS = tuple((kind, level) for kind in ("null", "skin") for level in (OWN, "mujoco"))
"""With and without skin, of both simulators."""


def plan(seed: int, each: int) -> dict[str, Job]:
    """So many people of each kind."""
    jobs = [Job(kind, (), level, seed + k) for k in range(each) for kind, level in KINDS]
    return {job.key: job for job in jobs}


def asked(job: Job, out: Path) -> dict[str, Any]:
    """Errors and stated deviations of a person by quantity; why there are none."""
    folder = out / "scratch" / job.key
    try:
        config = written(job, folder)
        plain = config.model_copy(update={"diagnosis": config.diagnosis.model_copy(update={"enabled": False})})
        with patch("torchid.run.sequence.write_report"):
            outcome = run_experiment(plain)
        truth = json.loads((folder / "truth" / ("subject.json" if job.level == OWN else "truth.json")).read_text())
    except (TorchidError, Undone) as refused:
        return {"key": job.key, "kind": job.kind, "level": job.level, "refused": str(refused)}
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return {"key": job.key, "kind": job.kind, "level": job.level, "found": compared(outcome, truth)}


def compared(outcome: Outcome, truth: dict[str, Any]) -> dict[str, list[list[float]]]:
    """Error and standard deviation of every value, by quantity."""
    assert outcome.identified is not None
    fit = outcome.identified.fit
    mass, centre, main, offset = truth_of(truth, fit.names)
    found = {
        "mass": (fit.mass - mass, fit.sd.mass),
        "centre of mass": (fit.com - centre, fit.sd.com),
        "moment of inertia": (_diagonal(fit.inertia_com) - main, _diagonal(fit.sd.inertia_com)),
        "joint centre": (outcome.fit.geometry.offset - offset, _offset_sd(outcome.fit)),
    }
    some = {name: (error.flatten(), sd.flatten()) for name, (error, sd) in found.items()}
    return {name: torch.stack([x[sd > 0.0] for x in (error, sd)]).tolist() for name, (error, sd) in some.items()}


def truth_of(truth: dict[str, Any], names: tuple[str, ...]) -> tuple[torch.Tensor, ...]:
    """Masses, centres of mass, main moments of inertia and joint centres of a person."""
    if "phi" in truth:
        phi, offset = (torch.tensor([truth[key][name] for name in names]).double() for key in ("phi", "offset_m"))
        return phi[:, 0], com(phi), _diagonal(inertia_com(phi)), offset
    each = [truth["segments"][name] for name in names]
    mass, centre, inertia, offset = (
        torch.tensor([one[key] for one in each]).double() for key in ("mass_kg", "com_m", "inertia_kgm2", "centre_m")
    )
    return mass, centre, _diagonal(inertia), offset


def _diagonal(some: torch.Tensor) -> torch.Tensor:
    return torch.diagonal(some, dim1=1, dim2=2)


def _offset_sd(fit: GeometryFit) -> torch.Tensor:
    """Standard deviations of joint centres in their parents; zero where nothing was asked."""
    assert fit.uncertainty is not None
    n, offsets = len(fit.prior.mean), fit.prior.n_offset
    way = fit.prior.map[:offsets]
    variance = ((way @ fit.uncertainty.covariance[:n, :n]) * way).sum(1)
    return variance.clamp(min=0.0).sqrt().view(-1, 3)


def table(rows: list[dict[str, Any]]) -> list[str]:
    """A line for each quantity of each kind of person."""
    lines = [f"{'':30s}{'people':>7s}{'68 %':>7s}{'95 %':>7s}{'> 4 sd':>8s}{'median sd':>11s}{'RMS error':>11s}"]
    for kind, level in KINDS:
        own = [row for row in rows if (row["kind"], row["level"]) == (kind, level)]
        some = [row["found"] for row in own if "found" in row]
        for name, unit in QUANTITIES.items() if some else ():
            error, sd = np.concatenate([np.array(one[name]) for one in some], axis=1)
            z = np.abs(error / sd)
            lines.append(
                f"{level + ' ' + ('skin' if kind == 'skin' else 'plain') + ', ' + name:30s}{len(some):7d}"
                f"{100 * (z < 1).mean():6.0f} {100 * (z < 1.96).mean():6.1f} {100 * (z > 4).mean():7.1f} "
                f"{np.median(sd):10.3g} {np.sqrt((error**2).mean()):10.3g} {unit}"
            )
        lines += [f"refused: {row['refused']}" for row in own if "refused" in row]
    return lines


def main() -> None:
    """Run what is missing, print the table."""
    given = Command(
        __doc__,
        seed=(int, "first seed; by lot"),
        each=20,
        jobs=2,
        out=(Path("out/coverage"), "folder of what was found"),
    ).asked()
    seed = said_seed(given.seed, 10**6)
    rows = []
    for row in performed(plan(seed, given.each), partial(asked, out=given.out), given.jobs, given.out / "rows.jsonl"):
        rows.append(row)
        print(row.get("refused", "done"), flush=True)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
