"""Tables of the real recordings: what was identified beside the template, the prior, AddBiomechanics and the truth.

What OpenSim leaves on the same frames is measured by ``opensim_residuals.py``.
"""

import json
import math
import xml.etree.ElementTree as ElementTree  # noqa: S405 - a file of the shared recordings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from harness.command import DATA, ROOT, Command
from harness.pool import alone
from harness.rows import write_json

from torchid.config import load_config
from torchid.errors import DataError
from torchid.run import run_experiment
from torchid.run.sequence import contributions
from torchid.session import Outcome

TRUTH_GROUPS = {
    "torso": ("torso",), "pelvis": ("pelvis",), "thigh": ("femur",), "shank": ("tibia", "patella"),
    "foot": ("talus", "calcn", "toes"), "upper_arm": ("humerus",), "forearm": ("ulna", "radius"), "hand": ("hand",),
}  # fmt: skip
OWN_GROUPS = {"torso": ("abdomen", "thorax", "head")}

Table = dict[str, Any]


def opencap(outcome: Outcome) -> dict[str, Table]:
    """Markers, residuals step by step, used frames and masses of the adult with walks and squats."""
    reference = _reference("opencap_subject4")
    return {
        "opencap_markers": _marker_table(outcome, reference),
        "opencap_residuals": _residual_table(outcome, reference),
        "opencap_frames": _frame_table(outcome),
        "opencap_masses": _mass_table(outcome),
    }


def hamner(outcome: Outcome) -> dict[str, Table]:
    """Running: residuals beside those of a program that alters the motion to fit."""
    reference = _reference("hamner2013_subject04")
    return {
        "hamner_residuals": _residual_table(outcome, reference),
        "hamner_markers": _marker_table(outcome, reference, roles=("fit", "heldout")),
        "hamner_masses": _mass_table(outcome),
    }


def arnold(outcome: Outcome) -> dict[str, Table]:
    """Masses against the exact ones of the synthetic subject, which nothing before this function has read."""
    truth = _truth(DATA / "arnold2013_synthetic_truth" / "subject01" / "subject01.osim")
    found, prior = _grouped(outcome, outcome.phi[:, 0].tolist()), _grouped(outcome, outcome.prior.mean[:, 0].tolist())
    rows = [
        [name, value, prior[name], found[name], 100 * (prior[name] / value - 1), 100 * (found[name] / value - 1)]
        for name, value in truth.items()
    ]
    total = [sum(group.values()) for group in (truth, prior, found)]
    rows.append(["total", *total, 100 * (total[1] / total[0] - 1), 100 * (total[2] / total[0] - 1)])
    return {
        "arnold_masses": _table(
            ["segment", "truth kg", "prior kg", "found kg", "prior error %", "found error %"], rows
        ),
        "arnold_error": _table(
            ["", "prior", "found"],
            [["RMS of segment masses, kg", *(_rms(g[n] - truth[n] for n in truth) for g in (prior, found))]],
        ),
    }


def anyone(outcome: Outcome) -> dict[str, Table]:
    """A line for a recording without a reference."""
    name = outcome.config.subject.name
    return {f"{name}_residuals": _residual_table(outcome, {}), f"{name}_masses": _mass_table(outcome)}


TABLES: dict[str, Callable[[Outcome], dict[str, Table]]] = {
    "opencap_subject4": opencap,
    "hamner2013_subject04": hamner,
    "arnold2013_synthetic_truth": arnold,
}


def _marker_table(outcome: Outcome, reference: dict, roles: Sequence[str] = ("heldout",)) -> Table:
    rows = []
    for name, trial in outcome.session.trials.items():
        if trial.role in roles:
            own = [1e3 * f[name].tracked.rmse for f in (outcome.followed, outcome.followed_scaled)]
            other = reference.get(name, {}).get("marker_rmse_cm", math.nan)
            rows.append([name, trial.role, *own, 10.0 * other])
    both = [row for row in rows if math.isfinite(row[4])]
    rows.append(["mean", "", *(_mean(row[k] for row in rows) for k in (2, 3)), math.nan])
    if both:
        rows.append(["mean of trials in both", "", *(_mean(row[k] for row in both) for k in (2, 3, 4))])
    return _table(["trial", "role", "identified mm", "scaled mm", "AddBiomechanics mm"], rows)


def _residual_table(outcome: Outcome, reference: dict) -> Table:
    """Base residual of each trial, from the hardly filtered scaled template to the identified model."""
    rows, labels = [], []
    for name, trial in outcome.session.trials.items():
        alone = replace(outcome.session, trials={name: replace(trial, role="heldout")})
        steps = () if trial.role == "static" else contributions(replace(outcome, session=alone))
        if not steps:  # without plates, or not in the inertia
            continue
        other = reference.get(name, {})
        cells = [f"{step.force_rmse_N:.1f} / {step.moment_rmse_Nm:.1f}" for step in steps]
        given = f"{other['res_force_N']:.1f} / {other['res_torque_Nm']:.1f}" if other else ""
        rows.append([name, trial.role, *cells, given])
        labels = [f"{step.label}, {step.cutoff_hz:.3g} Hz" for step in steps]
    return _table(["N / N m", "role", *labels, "AddBiomechanics (motion altered)"], rows)


def _frame_table(outcome: Outcome) -> Table:
    """Frames with every touching foot on a plate, and those of them that were used."""
    rows, sums = [], [0, 0, 0]
    for name, item in outcome.followed.items():
        if item.contact is None or outcome.session.trials[name].role == "static":
            continue
        counts = [len(item.contact.used), int(item.contact.measured.sum()), int(item.contact.used.sum())]
        sums = [a + b for a, b in zip(sums, counts, strict=True)]
        rows.append([name, *counts, 100 * counts[2] / max(1, counts[1])])
    rows.append(["all", *sums, 100 * sums[2] / max(1, sums[1])])
    return _table(["trial", "frames", "all contact on plates", "used", "share %"], rows)


def _mass_table(outcome: Outcome) -> Table:
    assert outcome.identified is not None
    fit = outcome.identified.fit
    rows = []
    for k, name in enumerate(fit.names):
        mean, sd = float(fit.prior.mean[k, 0]), float(fit.prior.covariance[10 * k, 10 * k].sqrt())
        mass = float(fit.mass[k])
        progress = float(fit.progress.phi[k, 0]), float(fit.progress.segment[k])
        rows.append([name, mass, mean, sd, (mass - mean) / sd, *progress])
    rows.append(["total", float(fit.mass.sum()), float(fit.prior.mean[:, 0].sum()), *[math.nan] * 4])
    return _table(["segment", "kg", "prior kg", "sd", "z", "progress of mass", "of segment"], rows)


def _grouped(outcome: Outcome, mass: list[float]) -> dict[str, float]:
    names = outcome.fit.model.tree.names
    found = dict.fromkeys(("torso", "pelvis"), 0.0)
    for name, value in zip(names, mass, strict=True):
        group = next((g for g, members in OWN_GROUPS.items() if name in members), name)
        found[group] = found.get(group, 0.0) + value
    return found


def _truth(file: Path) -> dict[str, float]:
    """Masses of the OpenSim model, grouped into our segments [kg]."""
    found: dict[str, float] = {}
    for body in ElementTree.parse(file).getroot().iter("Body"):  # noqa: S314
        name, _, side = body.get("name", "").partition("_")
        group = next(g for g, members in TRUTH_GROUPS.items() if name in members)
        group = f"{group}_{side}" if side else group
        found[group] = found.get(group, 0.0) + float(body.findtext("mass", "nan"))
    return found


def _reference(folder: str) -> dict:
    file = DATA / folder / "reference_addbiomechanics.json"
    return json.loads(file.read_text())["addbiomechanics"]["trials"] if file.exists() else {}


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    return {"head": list(head), "rows": [list(row) for row in rows]}


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return sum(found) / len(found) if found else math.nan


def _rms(values: Iterable[float]) -> float:
    return math.sqrt(_mean(value**2 for value in values))


def markdown(name: str, table: Table) -> str:
    """A table as text."""
    lines = [table["head"], ["---"] * len(table["head"]), *table["rows"]]
    return f"\n### {name}\n\n" + "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.2f}" if math.isfinite(value) else ""
    return str(value)


def main() -> None:
    """Run, print, write ``out/tables.json``."""
    alone()
    found: dict[str, Table] = {}
    for name in Command(__doc__, ("configs",), configs={"nargs": "*", "default": list(TABLES)}).asked().configs:
        try:
            outcome = run_experiment(load_config(ROOT / "configs" / f"{name}.yaml", ["diagnosis.enabled=false"]))
        except DataError as refusal:
            found[name] = _table(["refused"], [[str(refusal)]])
        else:
            found |= TABLES.get(name, anyone)(outcome)
    for name, table in found.items():
        print(markdown(name, table))
    write_json(ROOT / "out" / "tables.json", json.loads(json.dumps(found), parse_constant=lambda _: None))


if __name__ == "__main__":
    main()
