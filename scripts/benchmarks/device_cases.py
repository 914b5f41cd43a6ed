"""Simulated devices: hip springs, back springs with slack, ankle torque profiles; the truth, and the sheet that tells
nothing but where things are."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from torchid.devices import Device, Element, Part, SheetValue
from torchid.devices.device import Coordinate, Drive, Law, Path, SegmentPoint, Sensor

CASES = ("hip", "back", "ankle")
OFF = ("squats", "hip_rom", "arms", "trunk")
ON = {
    "hip": ("squats", "hip_rom", "sway_steps"),
    "back": ("squats", "trunk"),
    "ankle": ("squats", "sway_steps", "walk"),
}
"""Motions without and with the device."""
MARKED = {"back_l": ("RBAK", "LPSI", "LTHI"), "back_r": ("RBAK", "RPSI", "RTHI")}
"""Markers that sit on a back spring's upper end, where it bends over the pelvis, and on its lower end."""
GYRATION = 0.08
"""Radius of gyration of a part [m]."""
NOISE = 0.01
"""Of a sensor, part of the largest reading."""


@dataclass(frozen=True)
class Case:
    """A device as it is, and as its sheet says it."""

    true: Device
    sheet: Device
    motors: dict[str, str]
    """Coordinate of each motor, and the name of its element."""


def draw_case(
    kind: str,
    rng: np.random.Generator,
    places: dict[str, tuple[str, tuple[float, float, float]]],
    standing: dict[str, np.ndarray],
) -> Case:
    """A device of a kind; by the markers' true places, and those in W in the neutral pose, slack is drawn (3,) [m]."""
    on = {"hip": ("pelvis", "thigh_l", "thigh_r"), "back": ("thorax", "pelvis"),
          "ankle": ("shank_l", "shank_r", "foot_l", "foot_r")}[kind]  # fmt: skip
    parts, sheet = _parts(on, rng.uniform(2.0, 6.0), rng)
    elements = {"hip": _hip, "back": lambda r: _back(r, places, standing), "ankle": _ankle}[kind](rng)
    told = tuple(_unknown(e, places) for e in elements)
    motors = {e.line.name: e.name for e in elements if e.drive is not None}
    return Case(Device(kind, parts, elements), Device(kind, sheet, told), motors)


def _parts(on: tuple[str, ...], mass: float, rng: np.random.Generator) -> tuple[tuple[Part, ...], tuple[Part, ...]]:
    """Parts that weigh ``mass`` together; their masses are unknown to the sheet, their centres known to 2 cm."""
    centre = {"pelvis": (-0.08, 0.0, 0.08), "thorax": (-0.10, 0.0, 0.15), "thigh": (0.0, 0.07, -0.20),
              "shank": (0.0, 0.05, -0.20), "foot": (0.04, 0.03, -0.03)}  # fmt: skip
    share = rng.dirichlet(np.full(len(on), 6.0))
    true, told = [], []
    for segment, part in zip(on, share, strict=True):
        x, y, z = centre[segment.removesuffix("_l").removesuffix("_r")]
        stated = np.array([x, -y if segment.endswith("_r") else y, z])
        at, m = stated + 0.02 * rng.normal(size=3), float(mass * part)
        moment = SheetValue(2.0 * m * GYRATION**2 / 2.0)
        zero = SheetValue(0.0)
        a, b, c = (SheetValue(float(v)) for v in at)
        true.append(Part(segment, segment, SheetValue(m), (a, b, c), (moment, zero, moment, zero, zero, moment)))
        a, b, c = (SheetValue(float(v), 0.02) for v in stated)
        told.append(Part(segment, segment, None, (a, b, c)))
    return tuple(true), tuple(told)


def _hip(rng: np.random.Generator) -> tuple[Element, ...]:
    k, rest = rng.uniform(50.0, 300.0), rng.uniform(-0.1, 0.2)
    return tuple(
        Element(f"hip_{s}", "spring", ("pelvis", f"thigh_{s}"), Coordinate(f"hip_{s}_flexion"),
                Law(SheetValue(float(k * rng.uniform(0.9, 1.1))), SheetValue(float(rest))),
                sensor=Sensor(f"hip_{s}_torque"))
        for s in "lr"
    )  # fmt: skip


def _back(rng: np.random.Generator, places: dict, standing: dict) -> tuple[Element, ...]:
    found = []
    for name, labels in MARKED.items():
        run = tuple(SegmentPoint(places[label][0], places[label][1]) for label in labels)
        straight = sum(float(np.linalg.norm(standing[a] - standing[b])) for a, b in pairwise(labels))
        rest = straight * rng.uniform(0.99, 1.05)
        law = Law(SheetValue(float(rng.uniform(400.0, 1000.0))), SheetValue(float(rest)), tension_only=True)
        found.append(Element(name, "cable", (run[0].segment, run[-1].segment), Path(run), law,
                             sensor=Sensor(f"{name}_force")))  # fmt: skip
    return tuple(found)


def _ankle(rng: np.random.Generator) -> tuple[Element, ...]:
    gain, lag = rng.uniform(0.8, 1.2), rng.uniform(0.01, 0.06)
    return tuple(
        Element(f"ankle_{s}", "torque", (f"shank_{s}", f"foot_{s}"), Coordinate(f"ankle_{s}_flexion"),
                drive=Drive(f"ankle_{s}_command", gain=SheetValue(float(gain)), lag=SheetValue(float(lag))),
                sensor=Sensor(f"ankle_{s}_torque"))
        for s in "lr"
    )  # fmt: skip


def _unknown(element: Element, places: dict) -> Element:
    """The element with everything hidden that is to be found; ends by their markers."""
    law = element.law and replace(element.law, stiffness=None, rest=None)
    drive = element.drive and replace(element.drive, gain=None, lag=None)
    line = element.line
    if isinstance(line, Path):
        labels = MARKED[element.name]
        line = Path(tuple(SegmentPoint(p.segment, None, label) for p, label in zip(line.points, labels, strict=True)))
    return replace(element, law=law, drive=drive, line=line)


def command(rng: np.random.Generator, time: np.ndarray, peak: float = 20.0) -> np.ndarray:
    """Plantar-flexing torque of a controller: half sines about once a second [N m]."""
    out, t = np.zeros_like(time), float(time[0]) + rng.uniform(0.0, 1.0)
    while t < time[-1]:
        width, height = rng.uniform(0.3, 0.6), peak * rng.uniform(0.6, 1.0)
        inside = (time > t) & (time < t + width)
        out[inside] = -height * np.sin(np.pi * (time[inside] - t) / width) ** 2
        t += width + rng.uniform(0.3, 0.9)
    return out
