"""Simulated subjects with a device: identified from recordings alone, and compared with MuJoCo's truth.

    python -m benchmarks.devices --subjects 10 --seed 350 --case hip

The body comes from the trials without the device, the device from those with it. Prints a row for each subject and the
figures over all; ``--blind`` takes the sensors away.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from harness.command import Among, Command
from harness.pool import alone
from harness.rows import figures

from benchmarks.device_cases import CASES
from benchmarks.device_subject import Recorded, identified
from torchid.devices import (
    BodyBelief,
    Determined,
    DeviceOptions,
    NotDeterminable,
    device_forces,
    identify_device,
    placed,
)
from torchid.session import Outcome
from torchid.session.following import torques
from torchid.simulate.options import SimulateOptions


@dataclass(frozen=True)
class Row:
    """Figures of one subject."""

    seed: int
    figures: dict[str, float]
    covered: dict[str, bool]
    z: dict[str, float]


def main() -> None:
    """Run from the command line."""
    asked = Command(
        __doc__, subjects=10, seed=350, case=Among(CASES, "hip"), duration=10.0, out=Path("out/devices"),
        skin=(5.0, "skin motion at the thigh [mm per radian]"),
        blind=(False, "without sensors: only that nothing is claimed"),
    ).asked()  # fmt: skip
    alone()
    options, rows = SimulateOptions(duration_s=asked.duration, skin_motion_mm=asked.skin, force_noise_n=2.0), []
    for seed in range(asked.seed, asked.seed + asked.subjects):
        rows.append(subject(asked.case, seed, asked.out, options, asked.blind))
        print(seed, figures(rows[-1].figures), {k: round(v, 2) for k, v in rows[-1].z.items()}, flush=True)
    _print_summary(asked.case, rows)


def _print_summary(case: str, rows: list[Row]) -> None:
    for key in rows[0].figures:
        values = np.array([row.figures[key] for row in rows])
        print(f"{case} {key}: median {np.median(values):.3g}, largest {np.max(values):.3g}")
    inside = [ok for row in rows for ok in row.covered.values()]
    if inside:
        print(f"{case} 95 % intervals cover {100.0 * np.mean(inside):.1f} % of {len(inside)}")
    print(json.dumps({"case": case, "rows": [row.figures for row in rows]}))


def subject(kind: str, seed: int, out: Path, options: SimulateOptions, blind: bool) -> Row:
    """One subject: simulate, run, identify the device, compare."""
    recorded, outcome = identified(kind, seed, out, options)
    assert outcome.identified is not None
    sheet = placed(recorded.case.sheet, outcome.fit.places)
    trials = [outcome.followed[name].wrench for name in recorded.truth]
    found = identify_device(
        sheet, BodyBelief(outcome.phi, outcome.identified.of_rows), [t for t in trials if t is not None],
        {} if blind else recorded.channels, DeviceOptions(plate_gain_sd=0.0),  # as the simulated plates are
    )  # fmt: skip
    figures, covered, z = parameter_errors(recorded, found)
    if not blind:
        figures |= torque_errors(recorded, outcome, found)
    return Row(seed, figures, covered, z)


def parameter_errors(recorded: Recorded, found) -> tuple[dict[str, float], dict[str, bool], dict[str, float]]:
    """Errors of parameters, whether their 95 % intervals cover the truth, and the errors in standard deviations."""
    true = {}
    for part in recorded.case.true.parts:
        true[f"{part.name}.mass_kg"] = part.mass_kg.value
    true["mass_kg"] = sum(true.values())
    for element in recorded.case.true.elements:
        true |= {f"{element.name}.{element.key(n)}": x.value for n, x in element.numbers() if n in
                 ("stiffness", "rest", "gain", "lag")}  # fmt: skip
    errors, covered, z = {"mass_kg": abs(found.parameters["mass_kg"].value - true["mass_kg"])}, {}, {}
    worst: dict[str, float] = {}
    claims = 0
    for key, value in true.items():
        one = found.parameters[key] if key in found.parameters else None
        if isinstance(one, NotDeterminable):
            claims += 1
        if not isinstance(one, Determined):
            continue
        z[key] = (one.value - value) / one.sd
        covered[key] = abs(z[key]) <= 1.96
        name = key.rpartition(".")[2]
        if "." in key and not name.startswith("mass"):
            size = 1.0 if name.endswith(("rad", "_s")) and not name.startswith("stiffness") else abs(value)
            worst[name] = max(worst.get(name, 0.0), abs(one.value - value) / size)
    return {**errors, **worst, "not_determinable": float(claims)}, covered, z


def torque_errors(recorded: Recorded, outcome: Outcome, found) -> dict[str, float]:
    """Assistance, and human torques with the identified body and with the scaled template, against MuJoCo."""
    tree, session = outcome.fit.model.tree, outcome.session
    template = outcome.prior_scaled.mean + (found.phi_on - found.body.phi)
    parts: dict[str, list] = {key: [] for key in ("device", "true", "human", "template", "force", "pull")}
    for name, truth in recorded.truth.items():
        followed, scaled, trial = outcome.followed[name], outcome.followed_scaled[name], session.trials[name]
        channels = recorded.channels[name]
        forces = device_forces(found.device, tree, outcome.fit.geometry, followed.motion, channels)
        mine, used = forces.torque, followed.contact.used
        scaled_device = device_forces(found.device, tree, outcome.scaled.geometry, scaled.motion, channels).torque
        human = torques(followed, tree, outcome.fit.geometry, found.phi_on, trial) - mine
        other = torques(scaled, tree, outcome.scaled.geometry, template, trial) - scaled_device
        # What a filter takes away is no body's error: the truth goes through the same one.
        device, want = (followed.motion.smoother(torch.as_tensor(x)) for x in (truth.device, truth.human))
        good = (torch.isfinite(human) & torch.isfinite(other)).double()
        good[:, :6] = 0.0
        good[~used] = 0.0
        for key, force in truth.force.items():
            want_force = followed.motion.smoother(torch.as_tensor(force))[used]
            parts["force"].append(forces.elements[key].force[used] - want_force)
            parts["pull"].append(want_force)
        parts["device"].append((mine - device)[used, 6:])
        parts["true"].append(device[used, 6:])
        parts["human"].append(torch.nan_to_num(human - want) * good)
        parts["template"].append(torch.nan_to_num(other - want) * good)
    norm = {key: float(torch.cat(values).norm()) for key, values in parts.items()}
    kept = [k for k, dof in enumerate(tree.dof_names) if "ankle" not in dof or "flexion" in dof]
    mine, other = (float(torch.cat(parts[key])[:, kept].norm()) for key in ("human", "template"))
    return {
        "assistance_pct": 100.0 * norm["device"] / norm["true"],
        "element_force_pct": 100.0 * norm["force"] / norm["pull"],
        "torque_ratio": norm["human"] / norm["template"],
        "torque_ratio_without_subtalar": mine / other,
    }


if __name__ == "__main__":
    main()
