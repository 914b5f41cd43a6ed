"""The device's sheet against what recordings tell of it: springs, rest lengths, commands, and where parts are carried.

What is looked at is identified anew as if the sheet did not say it, and compared with the sheet in standard deviations.
What recordings cannot tell is a finding too, with the reason. Faults that base rows see without any device are effects
of the catalogue: a load (``payload``), a support (``tether``, ``body_weight_support``), a late clock (``time_offset``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch

from torchid.devices.base_columns import has_line
from torchid.devices.device import Device, Element, SheetValue
from torchid.devices.identify import identify_device
from torchid.devices.measured import MeasuredElement, measured_by
from torchid.devices.options import DeviceOptions
from torchid.devices.places import carried_elsewhere, moved
from torchid.devices.result import BodyBelief, Determined, IdentifiedDevice, NotDeterminable
from torchid.devices.sensor import fit_law
from torchid.devices.supports import Recorded
from torchid.dynamics.rows import WrenchTrial

SURE = 3.0
"""Standard deviations from which on a number of the sheet is called wrong, chosen: 1 in 370 where it is right."""
RELEVANT = {"stiffness": 0.02, "gain": 0.02, "mass_kg": 0.02}
"""Difference relative to the sheet's number below which no fault is named, chosen: sensors are no better calibrated."""
LEAST = {"rest": 0.005, "lag": 0.005, "mass_kg": 0.1}
"""Difference below which none is named [m or rad, s, kg], chosen: a strap's give, half a frame, a cable."""
SLID = 0.03
"""Part of the mean way beyond rest by which rest must differ between trials to matter, chosen: 3 % of the force."""
PULLED, PULLS = 0.1, 0.05
"""Part of the largest reading beyond which an element acts, and part of a trial's frames in which it must for the trial
to tell its rest, chosen: ten times a good sensor's noise; a trial in which it is slack tells a bound alone."""
UNEXPLAINED = 0.1
"""RMS that a law leaves of a measured force, relative to it, from which on something is unexplained, chosen: what a
fault of stiffness or rest of a tenth leaves, ten times the noise of a good sensor."""
Kind = Literal[
    "stiffness", "rest", "command_late", "command_gain", "strap_slides", "mass", "carried_elsewhere", "unexplained"
]
_KINDS: dict[str, Kind] = {
    "stiffness": "stiffness", "rest": "rest", "lag": "command_late", "gain": "command_gain", "mass_kg": "mass"
}  # fmt: skip


@dataclass(frozen=True)
class SheetFinding:
    """One thing of the sheet that was looked at."""

    kind: Kind
    where: str
    """Element or part, with the key of the number where it is one."""
    wrong: bool
    """Whether the sheet is contradicted."""
    sheet: float | str
    found: float | str | None
    """None where it cannot be tested."""
    sd: float = 0.0
    z: float = 0.0
    """How far found is from the sheet, in standard deviations of both; of a place, the log evidence for the other."""
    why: str = ""
    """Why it cannot be tested, or what else it may be."""


def device_findings(
    device: Device,
    body: BodyBelief,
    trials: Sequence[WrenchTrial],
    recorded: Recorded | None = None,
    options: DeviceOptions | None = None,
) -> tuple[SheetFinding, ...]:
    """Compare the sheet with what trials with the device tell.

    Args:
        device: the sheet; its unknown numbers are no findings.
        body: inertia as trials without the device told it.

    Raises:
        DataError, ConfigError: as of ``identify_device``.
    """
    recorded, options = recorded or {}, options or DeviceOptions()
    moves = carried_elsewhere(device, body, trials)
    found = identify_device(opened(moved(device, moves)), body, trials, recorded, options)
    slid = {e.name: _slid(e, found, trials, recorded, options) for e in device.elements}
    apart = {}
    for element in device.elements:
        if any(one.wrong for one in slid[element.name]):
            apart |= _law_by_trial(element, found, _acting(element, found, trials, recorded), options)
    return (
        *_numbers(device, found.parameters | apart),
        *(one for each in slid.values() for one in each),
        *(
            SheetFinding(
                "carried_elsewhere", m.part, m.sure, m.sheet, m.segment, z=m.evidence, why=" or ".join(m.rivals)
            )
            for m in moves
        ),
        *(one for e in found.device.elements for one in _unexplained(e, trials, recorded)),
    )


def opened(device: Device) -> Device:
    """Return the device with masses and what laws and commands are made of unknown; its places stay."""

    def law(element: Element) -> Element:
        own = element.law
        if own is not None and not own.table:
            constant = own.stiffness is not None and own.stiffness.value == 0.0 and own.stiffness.sd == 0.0
            names = ("preload",) if constant else ("stiffness", "rest")
            own = replace(own, **dict.fromkeys(names))
        drive = element.drive and replace(element.drive, gain=None, lag=None)
        return replace(element, law=own, drive=drive)

    parts = tuple(replace(part, mass_kg=None) for part in device.parts)
    return replace(device, parts=parts, elements=tuple(map(law, device.elements)), mass_kg=None)


def _numbers(sheet: Device, parameters: dict[str, Determined | NotDeterminable]) -> list[SheetFinding]:
    stated: dict[str, SheetValue | None] = {f"{part.name}.mass_kg": part.mass_kg for part in sheet.parts}
    stated |= {f"{e.name}.{e.key(name)}": number for e in sheet.elements for name, number in e.numbers()}
    if sheet.mass_kg is not None:
        stated["mass_kg"] = sheet.mass_kg
    findings = []
    for key, one in parameters.items():
        number = stated.get(key)
        if number is None:
            continue
        name = next((n for n in _KINDS if key.rpartition(".")[2].startswith(n)), "stiffness")
        if isinstance(one, NotDeterminable):
            findings.append(SheetFinding(_KINDS[name], key, False, number.value, None, why=one.why))
            continue
        sd = (one.sd**2 + number.sd**2) ** 0.5
        z = (one.value - number.value) / sd
        least = max(RELEVANT.get(name, 0.0) * abs(number.value), LEAST.get(name, 0.0))
        wrong = abs(z) > SURE and abs(one.value - number.value) > least
        findings.append(SheetFinding(_KINDS[name], key, wrong, number.value, one.value, one.sd, z))
    return findings


def _slid(
    element: Element, found: IdentifiedDevice, trials: Sequence[WrenchTrial], recorded: Recorded, options: DeviceOptions
) -> list[SheetFinding]:
    """Rest of one element in each trial: where it differs, what the element holds to has moved."""
    stiffness = found.parameters.get(f"{element.name}.{element.key('stiffness')}")
    measured = _acting(element, found, trials, recorded)
    key = f"{element.name}.{element.key('rest')}"
    if not isinstance(stiffness, Determined) or len(measured) < 2:
        why = "needs a sensor of the element, and that it acts, in two trials or more"
        return [SheetFinding("strap_slides", key, False, "", None, why=why)] if element.law is not None else []
    numbers = {n: v for n, v in found.device.element(element.name).numbers() if v is not None}
    narrow = replace(options, length_scale_sd=0.0, angle_course_sd=0.0, length_sd=0.0, angle_sd=0.0)
    fits = [fit_law([one], ("rest",), numbers, narrow) for one in measured]
    rest = torch.tensor([float(fit.value[0]) for fit in fits], dtype=torch.float64)
    sd = torch.tensor([max(float(fit.sd[0]), 1e-9) for fit in fits], dtype=torch.float64)
    mean = float((rest / sd.square()).sum() / sd.square().reciprocal().sum())
    k = int((rest - mean).abs().argmax())
    beyond = torch.cat([one.length for one in measured]) - mean
    least = SLID * float(beyond.abs().mean())
    z = float((rest[k] - mean) / sd[k])
    moved = float(rest[k] - mean)
    text = "markers knocked in that trial look the same"
    return [SheetFinding("strap_slides", f"{key} in {measured[k].acting.trial.name}",
            abs(z) > SURE and abs(moved) > least,
                    mean, float(rest[k]), float(sd[k]), z, text)]  # fmt: skip


def _acting(
    element: Element, found: IdentifiedDevice, trials: Sequence[WrenchTrial], recorded: Recorded
) -> list[MeasuredElement]:
    """What the sensor of an element read in the trials in which it acts, where its law is told at all."""
    if element.law is None or not has_line(element) or found.device.element(element.name).unknown:
        return []
    measured = measured_by(element, trials, recorded)
    if not measured:
        return []
    least = PULLED * max(float(one.read.abs().max()) for one in measured)
    return [one for one in measured if float((one.read.abs() > least).double().mean()) >= PULLS]


def _law_by_trial(
    element: Element, found: IdentifiedDevice, measured: Sequence[MeasuredElement], options: DeviceOptions
) -> dict[str, Determined | NotDeterminable]:
    """Stiffness of an element whose rest is not the same in all trials: one rest for all would bend it.

    What the trials' fits err by may be common to all, so that their mean is no better known than one of them.
    """
    numbers = {n: v for n, v in found.device.element(element.name).numbers() if v is not None}
    fits = [fit_law([one], ("stiffness", "rest"), numbers, options) for one in measured]
    weight = torch.tensor([1.0 / max(float(fit.sd[0]), 1e-9) ** 2 for fit in fits], dtype=torch.float64)
    value = torch.tensor([float(fit.value[0]) for fit in fits], dtype=torch.float64)
    mean = float((weight * value).sum() / weight.sum())
    rest = NotDeterminable("what it holds to has slid between trials, so that it has no one value")
    return {
        f"{element.name}.{element.key('stiffness')}": Determined(mean, float(weight.mean() ** -0.5)),
        f"{element.name}.{element.key('rest')}": rest,
    }


def _unexplained(element: Element, trials: Sequence[WrenchTrial], recorded: Recorded) -> list[SheetFinding]:
    """What the best law of this kind leaves of what the sensor measured."""
    measured = measured_by(element, trials, recorded) if has_line(element) and not element.unknown else []
    if not measured:
        return []
    left = torch.cat([one.left(one.acting.force({})) for one in measured]).square().mean().sqrt()
    share = float(left / torch.cat([one.read for one in measured]).square().mean().sqrt().clamp_min(1e-12))
    text = "friction, a strap that gives, a law of another shape, or a strap that slid between trials"
    return [SheetFinding("unexplained", element.name, share > UNEXPLAINED, 0.0, share, why=text)]
