"""This module draws subjects who keep their balance: a motion, or a hidden pull, can be too much for one."""

from collections.abc import Callable
from typing import TypeVar

from torchid.errors import ConfigError

Made = TypeVar("Made")
SUBJECTS = 6
"""Asked one after the other; one in some hundreds falls, under a pull one in ten."""


def in_balance(make: Callable[[int], Made], seed: int) -> Made:
    """Return what is simulated of the first subject, from a seed on, who keeps balance in all motions.

    Args:
        make: simulates the subject of a seed.
        seed: of the first subject asked.
    """
    for attempt in range(seed, seed + SUBJECTS):
        try:
            return make(attempt)
        except ConfigError as refusal:
            assert refusal.code == "simulate.balance", refusal
    raise AssertionError(f"none of {SUBJECTS} subjects from seed {seed} on keeps balance")
