"""This module is what can be asked of some draws: successes for a rate that a method claims, and a mean of figures."""

from collections.abc import Sequence
from statistics import stdev

from scipy.stats import binom, norm

FALSE_ALARM = 1e-4
"""Probability at most that a test of a rate fails although the method has it. A choice: of a gate with a hundred such
tests, one version of the seeds (``draws.VERSION``) in a hundred then fails by chance."""


def at_least(rate: float, draws: int, false_alarm: float = FALSE_ALARM) -> int:
    """Return the most successes that can be asked of some draws: fewer are less probable than the false alarm.

    Args:
        rate: probability of a success that the method claims.
        draws: independent ones.
        false_alarm: probability of fewer successes at that rate.
    """
    # The quantile is the least k with P(at most k) >= the false alarm, so P(fewer than k) lies below it.
    return int(binom.ppf(false_alarm, draws, rate))


def draws_for(rate: float, least: int = 1, false_alarm: float = FALSE_ALARM) -> int:
    """Return the fewest draws of which at least some successes can be asked.

    Args:
        rate: probability of a success that the method claims.
        least: successes to be asked.
        false_alarm: probability of fewer.
    """
    return next(draws for draws in range(least, 10_000) if at_least(rate, draws, false_alarm) >= least)


def leeway(figures: Sequence[float], false_alarm: float = FALSE_ALARM) -> float:
    """Return by how much the mean of independent draws may lie beyond what is claimed of it, by their own scatter.

    Args:
        figures: one of each draw, enough for a mean that is normal.
        false_alarm: probability that a mean lies further beyond.
    """
    return float(norm.isf(false_alarm)) * stdev(figures) / len(figures) ** 0.5
