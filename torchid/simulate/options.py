"""What a synthetic session holds and how badly it is measured."""

from dataclasses import dataclass, field
from typing import Literal

from torchid.conventions import Name, Positive
from torchid.effects.place import Interval
from torchid.errors import OptionError

ANALOG_RATIO = 10
"""Samples of the plates per frame of the markers."""


@dataclass(frozen=True)
class PlantedOptions:
    """An effect to hide in the session: names and parameters as in ``diagnosis.json``."""

    effect: Name
    """Name of an effect of the catalogue (`torchid/effects/`)."""
    where: tuple[Name, ...] = ("session",)
    """Segments, joints, marker labels, plates, trials, or `session`."""
    when: tuple[Interval, ...] | None = None
    """Intervals in which it acts; absent: always."""
    parameters: dict[str, float | list] = field(default_factory=dict)
    """Its size, by the parameters' names."""
    follows: Name | None = None
    """Coordinate whose angle a marker or joint effect follows, or the same in another order (see ``Angle``)."""
    markers: tuple[Name, ...] = ()
    """Those that ``soft_tissue`` moves, in the order of its parameters."""


@dataclass(frozen=True)
class SimulateOptions:
    """A synthetic session; the defaults make seven short trials."""

    fit: tuple[Name, ...] = ("squats", "hip_rom", "arms", "trunk")
    """Motions of the fit trials; one named twice is drawn twice."""
    heldout: tuple[Name, ...] = ("sway_steps", "walk")
    """Motions of the held-out trials. A ``static`` trial of 3 s is always there."""
    conditions: tuple[Name, ...] = ()
    """Motions of trials that ``torchid evaluate`` records under each of the config's conditions."""
    duration_s: float = 10.0
    """Length of every trial but the static one."""
    rate_hz: float = 100.0
    """Frames per second; plates sample ten times as often."""
    plates: int = 4
    """1 to 4: left and right of the origin, then left and right in front of them."""
    marker_noise_mm: float = 1.0
    """Standard deviation of white noise on every coordinate of every marker."""
    force_noise_n: float = 2.0
    """Standard deviation of white noise on each force of each plate, once the samples are averaged to the frame rate
    (a single sample has sqrt(10) times as much); moments about the plate's centre get 0.2 m times that."""
    skin_motion_mm: float = 0.0
    """Shift of a thigh marker where a neighbouring joint has turned by one radian; other segments in proportion."""
    gap_fraction: float = 0.0
    """Share of marker samples lost in bursts."""
    mass_kg: Positive | None = None
    """The person's mass; absent: drawn."""
    height_m: Positive | None = None
    """The person's height; absent: drawn."""
    sex: Literal["male", "female"] | None = None
    """Absent: drawn."""
    scatter: float = 1.0
    """How far geometry, markers and inertia are drawn from their priors' means, in prior standard deviations."""

    effects: tuple[PlantedOptions, ...] = ()
    """Hidden in every trial that they concern; the truth stands in ``truth/subject.json``."""

    def __post_init__(self) -> None:
        checks = (
            ("plates", 1 <= self.plates <= 4, "1 to 4"),
            ("duration_s", 2.0 <= self.duration_s <= 600.0, "2 to 600 s"),
            ("rate_hz", 50.0 <= self.rate_hz <= 1000.0, "50 to 1000 Hz: the motions reach 5 Hz"),
            ("gap_fraction", 0.0 <= self.gap_fraction <= 0.8, "0 to 0.8"),
            ("marker_noise_mm", self.marker_noise_mm >= 0.0, "zero or more"),
            ("force_noise_n", self.force_noise_n >= 0.0, "zero or more"),
            ("skin_motion_mm", self.skin_motion_mm >= 0.0, "zero or more"),
            ("scatter", 0.0 <= self.scatter <= 1.5, "0 to 1.5: beyond, legs would not fit the floor"),
        )
        for key, good, remedy in checks:
            if not good:
                raise OptionError(
                    f"simulate.{key}", "cannot be simulated", place=key, found=str(getattr(self, key)),
                    remedy=f"Give {remedy}",
                )  # fmt: skip
