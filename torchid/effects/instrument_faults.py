"""The effects that are faults of an instrument, by the names that checks before any fit have for them."""

from torchid.checks.finding import InstrumentFault

FAULTS = {
    "time_offset": InstrumentFault.CLOCK,
    "filter_lag": InstrumentFault.CLOCK,
    "plate_gain": InstrumentFault.GAIN,
    "plate_offset": InstrumentFault.ZERO,
    "plate_drift": InstrumentFault.DRIFT,
    "plate_pose": InstrumentFault.PLACE,
    "plate_crosstalk": InstrumentFault.CROSSTALK,
    "plate_assignment": InstrumentFault.EXCHANGE,
    "gravity_tilt": InstrumentFault.TILT,
    "marker_shift": InstrumentFault.MOVED,
    "marker_swap": InstrumentFault.EXCHANGE,
    "marker_scale": InstrumentFault.UNIT,
}
"""Effects that are faults of instruments."""
