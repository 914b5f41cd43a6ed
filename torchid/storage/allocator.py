"""What a program does with its memory: freed pages are kept for the next batch, garbage is looked for seldom."""

import atexit
import ctypes
import gc
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
SELDOM = 50_000
"""Resolution. Objects that have come and stayed before the newest are looked through for garbage; Python's own is 700
(2000 from 3.13 on). Imports bring a million that stay: with 700 they are looked through so often that a start costs
3.6 s of CPU in place of 1.9 (``torchid.run``); what a run holds in memory is the same."""
_asked: list[bool] = []
"""Whether the program that this is part of has asked for it."""


def seldom_collect() -> None:
    """Look for garbage seldom, and not at the end of the process, when all of it goes anyway.

    A program decides this for itself, before its imports; importing the library does not. Asked again, nothing changes.
    """
    if gc.get_threshold()[0] != SELDOM:
        gc.set_threshold(SELDOM, *gc.get_threshold()[1:])
        atexit.register(gc.freeze)


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
