"""Options of the contact stage."""

from dataclasses import dataclass, field
from typing import Literal

from torchid.bounds import Name, NonNegative, Positive
from torchid.contact.other_options import OtherContact
from torchid.conventions import LOADED_N


@dataclass(frozen=True)
class ContactOptions:
    """What counts as standing, and as standing on a plate."""

    height_m: Positive = 0.03
    """A point of the sole touches within this height of the lowest it gets."""
    speed_m_s: Positive = 0.4
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
