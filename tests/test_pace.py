"""A solver that may take long says so early, says how far it has come, and keeps quiet where it is quick."""

import logging

import pytest

from torchid.session.fitting import EVERY_S, LONG_S, STEPS, Pace


def told(step_s: float, most: int, steps: tuple[int, ...], caplog) -> tuple[list[str], list[float]]:
    """What is logged, and the shares that are shown, of a solver whose rounds take so many steps."""
    now, shares = [0.0], []
    pace = Pace("geometry", most, len(steps), lambda stage, share: shares.append(share), lambda: now[0])
    with caplog.at_level(logging.WARNING, "torchid"):
        for count in steps:
            for k in range(1, count + 1):
                now[0] += step_s
                pace(k, 1.0)
    return [record.getMessage() for record in caplog.records], shares


def test_a_slow_solver_says_so_before_and_meanwhile(caplog):
    most, steps = 2000, (2000, 300, 700)
    said, shares = told(0.2, most, steps, caplog)
    assert f"step {STEPS} of at most {3 * most}" in said[0] and f"{0.2 * (3 * most - STEPS):.0f} s more" in said[0]
    assert len(said) == pytest.approx(0.2 * sum(steps) / EVERY_S, abs=2)
    assert shares == sorted(shares) and shares[0] < 0.01 and shares[-1] < 1.0


def test_a_quick_solver_says_nothing(caplog):
    said, shares = told(LONG_S / 181.0, 60, (12, 9, 15), caplog)
    assert not said and shares == sorted(shares)


def test_rounds_of_one_step_are_counted(caplog):
    _, shares = told(0.1, 10, (1, 1, 1), caplog)
    assert shares == pytest.approx([1 / 30, 11 / 30, 21 / 30])
