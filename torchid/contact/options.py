"""Options of the contact stage."""

from dataclasses import dataclass, field
from typing import Literal

from torchid.conventions import LOADED_N, STANDING_M_S, Count, Name, NonNegative, Positive
from torchid.errors import OptionError


@dataclass(frozen=True)
class SolverOptions:
    """How finely shared contact is solved; lengths and forces are parts of the largest total."""

    tolerance: Positive = 1e-5
    """Residuals at which it ends, as a part of the largest total force."""
    iterations: Count = 4000
    penalty: Positive = 1e3
    """Of the first iterations: between the ridge and the cost of a point force as large as the largest total, which is
    1e4 to 1e5 for a foot whose centre of pressure is known to 15 mm."""
    ridge: Positive = 1e-2
    """Cost of a point force as large as the largest total: spreads pressure where nothing else tells."""
    give: NonNegative = 1e4
    """Cost of leaving the cones by a force as large as the largest total; exact above the largest multiplier."""


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


@dataclass(frozen=True)
class ContactOptions:
    """What counts as standing, and as standing on a plate."""

    height_m: Positive = 0.03
    """A point of the sole touches within this height of the lowest it gets."""
    speed_m_s: Positive = STANDING_M_S
    """A point of the sole touches below this speed."""
    leaving_m_s: Positive = 1.2
    """Once down it touches until it rises or is faster than this: when their plate unloads, the toes of a walk do
    1.0-1.3 m/s. At the speed of standing a contact would end 50 ms, and some 300 N, too early."""
    loaded_n: Positive = LOADED_N
    """A plate is loaded above this vertical force."""
    margin_m: NonNegative = 0.03
    """A foot may stand over the edge of a plate by this much."""
    reach_m: Positive = 0.10
    """A centre of pressure belongs to a foot within this distance of its sole's axis."""
    shortest_s: NonNegative = 0.06
    """Shorter absences of a plate's reading are the plate's threshold, not a missing plate."""
    missing_share: Positive = 0.1
    """Frames that miss this share of the weight for about ``shortest_s`` have a contact that no plate measures, where
    standing has told the weight: the balance of 959 measured frames of six children scatters by 0.05."""
    friction: Positive = 1.0
    """Coefficient of friction between soles and plates, a bound: dry shoes slip at 0.6 to 1.2 (Chang et al., Ergonomics
    44(13), 2001)."""
    torques: Literal["measured", "shared", "predicted"] = "shared"
    """Contacts whose limbs get torques: those that plates bear alone, those that share a plate too, or also those
    beside plates, which bear what the identified body needs more than plates bear."""
    others: dict[Name, OtherContact] = field(default_factory=dict)
    """Contacts other than feet, by name."""
