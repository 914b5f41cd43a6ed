"""How statements of witnesses scatter where nothing is wrong: by themselves, and all of a kind in a session together.

Estimator. Robust scatter between eight public sessions of five laboratories, of which none is quoted in a figure
(`docs/decisions.md`); clocks by seven sessions that the real battery is tuned on, none of them kept aside. What is
alike in a session stands for what bodies and tables of inertia share in all its trials.
"""

from typing import NamedTuple

from torchid.checks.clocks import OWN_LAG_SD_S, USUAL_LAG_S
from torchid.conventions import ZERO_SD_N, ZERO_SD_NM


class Scatter(NamedTuple):
    """Standard deviations of one kind of statement, and about what."""

    own: float
    """Of each by itself."""
    alike: float
    """Of what all of the kind in a session share."""
    usual: float = 0.0
    """Mean over sessions."""
    unit: str = "part"
    """Of all these; ``part`` of what is recorded, or of the vertical force."""


RECORD_PART = 0.01
"""Estimator. Relative standard deviation of a recorded mass at least: shoes, clothes, the hour of the day."""
SCATTER = {
    "mass": Scatter(0.004, 0.0),  # what is alike is the record's
    "gain": Scatter(0.008, 0.0),
    **{f"clock_{way}": Scatter(OWN_LAG_SD_S[way], usual, usual, "s") for way, usual in USUAL_LAG_S.items()},
    "lean_x": Scatter(0.005, 0.003), "lean_y": Scatter(0.005, 0.003),
    **{f"zero_f{axis}": Scatter(ZERO_SD_N, 0.0, unit="N") for axis in "xyz"},
    **{f"zero_m{axis}": Scatter(ZERO_SD_NM, 0.0, unit="N m") for axis in "xyz"},
    "pressure_lateral": Scatter(0.008, 0.012, unit="m"), "pressure_along": Scatter(0.016, 0.03, unit="m"),
}  # fmt: skip
