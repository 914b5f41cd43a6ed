"""Freed memory that stays with the process is not asked of the kernel again."""

import subprocess
import sys

import pytest

CHILD = """
import resource, torch
from torchid.storage.allocator import keep_memory
kept = keep_memory()
def batch():
    return sum(torch.ones(400_000, dtype=torch.float64).sum() for _ in range(4))
batch()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    batch()
print(int(kept), resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc only")
def test_batches_take_up_the_memory_of_earlier_ones():
    """After the first batch, 200 tensors of 3.2 MB touch hardly any new page (of 800 each)."""
    done = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True, check=True)  # noqa: S603
    kept, faults = map(int, done.stdout.split())
    if not kept:
        pytest.skip("this C library has no mallopt")
    assert faults < 4_000


LARGE_CHILD = """
import resource, torch
from torchid.storage.allocator import keep_memory, keeping_large
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        torch.ones(8_000_000, dtype=torch.float64).sum()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
kept = keep_memory()
outside = faults()
with keeping_large():
    faults()
    print(int(kept), outside, faults())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc only")
def test_large_tensors_are_kept_for_a_while():
    """20 tensors of 64 MB touch all their pages anew (16000 each, or 32 huge ones), and hardly one in there."""
    done = subprocess.run([sys.executable, "-c", LARGE_CHILD], capture_output=True, text=True, check=True)  # noqa: S603
    kept, outside, inside = map(int, done.stdout.split())
    if not kept:
        pytest.skip("this C library has no mallopt")
    assert inside < 100 < outside


GARBAGE_CHILD = """
import gc
from torchid.storage.allocator import SELDOM, seldom_collect
seldom_collect()
import torchid.run
print(gc.get_threshold()[0] == SELDOM, gc.get_stats()[2]["collections"])
"""


def test_a_start_looks_for_garbage_seldom():
    """However much is imported, it is never looked through as a whole."""
    done = subprocess.run([sys.executable, "-c", GARBAGE_CHILD], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout.split() == ["True", "0"]
