"""Thresholds of the witnesses, with kind and source as in ``diagnosis/options.py``; scatters are in ``scatter.py``."""

from dataclasses import dataclass

from torchid.conventions import Positive, Share


@dataclass(frozen=True)
class WitnessOptions:
    """Contacts, windows and plates that model-free checks ask."""

    shortest_contact_s: Positive = 0.3
    """Calibrated. Least time that a foot must bear a plate for its pressure to count [s]."""
    shortest_s: Positive = 0.5
    """Derived. Shortest window of the balance [s]: 5 mm of a centre of mass are 0.4 % of what gravity does in it."""
    longest_s: Positive = 2.0
    """Calibrated. Longest window of the balance [s]: what is left of a zero grows with the square of time."""
    least_share: Share = 0.08
    """Calibrated. Share of the weight below which a plate says nothing of its own."""
    open_ratio: Positive = 3.0
    """Calibrated. Times the median window's residual from which on a window is left out."""
    least_shift: Share = 0.2
    """Calibrated. Standard deviation of a plate's share of the weight below which plates speak together: walking has
    0.4, squats and standing less than 0.1, where a gain would hang on millimetres."""
