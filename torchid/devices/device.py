"""An assistive device as numbers: rigid parts on segments, and elements that act between segments or from the ground.

Signs: an element over a path carries a tension, positive where it pulls its ends together; an element about a
coordinate or an axis carries a torque, positive in the sense of the coordinate (of the turn of the second segment
against the first).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from torchid.errors import ConfigError


@dataclass(frozen=True)
class SheetValue:
    """A number of a sheet and how well it is known."""

    value: float
    sd: float = 0.0
    """Standard deviation in the same unit; zero where the sheet states none."""

    def __format__(self, spec: str) -> str:
        """Write the number, and its standard deviation where there is one."""
        return f"{self.value:{spec}}" + (f" +- {self.sd:{spec}}" if self.sd else "")


Number = SheetValue | None
"""A number, or None for one that is to be identified."""
Triple = tuple[float, float, float]
"""Coordinates of a point or a direction in the axes that its field names."""


WORLD = "world"
"""Name of the ground among the segments of an element."""
Kind = Literal["spring", "damper", "cable", "torque", "force", "ground"]
Over = Literal["time", "phase", "angle"]


@dataclass(frozen=True)
class Part:
    """A rigid part that moves with a segment, in the segment's axes from its origin."""

    name: str
    segment: str
    mass_kg: Number
    com_m: tuple[SheetValue, SheetValue, SheetValue] | None = None
    """Centre of mass; None where the sheet does not say."""
    inertia_kgm2: tuple[SheetValue, SheetValue, SheetValue, SheetValue, SheetValue, SheetValue] | None = None
    """Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the part's centre of mass; None where the sheet does not say."""


@dataclass(frozen=True)
class Coordinate:
    """An element acts on one coordinate of the human model."""

    name: str


@dataclass(frozen=True)
class Axis:
    """An element acts about an axis fixed in the first segment; its angle is the second one's twist about it."""

    direction: Triple
    """Unit vector in the first segment's axes."""


@dataclass(frozen=True)
class SegmentPoint:
    """A point of a segment, or of W where the segment is ``world`` [m]."""

    segment: str
    place: Triple | None
    """None where it is that of a marker, until ``placed`` has told it."""
    marker: str = ""


@dataclass(frozen=True)
class Path:
    """An element runs over points; those between the ends are frictionless pulleys of no size."""

    points: tuple[SegmentPoint, ...]
    rail: Triple | None = None
    """Unit vector in W along which an anchor in W follows the body without resistance."""


@dataclass(frozen=True)
class Law:
    """Force of length and rate: k e + preload + c rate, e being the way beyond rest and free play.

    A law that carries tension alone is max(0, k e + preload + c rate), and zero where k e + preload is not positive.
    """

    stiffness: Number = SheetValue(0.0)
    rest: Number = SheetValue(0.0)
    preload: Number = SheetValue(0.0)
    free_play: Number = SheetValue(0.0)
    damping: Number = SheetValue(0.0)
    tension_only: bool = False
    table: tuple[tuple[float, float], ...] = ()
    """Way beyond rest and free play, and force, in rising order; replaces k e."""


@dataclass(frozen=True)
class Drive:
    """Force or torque that a motor or a file says: gain times profile, late by ``lag``."""

    channel: str = ""
    """Recorded channel of the device; empty for a profile in numbers."""
    over: Over = "time"
    profile: tuple[tuple[float, float], ...] = ()
    """Abscissa (time [s], phase 0 to 1, or the element's own angle or length) and force, in rising order."""
    gain: Number = SheetValue(1.0)
    lag: Number = SheetValue(0.0)


@dataclass(frozen=True)
class Sensor:
    """Channels by which the device itself measures an element; empty where it does not."""

    force: str = ""
    """Tension [N], or torque in the sense of the coordinate [N m]."""
    length: str = ""
    """Length [m] or angle [rad]; its zero may lie anywhere."""
    force_sd: float | None = None
    """Standard deviation of a sample of ``force``; None: from its scatter at frequencies where nobody moves."""


@dataclass(frozen=True)
class Handle:
    """A support whose force on a point of a segment is recorded in W, as a walker's handle."""

    point: SegmentPoint
    channels: tuple[str, str, str]


Line = Coordinate | Axis | Path | Handle
UNITS = {
    "stiffness": ("N_m", "Nm_rad"), "rest": ("m", "rad"), "preload": ("N", "Nm"), "free_play": ("m", "rad"),
    "damping": ("Ns_m", "Nms_rad"), "gain": ("", ""), "lag": ("s", "s"),
}  # fmt: skip
"""Unit of each parameter of an element over a path, and about an axis, as its key is spelt."""
LAW = ("stiffness", "rest", "preload", "free_play", "damping")
DRIVE = ("gain", "lag")


@dataclass(frozen=True)
class Element:
    """Something that pulls, turns or holds between two segments, or between one and the ground."""

    name: str
    kind: Kind
    between: tuple[str, str]
    line: Line
    law: Law | None = None
    drive: Drive | None = None
    sensor: Sensor = Sensor()

    @property
    def turns(self) -> bool:
        """Return whether it carries a torque rather than a tension."""
        return isinstance(self.line, Coordinate | Axis)

    @property
    def grounded(self) -> bool:
        """Return whether one of its ends is in W, so that plates do not see what it carries."""
        if isinstance(self.line, Path):
            return any(point.segment == WORLD for point in self.line.points)
        return isinstance(self.line, Handle)

    def key(self, parameter: str) -> str:
        """Return the key of a parameter with its unit, as in ``stiffness_Nm_rad``."""
        unit = UNITS[parameter][int(self.turns)]
        return f"{parameter}_{unit}" if unit else parameter

    def numbers(self) -> Iterator[tuple[str, Number]]:
        """Yield the parameters of law and drive by name."""
        for owner, names in ((self.law, LAW), (self.drive, DRIVE)):
            if owner is not None:
                yield from ((name, getattr(owner, name)) for name in names)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Return the names of the parameters that the sheet does not say."""
        return tuple(name for name, number in self.numbers() if number is None)

    def with_numbers(self, numbers: dict[str, SheetValue]) -> "Element":
        """Return the element with some of its parameters replaced.

        Args:
            numbers: by name, as in ``numbers``.
        """
        law = self.law and replace(self.law, **{k: v for k, v in numbers.items() if k in LAW})
        drive = self.drive and replace(self.drive, **{k: v for k, v in numbers.items() if k in DRIVE})
        return replace(self, law=law, drive=drive)


@dataclass(frozen=True)
class Device:
    """A device as its sheet says it, unknown numbers included."""

    name: str
    parts: tuple[Part, ...] = ()
    elements: tuple[Element, ...] = ()
    sources: tuple[str, ...] = ()
    mass_kg: Number = None
    """Mass of all parts together where the sheet says it; None where it follows from the parts or is unknown."""

    @property
    def unknown(self) -> tuple[str, ...]:
        """Return the keys of all numbers that are to be identified, as in ``hip_l.stiffness_Nm_rad``."""
        parts = [f"{p.name}.mass_kg" for p in self.parts if p.mass_kg is None]
        parts += [f"{p.name}.com_m" for p in self.parts if p.com_m is None]
        return (*parts, *(f"{e.name}.{e.key(name)}" for e in self.elements for name in e.unknown))

    def element(self, name: str) -> Element:
        """Return the element called ``name``, which exists."""
        return next(one for one in self.elements if one.name == name)


Places = Mapping[str, tuple[str, Triple]]
"""Label of a marker: its segment, and its place p_BM_B there [m]."""


def placed(device: Device, places: Places) -> Device:
    """Return the device with the points that are markers' where those are on their segments.

    Args:
        places: of the markers, as the geometric fit found them.

    Raises:
        ConfigError: ``device.marker`` where one is unknown or rides on another segment than the sheet says.
    """

    def settled(point: SegmentPoint, element: str) -> SegmentPoint:
        if not point.marker:
            return point
        segment, place = places.get(point.marker, ("", None))
        if place is None or segment != point.segment:
            raise ConfigError(
                "device.marker", "no such marker on this segment", place=element,
                found=f"{point.marker} on {segment or 'no segment'}, {point.segment} in the sheet",
                remedy="Name a marker of the recordings, and the segment that it rides on",
            )  # fmt: skip
        return replace(point, place=place)

    def moved(element: Element) -> Element:
        line = element.line
        if isinstance(line, Path):
            return replace(element, line=replace(line, points=tuple(settled(p, element.name) for p in line.points)))
        if isinstance(line, Handle):
            return replace(element, line=replace(line, point=settled(line.point, element.name)))
        return element

    return replace(device, elements=tuple(moved(element) for element in device.elements))
