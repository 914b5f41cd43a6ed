"""How late forces come: the answer of every estimator of a clock, and when it is worth saying.

Each of three uses other information. Feet need no body (``plates_against_feet/clock``): a loaded foot stands still. The
centre of mass needs masses from a table (``model_free/balance``): it answers to forces integrated twice. Rows of the
body need its motion alone: a stream tries every lateness (``live/estimation/instruments``), a run has one column of its
linear model for it (``effects/timing``), and both shift readings by ``effects/timing.delayed``.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class RightClocks:
    """What an estimator says of clocks that are right."""

    early_s: float
    """Least lateness [s], negative: early."""
    late_s: float
    """Largest lateness [s]."""
    clear_sd: float
    """Standard deviations by which a wrong clock lies beyond these; zero where these were seen with theirs."""


@dataclass(frozen=True)
class Lateness:
    """By how much forces come late."""

    seconds: float
    """Negative where they come early [s]."""
    sd: float
    """Standard deviation [s]."""

    def wrong(self, right: RightClocks) -> bool:
        """Return whether this is no right clock's, beyond a doubt that is itself smaller than what clocks may be off.

        Who stands still tells a clock to some 50 ms, and to 10 where chance would have it; a step tells it to 2.

        Args:
            right: what the estimator says of right clocks.
        """
        unsure = right.clear_sd * self.sd
        beyond = not right.early_s - unsure < self.seconds < right.late_s + unsure
        return beyond and unsure < min(-right.early_s, right.late_s)


USUAL_LAG_S = {"vertical": 0.004, "horizontal": 0.005}
"""Estimator. Mean over sessions, and as large its standard deviation, of the lag of forces behind the bones of living
bodies, whose soft parts follow late: of seven sessions of four laboratories six lay at 1 to 8 ms in the vertical and
at 3 to 13 ms in the horizontal, one at -6 and -3 ms (`docs/decisions.md`)."""
OWN_LAG_SD_S = {"vertical": 0.002, "horizontal": 0.003}
"""Estimator. Standard deviation of one trial's lag about its session's, by the same sessions."""
BY_BODY = RightClocks(-0.02, 0.02, 3.0)
"""Choice. By rows of the body: forces of living bodies come up to 15 ms late by themselves (``body_lag``)."""
BY_FEET = RightClocks(-0.030, 0.045, 0.0)
"""Calibrated. Feet tell clocks to 20 ms, and rather late than early: of 52 public recordings the largest are 32 ms with
a factor of 1.1 between the speeds of the slipping foot and 24 ms with 1.6, and in four of them forces that were made
20 ms late look 36 to 43 ms late."""
FEET_SD_S = 0.020
"""Estimator. Standard deviation with which feet tell a clock, see there."""
