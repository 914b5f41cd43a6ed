"""Thresholds of the witnesses, with kind and source as in ``diagnosis/options.py``; scatters are in ``scatter.py``."""

from dataclasses import dataclass

from torchid.bounds import Count, Positive, Share


@dataclass(frozen=True)
class WitnessOptions:
    """Thresholds by which witnesses name faults and contradict causes."""

    odds: Share = 0.1
    """Derived. Odds before any data that a session has a fault of one kind: one session in ten."""
    named_probability: Share = 0.5
    """Derived. Probability from which a fault is named, with all that cannot be told from it: that it is there is
    likelier than that it is not. What is said of it is how likely."""
    alike_nats: Positive = 3.0
    """Cited. Log odds within which a rival cannot be told from the best: below 20 to one, evidence is not strong
    (Kass & Raftery, JASA 90:773 (1995))."""
    most: Count = 6
    """Derived. Number of faults at most: more are no laboratory."""
    p_value: Share = 0.01
    """Calibrated. Chance of what the statements say beyond the faults below which none is named: planted faults left
    0.97 and more, what several faults had to explain together 0.005 and less."""
    contradicted_nats: Positive = 4.5
    """Derived. Log likelihood by which statements must speak against a cause to refute it: three standard deviations,
    3^2 / 2."""
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
