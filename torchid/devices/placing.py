"""Points that a sheet gives by a marker, placed where the geometry has found the marker."""

from collections.abc import Mapping
from dataclasses import replace

from torchid.devices.device import Device, Element, Handle, Path, SegmentPoint
from torchid.devices.values import Triple
from torchid.errors import ConfigError

Places = Mapping[str, tuple[str, Triple]]
"""Label of a marker: its segment, and its place p_BM_B there [m]."""


def placed(device: Device, places: Places) -> Device:
    """Return the device with the points that are markers' where those are on their segments.

    Args:
        device: with points by marker.
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
