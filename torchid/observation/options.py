"""Options that decide which frames of a trial are evidence for the diagnosis, and when a plate bears nothing."""

from dataclasses import dataclass

from torchid.conventions import ZERO_MOST_N, Count, NonNegative, Positive


@dataclass(frozen=True)
class ObservationOptions:
    """Thresholds by which the diagnosis believes frames of a trial and readings of plates."""

    ends_periods: NonNegative = 0.6
    """Calibrated. Periods of the cut-off from an end of the clock within which no column is trusted: columns of
    displacements are second derivatives of what a filter knows from one side only. Set on a landing at the end of a
    trial."""
    noise_frames: Count = 50
    """Derived. Frames that tell the noise of a plate that bears nothing: its standard deviation is known to
    (2 * 50)^-0.5, a tenth."""
    zero_most_N: Positive = ZERO_MOST_N
    """Derived. Reading beyond which no plate's zero lies: half of the weight of a child of 20 kg, so that a plate that
    never reads less was stood on all the time."""
    unloaded_least_s: Positive = 0.2
    """Calibrated. Shortest unloaded run that counts. Set on a runner, whose swings are shorter than half a second."""
    unloaded_edge_s: Positive = 0.04
    """Derived. Time cut off at the ends of such a run: a quarter of a period of a 6 Hz filter, which carries a stance
    into the swing."""
    unloaded_short_s: Positive = 0.5
    """Calibrated. Length below which a run must begin and end in a moment: a short one does not show whether a load
    changes."""
    still_N: Positive = 2.0
    """Calibrated. Largest bend of a plate's load within a run, beside its noise: more is a foot that bears little."""
    still_N_s: Positive = 2.0
    """Calibrated. Largest lean of the load per second: more than any charge amplifier drifts."""
    still_sd: Positive = 1.5
    """Calibrated. Standard deviations of noise that lean and bend may have beside these."""
    sudden_N: Positive = 60.0
    """Calibrated. Load just outside a short run that shows a foot on the plate: three times that of a loaded plate."""
