"""Keep freed memory: what a batch of frames gives back, the next batch takes again."""

import ctypes
import sys

TRIM, MMAP = -1, -3
"""glibc's M_TRIM_THRESHOLD and M_MMAP_THRESHOLD (mallopt(3))."""
KEPT = 256 << 20
"""Free bytes at the end of the heap that stay with the process."""
OWN = 16 << 20
"""Tensors from this size on get and return pages of their own."""


def keep_memory() -> bool:
    """Ask the C library to keep freed memory for the whole process; False where it is not glibc.

    By default glibc returns every few megabytes to the kernel, which zeroes them again for the next batch: a third of
    the time of inverse kinematics. A program decides this for itself, so importing the library does not.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return False
    return bool(mallopt(TRIM, KEPT)) and bool(mallopt(MMAP, OWN))
