"""Faults of a device planted in simulated sessions: which are found, and how often a sound device is called faulty.

    python -m benchmarks.device_faults --subjects 10 --seed 900 --case hip

Subjects, recordings and devices are those of ``benchmarks.devices``, with MuJoCo's truth. Every session is looked at
with a sheet that is right, and with one fault at a time: a spring weaker than its sheet, a strap that slides between
two trials, a part on another segment than the sheet says, a late command. Seeds decide everything.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from harness.command import Among, Command
from harness.pool import alone

from benchmarks.device_cases import CASES, NOISE
from benchmarks.device_subject import Recorded, identified
from torchid.devices import BodyBelief, Device, DeviceOptions, Part, SheetFinding, SheetValue, device_findings, placed
from torchid.devices.device import Element
from torchid.devices.places import neighbours
from torchid.dynamics.rows import WrenchTrial
from torchid.simulate.options import SimulateOptions

Channels = dict[str, dict[str, torch.Tensor]]
FAULTS = {"hip": ("stiffness", "strap_slides", "carried_elsewhere"),
          "back": ("stiffness", "strap_slides", "carried_elsewhere"),
          "ankle": ("command_late", "carried_elsewhere")}  # fmt: skip
"""Kinds of findings that are planted in each case."""


@dataclass(frozen=True)
class Planted:
    """A sheet and channels that contradict each other in one thing."""

    sheet: Device
    channels: Channels
    where: str
    """What the finding's place begins with; empty where nothing was planted."""
    right: str = ""
    """Segment that carries the part in truth."""


@dataclass(frozen=True)
class Told:
    """What findings say of one sheet."""

    planted: str
    found: bool
    others: tuple[str, ...]
    """Further findings that something is wrong; what a sliding strap leaves unexplained is none."""


def main() -> None:
    """Run from the command line."""
    case = Among(CASES, "hip")
    arguments = Command(__doc__, subjects=10, seed=900, case=case, duration=10.0, out=Path("out/device_faults")).asked()
    alone()
    options = SimulateOptions(duration_s=arguments.duration, skin_motion_mm=5.0, force_noise_n=2.0)
    every: list[Told] = []
    for seed in range(arguments.seed, arguments.seed + arguments.subjects):
        own = session(arguments.case, seed, arguments.out, options)
        every += own
        print(seed, *(f"{one.planted or 'sound'}: {'found' if one.found else 'silent'} {list(one.others)}; " for one in
                      own), flush=True)  # fmt: skip
    for kind in ("", *FAULTS[arguments.case]):
        some = [one for one in every if one.planted == kind]
        found, others = sum(one.found for one in some), sum(bool(one.others) for one in some)
        print(f"{arguments.case} {kind or 'sound'}: {found} of {len(some)} found, {others} with another finding")
    print(json.dumps({"case": arguments.case, "told": [vars(one) for one in every]}))


def session(kind: str, seed: int, out: Path, options: SimulateOptions) -> list[Told]:
    """Simulate one session, identify the body, and look at each sheet."""
    recorded, outcome = identified(kind, seed, out, options)
    assert outcome.identified is not None
    rows = [outcome.followed[name].wrench for name in recorded.truth]
    trials, body = [row for row in rows if row is not None], BodyBelief(outcome.phi, outcome.identified.of_rows)
    rng = np.random.default_rng((seed, 36))
    told = []
    for fault in ("", *FAULTS[kind]):
        planted = plant(fault, recorded, placed(sound(recorded), outcome.fit.places), trials, rng)
        told.append(_told(fault, planted, body, trials))
    return told


def _told(fault: str, planted: Planted, body: BodyBelief, trials: list[WrenchTrial]) -> Told:
    options = DeviceOptions(plate_gain_sd=0.0)  # as the simulated plates are
    wrong = [one for one in device_findings(planted.sheet, body, trials, planted.channels, options) if one.wrong]
    mine = [one for one in wrong if one.kind == fault and _names(one, planted)]
    left = ("unexplained",) if fault == "strap_slides" else ()
    others = tuple(f"{one.kind} {one.where}" for one in wrong if one not in mine and one.kind not in left)
    return Told(fault, bool(mine), others)


def _names(finding: SheetFinding, planted: Planted) -> bool:
    """Whether a finding says what was planted; of a part, itself or among what it says explains as much."""
    if planted.right:
        own = finding.where == planted.where and finding.found == planted.right
        return own or f"{planted.where} on {planted.right}" in finding.why
    return finding.where.startswith(planted.where)


def sound(recorded: Recorded) -> Device:
    """The sheet that says what is true: stiffness and gain to 2 %, masses to 20 g, centres to 2 cm."""
    true = recorded.case.true
    parts = tuple(replace(told, mass_kg=SheetValue(own.mass_kg.value, 0.02)) for told, own in
                  zip(recorded.case.sheet.parts, true.parts, strict=True))  # fmt: skip
    elements = []
    for told in recorded.case.sheet.elements:
        numbers = {
            name: SheetValue(x.value, 0.02 * x.value if name in ("stiffness", "gain") else 0.0)
            for name, x in true.element(told.name).numbers()
            if name in ("stiffness", "rest", "gain", "lag")
        }
        elements.append(told.with_numbers(numbers))  # fmt: skip
    return replace(true, parts=parts, elements=tuple(elements))


def plant(
    fault: str, recorded: Recorded, sheet: Device, trials: list[WrenchTrial], rng: np.random.Generator
) -> Planted:  # fmt: skip
    """Make sheet and recordings contradict each other in one thing, drawn by lot."""
    channels = {name: dict(own) for name, own in recorded.channels.items()}
    if not fault:
        return Planted(sheet, channels, "")
    if fault == "carried_elsewhere":
        return Planted(*_moved(sheet, trials, rng, channels))
    element = sheet.elements[int(rng.integers(len(sheet.elements)))]
    if fault == "stiffness":
        stronger = element.law.stiffness.value / rng.uniform(0.6, 0.85)
        weak = element.with_numbers({"stiffness": SheetValue(stronger, 0.02 * stronger)})
        return Planted(_with(sheet, weak), channels, element.name)
    if fault == "command_late":
        early = rng.uniform(0.02, 0.06)
        for name, own in channels.items():
            time = recorded_time(recorded, name)
            own[element.drive.channel] = torch.as_tensor(
                np.interp(time + early, time, own[element.drive.channel].numpy())
            )
        return Planted(sheet, channels, element.name)
    name = list(channels)[int(rng.integers(len(channels)))]
    channels[name][element.sensor.force] = _slid(recorded, element, name, rng)
    return Planted(sheet, channels, element.name)


def _with(sheet: Device, element: Element) -> Device:
    return replace(sheet, elements=tuple(element if one.name == element.name else one for one in sheet.elements))


def recorded_time(recorded: Recorded, name: str) -> np.ndarray:
    """Time of a trial's frames [s]."""
    return next(item for item in recorded.session.trials if item.trial.name == name).truth.motion.time.numpy()


def _slid(recorded: Recorded, element: Element, name: str, rng: np.random.Generator) -> torch.Tensor:
    """What the sensor reads in a trial in which the strap sits elsewhere: 0.05 to 0.15 rad, or 1 to 3 cm."""
    true = recorded.case.true.element(element.name)
    tree, item = recorded.session.subject.model.tree, next(t for t in recorded.session.trials if t.trial.name == name)
    k, rest, way = true.law.stiffness.value, true.law.rest.value, rng.choice([-1.0, 1.0])
    if true.turns:
        q = item.truth.motion.q[:, tree.dof_names.index(true.line.name)].numpy()
        force = -k * (q - rest - way * rng.uniform(0.05, 0.15))
    else:
        length = recorded.truth[name].length[element.name]
        force = np.maximum(0.0, k * (length - rest - way * rng.uniform(0.01, 0.03)))
    return torch.as_tensor(force + NOISE * np.abs(force).max() * rng.normal(size=len(force)))


def _moved(
    sheet: Device, trials: list[WrenchTrial], rng: np.random.Generator, channels: Channels
) -> tuple[Device, Channels, str, str]:  # fmt: skip
    """The heaviest part on a neighbour of the segment that carries it, 10 cm below its origin."""
    k = int(np.argmax([part.mass_kg.value for part in sheet.parts]))
    part: Part = sheet.parts[k]
    near = neighbours(trials[0].tree, part.segment)
    other = near[int(rng.integers(len(near)))]
    wrong = replace(part, segment=other, com_m=(SheetValue(0.0, 0.03), SheetValue(0.0, 0.03), SheetValue(-0.1, 0.03)))
    return replace(sheet, parts=(*sheet.parts[:k], wrong, *sheet.parts[k + 1 :])), channels, part.name, part.segment


if __name__ == "__main__":
    main()
