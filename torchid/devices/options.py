"""What identifying a device assumes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from torchid.conventions import NonNegative, Positive
from torchid.devices.device import SheetValue

UNKNOWN: Mapping[str, SheetValue] = MappingProxyType(
    {
        "stiffness": SheetValue(1000.0, 3000.0), "preload": SheetValue(0.0, 300.0), "free_play": SheetValue(0.0, 0.05),
        "damping": SheetValue(0.0, 100.0), "gain": SheetValue(1.0, 1.0), "lag": SheetValue(0.0, 0.1),
        "rest": SheetValue(0.0, 0.3),
    }
)  # fmt: skip
"""Prior of an unknown parameter of a grounded support [SI]; that of ``rest`` is about the mean length. Chosen so wide
that a person's weight lies within."""


@dataclass(frozen=True)
class DeviceOptions:
    """How recordings with a device are read."""

    angle_course_sd: NonNegative = 0.004
    """Standard deviation of that part of an angle's error that goes with the motion [rad]: skin that slides as the
    joint turns, which no scatter shows. It widens the bands of stiffness, rest and damping where the device does not
    measure its angle: by 1 % for hips that bend by 0.4 rad, by 10 % for ankles that move by 0.04. Calibrated on hips of
    simulated subjects with 5 mm of skin motion per radian at the thigh."""
    length_scale_sd: NonNegative = 0.02
    """Standard deviation of the error in proportion of lengths of paths, likewise."""
    length_sd: NonNegative = 0.002
    """Standard deviation of the error of a path's length that is common to all frames [m]: its ends are where markers
    or the sheet put them on an identified skeleton. Calibrated on the same subjects; it widens the band of rest."""
    angle_sd: NonNegative = 0.03
    """The same of an angle [rad]: the zero of a joint's angle is a convention that markers tell to two degrees."""
    plate_gain_sd: NonNegative = 0.004
    """Standard deviation of the plates' gain with the device against without: 0.4 % in eight public sessions
    (``session/standing.py``), 0.3 kg of a person. Nothing in the recordings tells it from a device's weight; it
    widens the band of the masses. Weighing the device does better; zero for plates that are known to repeat."""
    correlation_s: Positive = 2.0
    """Time within which residuals of a sensor may depend on one another (Bartlett window of Newey & West,
    Econometrica 55:703 (1987)), chosen: two gait cycles."""
    told: Positive = 0.5
    """Share of the prior variance that recordings must remove for an unknown parameter of a grounded support to count
    as determined, chosen: the rest is prior."""
    unknown: Mapping[str, SheetValue] = field(default_factory=lambda: UNKNOWN)
    """Prior of unknown parameters of grounded supports, by name."""
