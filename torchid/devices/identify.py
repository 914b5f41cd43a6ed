"""What recordings tell of a device: masses by base rows, what acts inside the body by its own sensor."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import Inertial
from torchid.devices.base_columns import INNER, acting, has_line, heard, known_external, seen_share
from torchid.devices.device import Device, Element, Part, SheetValue
from torchid.devices.forces import tells
from torchid.devices.joint_fit import JointFit
from torchid.devices.measured import measured_by
from torchid.devices.options import DeviceOptions
from torchid.devices.parts import PartsPrior, parts_prior
from torchid.devices.result import BodyBelief, Determined, IdentifiedDevice, NotDeterminable
from torchid.devices.sensor import LawFit, fit_law
from torchid.devices.supports import KnownParameters, Recorded, fit_by_base_rows, stated
from torchid.dynamics.rows import WrenchTrial
from torchid.errors import DataError
from torchid.inertia.posterior import com_jacobian
from torchid.model.pseudo import com


def identify_device(
    device: Device,
    body: BodyBelief,
    trials: Sequence[WrenchTrial],
    recorded: Recorded | None = None,
    options: DeviceOptions | None = None,
) -> IdentifiedDevice:
    """Identify the unknown numbers of a device, and improve what is known of the body, from trials with the device.

    Masses and centres of parts, and whatever supports carry to the ground, come from the base rows: the bare body's
    posterior of trials without the device is the prior. Forces between segments leave nothing in the base rows; their
    numbers come from the element's sensor, and without one they are not determinable.

    Args:
        body: inertia as trials without the device told it.
        trials: with the device, followed by the same geometry as those without.
        recorded: channels of the device on each trial's frames, by trial; samples as recorded, unfiltered.
        options: what is assumed; default ``DeviceOptions()``.

    Raises:
        DataError: ``device.no_frames`` where no trial has a run of used frames.
        ConfigError: ``device.segment``, ``device.coordinate`` or ``device.channel``.
    """
    recorded, options = recorded or {}, options or DeviceOptions()
    trials = [heard(trial, known_external(device, trial, recorded.get(trial.name, {}))) for trial in trials]
    trials = [trial for trial in trials if any(True for _ in trial.blocks())]
    if not trials:
        raise DataError(
            "device.no_frames", "no trial with the device has a run of frames with all contact on the plates",
            remedy="Record trials with both feet on plates, or check the plates with `torchid check`",
        )  # fmt: skip
    known = _from_sensors(device, trials, recorded, options)
    filled = _filled(device, known.numbers)
    supports = [e for e in filled.elements if e.unknown and has_line(e) and _seen(e, trials, recorded)]
    prior = parts_prior(replace(filled, mass_kg=None), trials[0].tree, com(body.phi))
    fit, told = fit_by_base_rows(filled, supports, trials, body, prior, recorded, options)
    known = known.joined(told)
    parameters = {**_part_parameters(fit, prior), **_element_parameters(device, known, trials, recorded)}
    device = _with_parts(_filled(device, known.numbers), parameters)
    phi_on, covariance = _worn(fit, prior, len(body.phi))
    bodies = 10 * len(body.phi)
    own = slice(bodies, bodies + fit.parts.numel())
    return IdentifiedDevice(
        device, parameters, BodyBelief(fit.body, fit.covariance[:bodies, :bodies]), fit.parts,
        fit.covariance[own, own], prior.body, phi_on, covariance,
        known.covariance, known.keys, fit.whitening,
    )  # fmt: skip


def free_parameters(element: Element) -> tuple[str, ...]:
    """Return the parameters of an element that its sheet does not say exactly."""
    return tuple(name for name, number in element.numbers() if number is None or number.sd > 0.0)


def _from_sensors(
    device: Device, trials: Sequence[WrenchTrial], recorded: Recorded, options: DeviceOptions
) -> KnownParameters:
    known = KnownParameters({}, {}, {}, {})
    for element in device.elements:
        free = free_parameters(element)
        measured = measured_by(element, trials, recorded) if free and has_line(element) else []
        if measured and not any(tells(one.raw) for one in measured):
            why = {(element.name, name): f"its sensor {element.sensor.force} read zero throughout" for name in free}
            known = known.joined(KnownParameters({}, {}, {}, why))
        elif measured:
            known = known.joined(_of_fit(element, fit_law(measured, free, stated(element), options)))
    return known


def _of_fit(element: Element, fit: LawFit) -> KnownParameters:
    """What a sensor told, joined with what the sheet says where it states a standard deviation."""
    good = [k for k, name in enumerate(fit.names) if name not in fit.alike]
    names = tuple(fit.names[k] for k in good)
    covariance = torch.as_tensor(fit.covariance[good][:, good])
    value = torch.as_tensor(fit.value[good])
    said = stated(element)
    sheet = [said.get(n) for n in names]
    if any(sheet):
        weight = torch.diag(torch.tensor([1.0 / s.sd**2 if s else 0.0 for s in sheet], dtype=torch.float64))
        mean = torch.tensor([s.value if s else 0.0 for s in sheet], dtype=torch.float64)
        precision = torch.linalg.inv(covariance)
        covariance = torch.linalg.inv(precision + weight)
        value = covariance @ (precision @ value + weight @ mean)
    numbers = {
        n: SheetValue(float(v), float(c) ** 0.5) for n, v, c in zip(names, value, covariance.diagonal(), strict=True)
    }
    others = ", ".join(element.key(name) for name in fit.alike)
    why = f"in these recordings {others} act alike, or not at all; a motion over a wider range may tell them apart"
    return KnownParameters({element.name: numbers}, {element.name: covariance}, {element.name: names},
                 {(element.name, name): why for name in fit.alike})  # fmt: skip


def _filled(device: Device, numbers: Mapping[str, dict[str, SheetValue]]) -> Device:
    elements = tuple(one.with_numbers(numbers.get(one.name, {})) for one in device.elements)
    return replace(device, elements=elements)


def _seen(element: Element, trials: Sequence[WrenchTrial], recorded: Recorded) -> bool:
    """Whether base rows hold anything of an element."""
    return any(seen_share(acting(element, t, recorded.get(t.name, {}))) > INNER for t in trials)


def _part_parameters(fit: JointFit, prior: PartsPrior) -> dict[str, Determined | NotDeterminable]:
    found: dict[str, Determined | NotDeterminable] = {}
    first = fit.body.numel()
    covariance = fit.covariance[first : first + fit.parts.numel(), first : first + fit.parts.numel()]
    centre, slope = com(fit.parts), com_jacobian(fit.parts)
    for k, name in enumerate(prior.names):
        block = covariance[10 * k : 10 * k + 10, 10 * k : 10 * k + 10]
        found[f"{name}.mass_kg"] = Determined(float(fit.parts[k, Inertial.M]), float(block[0, 0]) ** 0.5)
        for axis in range(3):
            row = slope[k, axis]
            found[f"{name}.com_{'xyz'[axis]}_m"] = Determined(float(centre[k, axis]), float(row @ block @ row) ** 0.5)
    if prior.names:
        total = covariance[Inertial.M :: 10, Inertial.M :: 10].sum()
        found["mass_kg"] = Determined(float(fit.parts[:, Inertial.M].sum()), float(total) ** 0.5)
    return found


def _element_parameters(
    device: Device, known: KnownParameters, trials: Sequence[WrenchTrial], recorded: Recorded
) -> dict[str, Determined | NotDeterminable]:
    found: dict[str, Determined | NotDeterminable] = {}
    for element in device.elements:
        own = known.numbers.get(element.name, {})
        for name in free_parameters(element):
            key = f"{element.name}.{element.key(name)}"
            if name in own:
                found[key] = Determined(own[name].value, own[name].sd)
            elif (element.name, name) in known.why:
                found[key] = NotDeterminable(known.why[element.name, name])
            elif name in element.unknown:
                found[key] = NotDeterminable(_inside(element, trials, recorded))
    return found


def _inside(element: Element, trials: Sequence[WrenchTrial], recorded: Recorded) -> str:
    """Why base rows say nothing of an element that has no sensor."""
    share = max(seen_share(acting(element, t, recorded.get(t.name, {}))) for t in trials)
    missing = f"its channel {element.sensor.force} was not recorded" if element.sensor.force else "it has no sensor"
    return (
        f"it acts inside the body, where force and counter-force cancel in the base rows (its part there is "
        f"{share:.0e} of what it does to the joints), and {missing}"
    )


def _with_parts(device: Device, parameters: Mapping[str, Determined | NotDeterminable]) -> Device:
    """The device with what was found of its parts."""

    def number(key: str) -> SheetValue:
        found = parameters[key]
        assert isinstance(found, Determined), "masses and centres always have a posterior"
        return SheetValue(found.value, found.sd)

    def filled(part: Part) -> Part:
        x, y, z = (number(f"{part.name}.com_{axis}_m") for axis in "xyz")
        return replace(part, mass_kg=number(f"{part.name}.mass_kg"), com_m=(x, y, z))

    parts = tuple(filled(part) for part in device.parts)
    return replace(device, parts=parts, mass_kg=number("mass_kg") if parts else device.mass_kg)


def _worn(
    fit: JointFit, prior: PartsPrior, bodies: int
) -> tuple[Float[Tensor, "bodies 10"], Float[Tensor, "params params"]]:
    """Body with the parts on it, and its covariance."""
    phi = fit.body.clone()
    for k, body in enumerate(prior.body):
        phi[body] = phi[body] + fit.parts[k]
    n = 10 * (bodies + len(prior.body))
    A = phi.new_zeros(10 * bodies, n)
    A[:, : 10 * bodies] = torch.eye(10 * bodies, dtype=phi.dtype, device=phi.device)
    for k, body in enumerate(prior.body):
        start = 10 * (bodies + k)
        A[10 * body : 10 * body + 10, start : start + 10] = torch.eye(10, dtype=phi.dtype, device=phi.device)
    return phi, A @ fit.covariance[:n, :n] @ A.mT
