"""The finite list of what may be wrong with the forces of a recording, each as the config line that mends it."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Literal, TypeVar

from torchid.checks.finding import Cure, InstrumentFault
from torchid.io.mend import CHANNELS, ForcesAs, PlateAs, in_config, in_words, number_of
from torchid.recording import Plate

QUARTERS = (90, 180, 270)
FLIPPED = ((2, 1, 4, 3), (4, 3, 2, 1), (1, 4, 3, 2), (3, 2, 1, 4))
"""Orders of the corners whose outline runs the other way round; those that run the same way are turns."""

CROSSED = tuple(itertools.permutations((1, 2, 3, 4)))[1:]
"""Every other order of four corners."""

Up = Literal["y", "z"]
FAULTS = {
    "up": InstrumentFault.AXES,
    "turn_deg": InstrumentFault.TURN,
    "corners": InstrumentFault.TURN,
    "corner_unit": InstrumentFault.UNIT,
    "mirror": InstrumentFault.WIRING,
    "exchange": InstrumentFault.WIRING,
    "reads": InstrumentFault.EXCHANGE,
    "shift_m": InstrumentFault.PLACE,
    "origin_shift_m": InstrumentFault.PLACE,
    "lag_ms": InstrumentFault.CLOCK,
    "gain": InstrumentFault.GAIN,
    "moment_gain": InstrumentFault.UNIT,
}
"""What each key of a line says is wrong."""


@dataclass(frozen=True)
class Change:
    """One thing that may be wrong, and how to read the recording if it is."""

    what: str
    """What is wrong then, as the end of a sentence."""
    forces_as: ForcesAs = ForcesAs()
    plates: Mapping[int, PlateAs] = field(default_factory=dict)
    up: Up | None = None
    """Vertical axis of the markers, where it is not as read."""
    size: float | None = None
    """How large the fault is, where it was found and not picked."""
    sd: float | None = None
    """Standard deviation of that."""
    unit: str = ""
    """Of both."""

    @property
    def said(self) -> Mapping[str, object]:
        """Keys and values of the line, without the plates that they are about."""
        entries = (self.forces_as, *(self.plates[n] for n in sorted(self.plates)))
        own = {f.name: getattr(e, f.name) for e in entries for f in fields(e) if getattr(e, f.name) != f.default}
        return ({"up": self.up} if self.up else {}) | own

    @property
    def hypothesis(self) -> str:
        """The line as keys and values, such as ``turn_deg=180``."""
        return ", ".join(f"{key}={in_config(value)}" for key, value in self.said.items())

    @property
    def fault(self) -> InstrumentFault:
        """What is wrong where the line mends."""
        return next((FAULTS[key] for key in self.said if key in FAULTS), InstrumentFault.DISAGREEMENT)

    def as_cure(self, whole: bool) -> Cure:
        """The line as a cure; ``whole`` as of ``written``."""
        return Cure(self.what, self.written(whole), self.hypothesis, tuple(sorted(self.plates)))

    @property
    def shrinks_moments(self) -> bool:
        """Whether moments become smaller by it, as of N mm."""
        return self.forces_as.moment_gain < 1 or any(plate.moment_gain < 1 for plate in self.plates.values())

    def __and__(self, other: "Change") -> "Change":
        """Both changes; what the other says of the same plate or of the whole file adds to it key by key."""
        plates = dict(self.plates)
        for number, change in other.plates.items():
            plates[number] = _added(plates.get(number, PlateAs()), change)
        what = " and ".join(filter(None, (self.what, other.what)))
        forces_as, up = _added(self.forces_as, other.forces_as), other.up or self.up
        both = replace(other, what=what, forces_as=forces_as, plates=plates, up=up)
        return replace(both, size=None, sd=None, unit="") if self.what else both

    @property
    def line(self) -> str:
        """What to add to the trial in a config."""
        return self.written(whole=False)

    def written(self, whole: bool) -> str:
        """The line; ``whole`` writes both keys, so that nothing of the config's own is left in force."""
        parts = [f"up: {self.up}"] if self.up else []
        if whole or self.forces_as != ForcesAs():
            parts.append(f"forces_as: {in_words(self.forces_as)}")
        if whole or self.plates:
            parts.append(f"plates: {{{', '.join(f'{n}: {in_words(p)}' for n, p in sorted(self.plates.items()))}}}")
        return ", ".join(parts)


Entry = TypeVar("Entry", ForcesAs, PlateAs)


def _added(one: Entry, other: Entry) -> Entry:
    """One entry with what the other changes: lags and shifts add up, gains multiply, all else is replaced."""
    different = {f.name: getattr(other, f.name) for f in fields(other) if getattr(other, f.name) != f.default}
    for key, value in different.items():
        before = getattr(one, key)
        if key in ("shift_m", "origin_shift_m"):
            different[key] = tuple(round(a + b, 3) for a, b in zip(before, value, strict=True))
        elif key == "lag_ms":
            different[key] = before + value
        elif key in ("gain", "moment_gain"):
            different[key] = before * value
    return replace(one, **different)


FIXED = ("turn_deg", "corners", "corner_unit", "mirror", "exchange", "reads")
"""Keys that say how a plate stands or is wired, which is the same in all trials of a session."""
APART_M = 0.2
"""Derived. Places of one plate that differ by more along an axis are two: three standard deviations of the difference
of two that are known to some 45 mm each."""


def contradict(one: Change, other: Change, number: int) -> bool:
    """Whether two changes say of a plate what cannot both be.

    Args:
        one: a change.
        other: another.
        number: of the plate.
    """
    a, b = one.plates.get(number, PlateAs()), other.plates.get(number, PlateAs())
    if any(getattr(a, key) != getattr(b, key) for key in FIXED):
        return True
    pairs = zip((*a.shift_m, *a.origin_shift_m), (*b.shift_m, *b.origin_shift_m), strict=True)
    return any(abs(x - y) > APART_M for x, y in pairs)


def plate_changes(plates: tuple[Plate, ...], k: int) -> list[Change]:
    """What may be wrong with plate k alone."""
    n = number_of(plates[k], k)
    one = [
        ("has its forces reversed (they push the subject down)", PlateAs(gain=-1.0)),
        ("has its moments in N mm", PlateAs(moment_gain=1e-3)),
        ("has its moments too small by 1000", PlateAs(moment_gain=1e3)),
    ]
    if plates[k].corners is not None:
        one += [(f"is turned by {angle} degrees", PlateAs(turn_deg=angle)) for angle in QUARTERS]
        one += [("has its corners in another order", PlateAs(corners=order)) for order in FLIPPED]
        one += [(f"is left-handed (its {axis} axis reversed)", PlateAs(mirror=axis)) for axis in ("x", "y")]
        one += [
            (f"has its channels {a} and {b} exchanged", PlateAs(exchange=(a, b)))
            for a, b in itertools.combinations(CHANNELS, 2)
        ]
    return [Change(f"{plates[k].name} {what}", plates={n: change}) for what, change in one]


def corner_changes(number: int) -> list[Change]:
    """What may be wrong with the corners of a plate that reading refuses for them."""
    units = [(f"its corners are in {unit}", PlateAs(corner_unit=unit)) for unit in ("m", "mm", "cm", "in")]
    orders = [("its corners are in another order", PlateAs(corners=order)) for order in CROSSED]
    return [Change(what, plates={number: change}) for what, change in (*units, *orders)]


def pair_changes(plates: tuple[Plate, ...]) -> list[Change]:
    """Which two plates may be exchanged."""
    numbers = [number_of(p, k) for k, p in enumerate(plates) if p.corners is not None]
    return [
        Change(f"plates {a} and {b} are exchanged", plates={a: PlateAs(reads=b), b: PlateAs(reads=a)})
        for a, b in itertools.combinations(numbers, 2)
    ]


def file_changes(own_axes: bool) -> list[Change]:
    """What may be wrong with all forces of a file; ``own_axes``: its axes may be others than those of the markers."""
    found = [
        Change("all forces are reversed (they push the subject down)", ForcesAs(gain=-1.0)),
        Change("all moments are in N mm", ForcesAs(moment_gain=1e-3)),
        Change("all moments are too small by 1000", ForcesAs(moment_gain=1e3)),
    ]
    if not own_axes:
        return found
    found += [
        Change(f"the forces' axes are turned by {angle} degrees about the vertical", ForcesAs(turn_deg=angle))
        for angle in QUARTERS
    ]
    found += [
        Change("the forces' axes are left-handed", ForcesAs(mirror="x", turn_deg=angle)) for angle in (0, *QUARTERS)
    ]
    return found
