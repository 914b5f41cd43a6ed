"""Keep freed memory: what a batch of frames gives back, the next batch takes again."""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

TRIM, MMAP = -1, -3
"""glibc's M_TRIM_THRESHOLD and M_MMAP_THRESHOLD (mallopt(3))."""
KEPT = 256 << 20
"""Free bytes at the end of the heap that stay with the process."""
OWN = 16 << 20
"""Tensors from this size on get and return pages of their own."""
LARGE = 1 << 30
"""Both while large ones come and go."""
_asked: list[bool] = []
"""Whether the program that this is part of has asked for it."""


def keep_memory() -> bool:
    """Ask the C library to keep freed memory for the whole process; False where it is not glibc.

    By default glibc returns every few megabytes to the kernel, which zeroes them again for the next batch: a third of
    the time of inverse kinematics. A program decides this for itself, so importing the library does not.
    """
    _asked[:] = [_limit(KEPT, OWN)]
    return _asked[0]


@contextmanager
def keeping_large() -> Iterator[None]:
    """Tensors of any size are kept for the next, in a program that keeps memory at all.

    For work whose memory is bounded: a diagnosis of 20 trials took 76 s instead of 91 s and the same 6.6 GB.
    """
    if not any(_asked):
        yield
        return
    _limit(LARGE, LARGE)
    try:
        yield
    finally:
        _limit(KEPT, OWN)


def _limit(kept: int, own: int) -> bool:
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return False
    return bool(mallopt(TRIM, kept)) and bool(mallopt(MMAP, own))
