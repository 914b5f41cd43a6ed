"""What Qualisys Track Manager (QTM) says of its cameras and plates, and what the numbers that it sends are in W.

The description of the real-time protocol (github.com/qualisys/Real-Time-Protocol-Documentation) leaves open in which
axes forces are. Qualisys' own client says it (github.com/qualisys/QTM-Connect-For-Unity, ``RTStreamThread.cs``): force,
moment and point of application are in axes of the plate, whose origin is the mean of the four corners, with X towards
corners 1 and 4, Y towards 1 and 2 and Z down, as in C3D files. What is sent is the load **on the plate**: the client
turns it round where it draws a person's reaction (``RTForcePlate.cs``), and QTM's manual calls it "the actual force on
the force-plate", in N, N m and mm (docs.qualisys.com, "Force data information"). On the subject is its opposite.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import lxml.etree as etree
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import SAMPLE_LOADED_N
from torchid.errors import InputError
from torchid.io.frame import to_world
from torchid.io.plate_axes import from_plate
from torchid.io.plate_setup import PlateProblem, plate_frame
from torchid.recording import Plate

MM = 1e-3
"""Cited. Unit of markers and points of application [m]: QTM's manual, "Force data information"."""
LENGTH = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Units in which corners may be stated, in m."""
UP = {"+z": "z", "+y": "y"}
"""Vertical axes of QTM that can be turned into W, by the name that files have for them."""
ARM_M = 0.05
"""Choice. How far a moment may lie from that of the force at its point of application, as a length: the origin of a
plate's sensors, 4 cm below its surface, makes less of it in anything a foot does; moments about another point more."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Settings:
    """What one run of QTM states of itself, and how its numbers are read."""

    source: str
    """The server, for errors."""
    labels: tuple[str, ...]
    """Names of the markers, in the order of every frame."""
    rate_hz: float
    """Frames per second."""
    up: str
    """Vertical axis, as ``to_world`` names it."""
    plates: tuple[Plate, ...]
    """With their corners in W."""
    ids: tuple[int, ...]
    """Numbers by which data name the plates."""
    force_rate_hz: float
    """Samples of every plate per second."""

    def positions(self, markers: Sequence[Sequence[float]]) -> Float[Tensor, "markers 3"]:
        """Return the markers of a frame in W [m]; NaN where one is missing, also where it is at exactly (0, 0, 0).

        Args:
            markers: as they came [mm], in the order of ``labels``.

        Raises:
            InputError: ``live.qualisys`` where they are more or less than the labels.
        """
        if len(markers) != len(self.labels):
            raise fault(self.source, "sends other markers than it has labels", f"{len(markers)}, {len(self.labels)}",
                        "Look whether trajectories were added or renamed in QTM while it streams")  # fmt: skip
        position = torch.tensor([tuple(marker)[:3] for marker in markers], dtype=torch.float64) * MM
        position[(position == 0.0).all(dim=-1)] = torch.nan
        return to_world(position, self.up)

    def wrench(self, plate: int, samples: Float[Tensor, "samples 9"]) -> Float[Tensor, "samples 6"]:
        """Return wrenches on the subject about the origin of W [N, N m].

        At the point of application there is no horizontal moment; where QTM states one, the moment about the plate's
        centre is that of the force there, whatever point QTM takes moments about. Where the load is too small for one
        (QTM then sends zeros), the moment is taken as it is sent.

        Args:
            plate: its place in ``plates``.
            samples: force, moment and point of application, as they came [N, N m, mm].
        """
        force, moment, point = samples[:, :3], samples[:, 3:6].clone(), samples[:, 6:] * MM
        stated = _stated(point)
        moment[stated, :2] = torch.linalg.cross(point, force)[stated, :2]
        return from_plate(-torch.cat([force, moment], dim=1), self.plates[plate])

    def doubt(self, plate: int, samples: Float[Tensor, "samples 9"]) -> str:
        """Return what makes it doubtful that samples are what they are taken for, empty where nothing does.

        Args:
            plate: its place in ``plates``.
            samples: as in ``wrench``.
        """
        loaded = samples[samples[:, 2].abs() > SAMPLE_LOADED_N]
        force, moment, point = loaded[:, :3], loaded[:, 3:6], loaded[:, 6:] * MM
        if bool((force[:, 2] < 0.0).any()):
            return (f"{self.plates[plate].name} is pulled upwards: its corners are in another order than QTM's, or "
                    "forces are not sent in axes of the plate")  # fmt: skip
        off = (torch.linalg.cross(point, force) - moment)[:, :2].norm(dim=1) / force[:, 2]
        if bool((off > ARM_M)[_stated(point)].any()):
            return (f"{self.plates[plate].name} has moments that are not those of its force about its centre: the "
                    "vertical ones are likely to be wrong")  # fmt: skip
        return ""

    def fitting(self, first: "Settings") -> "Settings":
        """Return these settings with the plates in the order of others, if a stream that began so can go on with them.

        Raises:
            InputError: ``live.qualisys`` where rates differ, none of the labels is left, or plates are not the same.
        """
        remedy = "Start torchid live anew, or QTM as it was"
        now, then = (self.rate_hz, self.force_rate_hz), (first.rate_hz, first.force_rate_hz)
        if now != then:
            raise fault(self.source, "has another rate", f"{now[0]:g} and {now[1]:g} Hz, was {then[0]:g} and "
                        f"{then[1]:g} Hz", remedy)  # fmt: skip
        places = {plate.name: k for k, plate in enumerate(self.plates)}
        moved = [one.name for one in first.plates if not _same(one, self.plates[places.get(one.name, 0)])]
        if moved or len(places) != len(first.plates):
            raise fault(self.source, "has other plates, or in other places", ", ".join(moved or places), remedy)
        lacking = [label for label in first.labels if label not in self.labels]
        if len(lacking) == len(first.labels):
            raise fault(self.source, "has none of the labels it had", ", ".join(self.labels[:6]), remedy)
        if lacking:
            log.warning("%s came back without %s", self.source, ", ".join(lacking))
        ids = tuple(self.ids[places[plate.name]] for plate in first.plates)
        return replace(self, plates=first.plates, ids=ids)


def read_settings(xml: bytes, source: str) -> Settings:
    """Return what QTM states in answer to ``GetParameters General 3D Force``.

    Raises:
        InputError: ``live.qualisys`` where something is missing without which nothing can be identified.
    """
    try:
        root = etree.fromstring(xml, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        raise fault(source, "has parameters that are no XML", str(error)[:80], "Look what listens there") from error
    names = [_text(one, "Name").split(":")[-1].strip() for one in root.iterfind("The_3D/Label")]
    entries = root.findall("Force/Plate")
    if not names or "" in names or len(set(names)) < len(names):
        raise fault(source, "has no labels, or one twice", ", ".join(names) or "none",
                    "Apply an AIM model in QTM, or give every trajectory a name of its own")  # fmt: skip
    if not entries:
        raise fault(source, "sends no force plates", "none", "Add the plates in QTM, and let it calculate forces")
    upwards = _text(root, "The_3D/AxisUpwards").lower()
    if upwards not in UP:
        raise fault(source, "has another vertical axis", upwards or "none", "Calibrate QTM with Z or Y upwards")
    plates, rates = _plates(root, entries, UP[upwards], source), {_number(one, "Frequency", source) for one in entries}
    rate_hz, force_rate_hz = _number(root, "General/Frequency", source), min(rates)
    if len(rates) > 1 or rate_hz <= 0.0 or force_rate_hz <= 0.0:
        raise fault(source, "has no rate, or plates with several", f"{rate_hz:g} Hz, plates at {sorted(rates)} Hz",
                    "Let QTM sample all plates at one rate")  # fmt: skip
    ids = tuple(int(_number(one, "Plate_ID", source)) for one in entries)
    return Settings(source, tuple(names), rate_hz, UP[upwards], plates, ids, force_rate_hz)


def _plates(root: etree._Element, entries: list[etree._Element], up: str, source: str) -> tuple[Plate, ...]:
    names, unit = [_text(one, "Name") for one in entries], _text(root, "Force/Unit_Length")
    if "" in names or len(set(names)) < len(names):
        raise fault(source, "has a plate without a name of its own", ", ".join(names), "Name each plate in QTM")
    if unit not in LENGTH or _text(root, "Force/Unit_Force") != "N":
        raise fault(source, "has unknown units", f"{unit or 'none'}, {_text(root, 'Force/Unit_Force') or 'none'}",
                    "Let QTM state forces in N and corners in mm")  # fmt: skip
    plates = []
    for k, entry in enumerate(entries):
        places = [[_number(entry, f"Location/Corner{n}/{axis}", source) for axis in "XYZ"] for n in (1, 2, 3, 4)]
        corners = to_world(LENGTH[unit] * torch.tensor(places, dtype=torch.float64), up)
        try:
            plate_frame(corners.numpy())
        except PlateProblem as error:
            raise fault(source, "has a plate that is no rectangle", f"{names[k]}: {error}",
                        "Measure its corners in QTM (Force plate, Location)") from error  # fmt: skip
        plates.append(Plate(names[k], corners, number=k + 1))
    return tuple(plates)


def _stated(point: Float[Tensor, "samples 3"]) -> Tensor:
    return point.isfinite().all(dim=1) & (point != 0.0).any(dim=1)


def _same(one: Plate, other: Plate) -> bool:
    assert one.corners is not None and other.corners is not None
    return one.name == other.name and torch.equal(one.corners, other.corners)


def _text(of: etree._Element, path: str) -> str:
    return (of.findtext(path) or "").strip()


def _number(of: etree._Element, path: str, source: str) -> float:
    try:
        return float(_text(of, path))
    except ValueError as error:
        raise fault(source, "has no number where one belongs", f"{path} {_text(of, path)[:40]}",
                    "Complete the settings in QTM (Project options)") from error  # fmt: skip


def fault(source: str, message: str, found: str, remedy: str) -> InputError:
    """Return the error of a server."""
    return InputError("live.qualisys", message, source=source, found=found[:200], remedy=remedy)
