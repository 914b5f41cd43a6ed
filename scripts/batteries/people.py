"""Is a cohort's people a better prior than tables? Simulated people by lot, identified with both, against the truth.

    scripts/module test batteries.people --seed 5200
    scripts/module test batteries.people --seed 5200 --before 24 --after 12 --groups mujoco shifted tables

Groups: of the MuJoCo laboratory, whose people come from other tables; of the own simulator, from its tables as a group
by lot differs from them (``shifted``); and from its tables as they are (``tables``), where nothing is to be gained.
The first of each group are run for their ``person.nc``; what these say is the prior of the others, who are run with it
and without. Prints root mean square errors before and after forces, with the cohort's people and with tables alone.
What a folder keeps is not run again.

    scripts/module test batteries.people --children

Of recorded children nobody knows the truth: each is run with what the other five say, and without, and held-out forces
and moments are compared.
"""

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from harness.command import DATA, Among, Command, said_seed
from harness.pool import performed
from harness.rows import Row
from mujoco_laboratory.session import Undone
from planted_faults.real_files import frames_kept, read_recorded, write_session
from planted_faults.real_sessions import CHILDREN, SESSIONS

from batteries.coverage import QUANTITIES, compared, truth_of
from batteries.remembered import remembering
from batteries.sessions import OWN, Job, written
from torchid.cohort.people import people_like
from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.model.anthropometry import inertial_prior
from torchid.model.people import People, own_covariance, shared
from torchid.model.pseudo import com, mass
from torchid.run import run_experiment
from torchid.session.people import people_dataset, subject_prior
from torchid.session.person import LEFT, NAME, UNLIKE, read_person
from torchid.session.tables import heldout_errors
from torchid.storage.netcdf import write_netcdf

GROUPS = ("mujoco", "shifted", "tables")
OWN_SHARE = 0.4
"""Choice. Share of the tables' variance within a group that differs from them."""
PEOPLE = "people.nc"


@dataclass(frozen=True)
class Case:
    """One person, run from tables or as one of his group."""

    group: str
    seed: int
    number: int
    like: bool = False

    @property
    def key(self) -> str:
        """Its name."""
        return f"{self.group}-{self.seed}-{self.number}{'-like' if self.like else ''}"


def group_of(seed: int) -> People:
    """A group that differs from the tables, by lot."""
    mean = np.random.default_rng((seed, 11)).normal(size=shared().shape[1]).clip(-2.0, 2.0)
    score = shared() @ torch.tensor(mean) * (1.0 - OWN_SHARE) ** 0.5
    return People(score, own_covariance(OWN_SHARE), 0, OWN_SHARE)


def perform(case: Case, out: Path) -> Row:
    """Errors of a person, and the evidence, which is kept."""
    folder = out / "scratch" / case.key
    job = Job("null", (), "mujoco" if case.group == "mujoco" else OWN, case.seed + case.number)
    own = partial(inertial_prior, people=group_of(case.seed))
    shifted = patch("torchid.simulate.subject.inertial_prior", own) if case.group == "shifted" else nullcontext()
    row = {"key": case.key, "group": case.group, "number": case.number, "like": case.like}
    try:
        with shifted:
            config = written(job, folder)
        people = out / f"{case.group}-{case.seed}-{PEOPLE}" if case.like else None
        plain = {
            "diagnosis": config.diagnosis.model_copy(update={"enabled": False}),
            "subject": config.subject.model_copy(update={"people": people}),
        }
        with patch("torchid.run.sequence.write_report"), remembering(out / "fits"):
            outcome = run_experiment(config.model_copy(update=plain))
        truth = json.loads((folder / "truth" / ("subject.json" if job.level == OWN else "truth.json")).read_text())
        if not case.like:
            (out / "evidence").mkdir(parents=True, exist_ok=True)
            shutil.copy(config.out / NAME, out / "evidence" / f"{case.key}.nc")
        true_mass, true_com, *_ = truth_of(truth, outcome.fit.model.tree.names)
        prior = subject_prior(config.model, plain["subject"], outcome.fit).mean
        row["before"] = {
            "mass": (mass(prior) - true_mass).tolist(), "centre of mass": (com(prior) - true_com).flatten().tolist(),
        }  # fmt: skip
        row["notes"] = [note.message for note in outcome.notes if note.code.startswith("people.")]
        return row | {"found": compared(outcome, truth)}
    except (TorchidError, Undone) as refused:
        return row | {"refused": str(refused)}
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def perform_child(name: str, like: bool, out: Path) -> Row:
    """Held-out errors of a child, from tables or as one of the others; the evidence is kept."""
    session = next(one for one in SESSIONS if one.name == name)
    row, folder = {"key": f"{name}{'-like' if like else ''}"}, out / "scratch" / f"{name}-{like}"
    recorded = read_recorded(session, session.ways[-1], DATA)
    config = load_config(write_session(recorded, session, folder, [frames_kept(one) for one in recorded.trials]))
    plain = {"diagnosis": config.diagnosis.model_copy(update={"enabled": False})}
    if like:
        people = people_like([read_person(out / "evidence" / f"{one}.nc") for one in CHILDREN if one != name])
        assert people is not None
        row["own"] = people.own
        write_netcdf(folder / PEOPLE, [people_dataset(people)])
        plain["subject"] = config.subject.model_copy(update={"people": folder / PEOPLE})
    with patch("torchid.run.sequence.write_report"), remembering(out / "fits"):
        outcome = run_experiment(config.model_copy(update=plain))
    if not like:
        (out / "evidence").mkdir(parents=True, exist_ok=True)
        shutil.copy(config.out / NAME, out / "evidence" / f"{name}.nc")
    shutil.rmtree(folder, ignore_errors=True)
    return row | heldout_errors(outcome) | {"notes": [n.message for n in outcome.notes if n.code in (LEFT, UNLIKE)]}


def children(jobs: int, out: Path) -> Iterator[str]:
    """A line for each child: held-out errors with tables and with the other children."""
    rows = {}
    for like in (False, True):
        some = {f"{name}{'-like' if like else ''}": name for name in CHILDREN}
        for row in performed(some, partial(perform_child, like=like, out=out), jobs, out / "children.jsonl"):
            rows[row["key"]] = row
    kinds = {"force_rmse_N": "N", "moment_rmse_Nm": "N m"}
    for name in CHILDREN:
        own, like = rows[name], rows[f"{name}-like"]
        said = ", ".join(f"{own[kind]:.1f} -> {like[kind]:.1f} {unit}" for kind, unit in kinds.items())
        yield f"{name}: {said} (own share {like['own']}) {' '.join(like['notes'])}"
    for kind in kinds:
        yield f"{kind}: median ratio {np.median([rows[f'{n}-like'][kind] / rows[n][kind] for n in CHILDREN]):.3f}"


def people_of(group: str, seed: int, before: int, out: Path) -> People | None:
    """What the first of a group say of one more, written."""
    files = [out / "evidence" / f"{Case(group, seed, k).key}.nc" for k in range(before)]
    people = people_like([read_person(file) for file in files if file.is_file()])
    if people is not None:
        write_netcdf(out / f"{group}-{seed}-{PEOPLE}", [people_dataset(people)])
    return people


def table(rows: Sequence[Row], before: int) -> Iterator[str]:
    """A line for each quantity of each group: errors of those who were not used."""
    yield f"{'':44s}{'people':>7s}{'tables':>10s}{'cohort':>10s}{'ratio':>7s}{'68 %':>6s}{'95 %':>6s}"
    for group in GROUPS:
        own = {(r["number"], r["like"]): r for r in rows if r["group"] == group and "found" in r}
        others = sorted(k for k, like in own if like and k >= before and (k, False) in own)
        for name, unit in QUANTITIES.items() if others else ():
            for when in ("before", "found"):
                if name not in own[others[0], False][when]:
                    continue
                both = [
                    np.concatenate([_errors(own[k, like], when, name) for k in others], 1) for like in (False, True)
                ]
                yield _line(f"{group}, {name} [{unit}], {'before' if when == 'before' else 'with'} forces", both,
                            len(others))  # fmt: skip


def _errors(row: Row, when: str, name: str) -> np.ndarray:
    some = np.array(row[when][name])
    return some if when == "found" else np.stack([some, np.full_like(some, np.nan)])


def _line(name: str, both: Sequence[np.ndarray], people: int) -> str:
    plain, like = (float(np.sqrt((error**2).mean())) for error, _ in both)
    z = np.abs(both[1][0] / both[1][1])
    held = f"{100 * (z < 1).mean():6.0f}{100 * (z < 1.96).mean():6.0f}" if np.isfinite(z).all() else ""
    return f"{name:44s}{people:7d}{plain:10.3g}{like:10.3g}{like / plain:7.2f}{held}"


def main() -> None:
    """Run what is missing, pool, run the others, print the table."""
    asked: Any = Command(
        __doc__,
        seed=(int, "of people and groups (default: drawn)"),
        before=(16, "people of a group who are its prior"),
        after=(8, "others, who are run with it"),
        jobs=2,
        groups=(Among(GROUPS, GROUPS, True, "GROUP"), ", ".join(GROUPS)),
        children=(False, "recorded children, each as one of the others"),
        out=(Path("out/people"), "folder of evidence and rows"),
    ).asked()
    if asked.children:
        print("\n".join(children(asked.jobs, asked.out)))
        return
    seed, kept = said_seed(asked.seed, 10**6), asked.out / "rows.jsonl"
    every = [Case(group, seed, k) for group in asked.groups for k in range(asked.before + asked.after)]
    rows = []
    for row in performed({c.key: c for c in every}, partial(perform, out=asked.out), asked.jobs, kept):
        rows.append(row)
        print(row["key"], row.get("refused", ""), flush=True)
    for group in asked.groups:
        people = people_of(group, seed, asked.before, asked.out)
        print(group, "nobody" if people is None else f"{people.count} people, own share {people.own}")
    later = [Case(g, seed, k, True) for g in asked.groups for k in range(asked.before, asked.before + asked.after)]
    rows += performed({c.key: c for c in later}, partial(perform, out=asked.out), asked.jobs, kept)
    print("\n".join(table(rows, asked.before)))
    print("\n".join(f"{row['key']}: {note}" for row in rows for note in row.get("notes", ()) if "alone" in note))


if __name__ == "__main__":
    main()
