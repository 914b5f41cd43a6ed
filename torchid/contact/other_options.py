"""What a user says of a contact that is no foot: a hand on a rail, a seat, a back support."""

from dataclasses import dataclass
from typing import Literal

from torchid.bounds import Name, Positive
from torchid.errors import OptionError

Point = tuple[float, float, float]
Intervals = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class NearPlace:
    """A place in the laboratory at which a contact bears."""

    at_m: Point
    """In W [m]."""
    within_m: Positive = 0.05
    """Chosen: the contact bears while the middle of its points is as near as this to the place [m]; where a seat's
    patch rests differs by some centimetres from one sitting to the next."""


@dataclass(frozen=True)
class OtherContact:
    """A contact of a segment with something else than the floor."""

    segment: Name
    """Body that is touched."""
    when: Literal["loaded", "always"] | NearPlace | dict[Name, Intervals] = "loaded"
    """When it bears: while its plate is loaded, in all frames, while it is near a place, or within intervals of some
    trials [s]; in trials that are not listed it does not bear, with none listed in none."""
    points: tuple[Name | Point, ...] = ()
    """Where it is touched: markers of the segment, or points in the segment's axes [m]; none: those that are usual for
    the segment (``other_places``)."""
    push: Literal["up", "forward", "free"] | Point | None = None
    """Direction in W in which the support pushes, or that of the segment's forward axis, on average over the frames in
    which it bears; free is a grip, which pulls as well. None: what is usual for the segment."""
    friction: Positive = 1.0
    """Coefficient of friction, a bound, as that of soles."""
    plate: int | None = None
    """Number of the plate, or of the instrumented handle or seat, that measures it."""

    def __post_init__(self) -> None:
        if self.when == "loaded" and self.plate is None:
            raise OptionError(
                "contact.when", "without a plate, when this contact bears is not defined", place="when",
                found="no plate",
                remedy="Give when: always, {TRIAL: [[t0, t1], ...]} or {at_m: [x, y, z]}, or its plate",
            )  # fmt: skip
        for trial, parts in (self.when if isinstance(self.when, dict) else {}).items():
            for t0, t1 in parts:
                if not t0 < t1:
                    raise OptionError(
                        "contact.interval", "an interval ends after it begins", place=f"when.{trial}",
                        found=f"{t0} to {t1} s", remedy="Give [t0, t1] with t0 < t1 in the trial's time",
                    )  # fmt: skip
        if isinstance(self.push, tuple) and not any(self.push):
            raise OptionError(
                "contact.push", "a direction has a length", place="push", found=str(list(self.push)),
                remedy="Give up, forward, free, or a direction in W such as [0.9, 0, 0.4]",
            )  # fmt: skip
