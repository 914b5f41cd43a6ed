"""What the description of a stream says: which channel is which part of what, in which unit, and how often it comes.

Descriptions follow the meta-data conventions of XDF (github.com/sccn/xdf/wiki). Lab Streaming Layer hands them over as
XML and ``pyxdf`` as nested lists, which are the same; both are read here, and both kinds of streams.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import lxml.etree as etree
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.errors import InputError
from torchid.io.frame import to_world
from torchid.recording import Plate

MOCAP, FORCE_PLATE = "MoCap", "ForcePlate"
"""Types of the streams, compared without case: some bridges write ``Mocap``."""
LENGTH = {"m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "mm": 1e-3, "millimeters": 1e-3,
          "millimetres": 1e-3}  # fmt: skip
FORCE = {"n": 1.0, "newton": 1.0, "newtons": 1.0}
MOMENT = {"nm": 1.0, "newtonmeters": 1.0, "newtonmetres": 1.0, "nmm": 1e-3}
"""Units by their letters alone, in small ones, each in SI."""
POSITION = {f"Position{axis}": LENGTH for axis in "XYZ"}
WRENCH = {f"Force{axis}": FORCE for axis in "XYZ"} | {f"Moment{axis}": MOMENT for axis in "XYZ"}
LISTED = 6
"""Choice. Names that an error lists."""

Tree = Mapping[str, Any]
"""Children by name, each a list of trees or texts, as ``pyxdf`` has them."""


@dataclass(frozen=True)
class ChannelLayout:
    """Where the parts of markers or plates are among the channels of a stream, and what its times mean."""

    names: tuple[str, ...]
    """Markers or plates."""
    columns: Int[Tensor, "items parts"]
    """Channel of each part; -1 where the stream has none."""
    scale: Float[Tensor, "items parts"]
    """Unit of each part in SI."""
    rate_hz: float
    """Nominal samples per second, zero where the sender states none."""
    late_s: float = 0.0
    """How late the time stamps are, to be subtracted from them: ``synchronization/offset_mean`` [s]."""
    compensated_s: float = 0.0
    """What the sender has subtracted already, ``acquisition/compensated_lag`` [s]: nothing is left to be done."""
    up: str = "z"
    """Vertical axis of the stream."""
    corners: Mapping[str, Tensor] = field(default_factory=dict)
    """Corners (4, 3) of plates in W [m], of those that have some."""

    def read(self, values: Float[Tensor, "samples channels"]) -> Float[Tensor, "samples items parts"]:
        """Return samples in W and SI units, NaN where a part has no channel or a marker is at exactly (0, 0, 0)."""
        lacking = values.new_full((len(values), 1), torch.nan)
        found = torch.cat([values, lacking], dim=1)[:, self.columns] * self.scale
        if self.columns.shape[1] == len(POSITION):
            found[(found == 0.0).all(dim=-1)] = torch.nan  # where senders put a marker that they do not see
        return to_world(found, self.up)

    def having(self, names: tuple[str, ...]) -> "ChannelLayout":
        """Return the layout of some markers or plates, in their order; the channels of unknown ones are -1."""
        columns = self.columns.new_full((len(names), self.columns.shape[1]), -1)
        scale = self.scale.new_ones(columns.shape)
        for k, name in enumerate(names):
            if name in self.names:
                columns[k], scale[k] = self.columns[self.names.index(name)], self.scale[self.names.index(name)]
        return replace(self, names=names, columns=columns, scale=scale)

    @property
    def plates(self) -> tuple[Plate, ...]:
        """Plates by these names, counted from one."""
        return tuple(Plate(name, self.corners.get(name), number=k + 1) for k, name in enumerate(self.names))


def tree(xml: str) -> Tree:
    """Return the description that is in an XML text.

    Args:
        xml: whole text, as ``pylsl`` gives it.

    Raises:
        InputError: ``live.lsl`` where it is no XML.
    """
    try:
        root = etree.fromstring(xml.encode(), etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        raise fault("LSL stream", "has a description that is no XML", str(error)[:80], "Mend the sender") from error
    found = _tree(root)
    return found if isinstance(found, Mapping) else {}


def _tree(element: Any) -> Tree | str:
    children: dict[str, list[Tree | str]] = {}
    for child in element:
        children.setdefault(str(child.tag), []).append(_tree(child))
    return children or (element.text or "")


def marker_layout(info: Tree, source: str) -> ChannelLayout:
    """Return where the markers are.

    Args:
        info: description of a stream of type ``MoCap``.

    Raises:
        InputError: ``live.lsl`` where it does not tell all that is needed.
    """
    return _layout(info, source, "marker", POSITION)


def plate_layout(info: Tree, source: str) -> ChannelLayout:
    """Return where the plates' wrenches are, and the plates' corners.

    Args:
        info: description of a stream of type ``ForcePlate``.

    Raises:
        InputError: ``live.lsl`` where it does not tell all that is needed.
    """
    found = _layout(info, source, "plate", WRENCH)
    entries = _all(_first(_first(info, "desc"), "plates"), "plate")
    corners = {text(entry, "id"): _corners(entry, source) for entry in entries if "corners" in entry}
    return replace(found, corners={name: to_world(one, found.up) for name, one in corners.items()})


def channel_labels(info: Tree, count: int) -> tuple[str, ...]:
    """Return the labels of a stream's channels; those without one are called by the stream's name and their number."""
    channels = _all(_first(_first(info, "desc"), "channels"), "channel")
    labels = [text(one, "label").strip() for one in channels][:count]
    labels += [""] * (count - len(labels))
    return tuple(label or f"{text(info, 'name')}_{k + 1}" for k, label in enumerate(labels))


def _layout(info: Tree, source: str, owner: str, parts: Mapping[str, Mapping[str, float]]) -> ChannelLayout:
    description = _first(info, "desc")
    if text(info, "channel_format") == "string":
        raise fault(source, "holds texts", "channel_format string", "Send float32 or double64")
    places = _places(info, source, owner, parts)
    up = text(_first(description, "setup"), "up").lower() or "z"
    if up not in ("y", "z"):
        raise fault(source, "has an unknown vertical axis", f"setup/up {up[:20]}", "Write y or z")
    return ChannelLayout(
        tuple(places),
        torch.tensor([[place[part][0] for part in parts] for place in places.values()]),
        torch.tensor([[place[part][1] for part in parts] for place in places.values()], dtype=torch.float64),
        _number(info, "nominal_srate", source),
        _number(_first(description, "synchronization"), "offset_mean", source),
        _number(_first(description, "acquisition"), "compensated_lag", source),
        up,
    )


def _places(
    info: Tree, source: str, owner: str, parts: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, tuple[int, float]]]:
    """Channel and unit of every part of everything that channels are of; other channels are passed over."""
    channels = _all(_first(_first(info, "desc"), "channels"), "channel")
    if text(info, "channel_count") != str(len(channels)):
        told = f"{len(channels)} described of {text(info, 'channel_count')}"
        raise fault(source, "does not describe its channels", told, f"Give each a label, {owner}, type and unit")
    places: dict[str, dict[str, tuple[int, float]]] = {}
    for k, channel in enumerate(channels):
        kind, name = text(channel, "type"), text(channel, owner).split(":")[-1].strip()
        if kind in parts and name:
            if kind in places.setdefault(name, {}):
                raise fault(source, f"has a {owner} twice", f"{name} {kind}", "Stream one subject, under unique names")
            places[name][kind] = (k, _unit(channel, parts[kind], source))
    if not places:
        types = ", ".join(dict.fromkeys(text(one, "type") or "no type" for one in channels))
        raise fault(source, f"has no channel of a {owner}", types, f"Give channels a {owner} and types {_list(parts)}")
    lacking = [f"{name} {part}" for name, place in places.items() for part in parts if part not in place]
    if lacking:
        raise fault(source, "lacks channels", _list(lacking), f"Send {_list(parts)} of every {owner}")
    return places


def _unit(channel: Tree, known: Mapping[str, float], source: str) -> float:
    stated = text(channel, "unit")
    letters = re.sub(r"[^a-z]", "", stated.lower())
    if letters not in known:
        label = text(channel, "label") or text(channel, "type")
        raise fault(source, "has an unknown unit", f"{stated or 'none'} of channel {label}", f"Use {_list(known, 20)}")
    return known[letters]


def _corners(entry: Tree, source: str) -> Float[Tensor, "4 3"]:
    corners = _all(_first(entry, "corners"), "corner")
    if len(corners) != 4:
        raise fault(source, "has a plate without four corners", f"{len(corners)} of plate {text(entry, 'id')}",
                    "Give four, or none")  # fmt: skip
    scale = _unit(entry, LENGTH, source) if text(entry, "unit") else 1.0
    places = [[scale * _number(corner, axis, source) for axis in "XYZ"] for corner in corners]
    return torch.tensor(places, dtype=torch.float64)


def rate_of(layout: ChannelLayout, time: Float[Tensor, " samples"], source: str) -> float:
    """Return the rate that a stream states, or else that of its times, which lost samples and jitter make uneven [Hz].

    Args:
        time: of some samples, rising [s].

    Raises:
        InputError: ``live.lsl`` where it states none and sends too little.
    """
    if layout.rate_hz > 0.0:
        return layout.rate_hz
    rate_hz = float(round((len(time) - 1) / float(time[-1] - time[0]))) if len(time) > 1 and time[-1] > time[0] else 0.0
    if rate_hz < 1.0:
        remedy = "Let it state its rate, or start it before torchid live"
        raise fault(source, "states no rate, and sends too little to tell it", f"{len(time)} samples", remedy)
    return rate_hz


def _number(of: Tree, name: str, source: str) -> float:
    """Value of a number, zero where it is absent."""
    stated = text(of, name)
    try:
        return float(stated or "0")
    except ValueError as error:
        raise fault(source, "has no number where one belongs", f"{name} {stated[:40]}", "Write it in SI") from error


def text(of: Tree, name: str) -> str:
    """Return a text, empty where there is none."""
    found = of.get(name)
    return found[0].strip() if found and isinstance(found[0], str) else ""


def _first(of: Tree, name: str) -> Tree:
    found = _all(of, name)
    return found[0] if found else {}


def _all(of: Tree, name: str) -> Sequence[Tree]:
    return [child for child in of.get(name) or () if isinstance(child, Mapping)]


def _list(names: Any, most: int = LISTED) -> str:
    told = list(names)
    return ", ".join(told[:most]) + (f" and {len(told) - most} more" if len(told) > most else "")


def fault(source: str, message: str, found: str, remedy: str) -> InputError:
    """Return the error of a stream."""
    return InputError("live.lsl", message, source=source, found=found[:200], remedy=remedy)
