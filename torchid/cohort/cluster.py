"""Workers of a cohort: a Dask cluster on this machine, or one that is there."""

import logging
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from torchid.cohort.task import BYTES
from torchid.errors import ConfigError

try:
    import dask.config
    import distributed
except ModuleNotFoundError:  # an optional part
    dask = distributed = None

if TYPE_CHECKING:
    from distributed import Client, Future

LOOPBACK = "127.0.0.1"
"""Where workers, scheduler and dashboard listen unless a scheduler is named."""
RUN_GB = 2.0
"""Memory that a run of ten minutes of recordings takes at most [GiB]; chosen, twice what the shared ones take."""
ANSWER_S = 10
"""Time in which a scheduler has to answer [s]; chosen."""
SETTINGS = {
    "distributed.scheduler.worker-saturation": 1.0,
    # Whoever is beside a killed worker is not to blame: a run that ends its worker does so in a process of its own.
    "distributed.scheduler.allowed-failures": 10,
    "distributed.worker.daemon": False,
    "logging.distributed": "critical",
}
"""Dask's, chosen: at its default saturation innocent tasks were blamed for a killed worker."""


def most_workers() -> int:
    """Return how many runs this machine holds at once, by cores and by memory."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, int(psutil.virtual_memory().available / BYTES / RUN_GB)))


@contextmanager
def workers(count: int | None, scheduler: str | None) -> Iterator["Client"]:
    """Return a client of a cluster whose workers have one thread each.

    Args:
        count: workers on this machine; None for as many as it holds.
        scheduler: address or scheduler file of a cluster that is there; None for one of this machine's own.

    Raises:
        ConfigError: ``cohort.no_dask``; ``cohort.scheduler`` where none answers.
    """
    if dask is None or distributed is None:
        raise ConfigError(
            "cohort.no_dask", "a cohort needs the packages dask and distributed, which are not installed",
            found="no dask", remedy="pip install 'torchid[cohort]'",
        )  # fmt: skip
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what happens to tasks is told by their rows
    with dask.config.set(SETTINGS):
        if scheduler is not None:
            with _named(scheduler) as client:
                yield client
            return
        local = distributed.LocalCluster(
            n_workers=count or most_workers(), threads_per_worker=1, host=LOOPBACK, memory_limit=0,
            dashboard_address=f"{LOOPBACK}:0",
        )  # fmt: skip
        with local, distributed.Client(local) as client:
            yield client


def ended(futures: "Iterable[Future]") -> "Iterator[Future]":
    """Return futures of tasks in the order in which they end.

    Args:
        futures: of a client of ``workers``.
    """
    assert distributed is not None
    return distributed.as_completed(futures)


def _named(scheduler: str) -> "Client":
    assert distributed is not None
    try:
        if ":" in scheduler:
            return distributed.Client(scheduler, timeout=ANSWER_S)
        for _ in range(ANSWER_S):
            if Path(scheduler).is_file():
                return distributed.Client(scheduler_file=scheduler, timeout=ANSWER_S)
            time.sleep(1.0)
        raise OSError("no such file")
    except (OSError, ValueError) as error:
        raise ConfigError(
            "cohort.scheduler", "no scheduler answers", found=scheduler,
            remedy="Give its address (tcp://HOST:PORT) or the file that dask-scheduler --scheduler-file wrote",
        ) from error  # fmt: skip
