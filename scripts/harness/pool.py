"""Jobs in processes of one thread each: rows are kept as they come, and what has a row is not run again."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from harness.rows import Row, add_line, read_lines
from torchid.storage.allocator import keep_memory, seldom_collect

TRIES = 3
"""Choice. Times that a battery goes on after a worker was killed, for want of memory say."""


def alone() -> None:
    """One thread, memory that is kept and garbage that is looked for seldom, for this process."""
    torch.set_num_threads(1)
    keep_memory()
    seldom_collect()


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that begin nothing more where their caller fails: else it would wait for all that is planned."""
    with ProcessPoolExecutor(workers, initializer=alone) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def finished(
    jobs: Mapping[str, Any], work: Callable[[Any], Row], pool: Executor, path: Path, done: Mapping[str, Row]
) -> Iterator[Row]:
    """The rows of jobs by their keys: first those that are done, then the others, each when it has been written."""
    yield from (done[key] for key in jobs if key in done)
    waiting = {pool.submit(work, job): key for key, job in jobs.items() if key not in done}
    for one in as_completed(waiting):
        row = one.result()
        add_line(path, row)
        yield row


def performed(
    jobs: Mapping[str, Any], work: Callable[[Any], Row], workers: int, path: Path, key: str = "key",
    counts: Callable[[Row], bool] = lambda row: True,
) -> Iterator[Row]:  # fmt: skip
    """``finished`` in processes; a worker that is killed does not end it.

    Args:
        jobs: by what their rows have under ``key``.
        work: makes a row.
        workers: processes.
        path: of the rows.
        key: which says whose row one is.
        counts: whether a row that is there already does.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    told: set[str] = set()
    for left in reversed(range(TRIES)):
        done = {row[key]: row for row in read_lines(path) if counts(row)}
        try:
            with processes(workers) as pool:
                for row in finished(jobs, work, pool, path, done):
                    if row[key] not in told:
                        told.add(row[key])
                        yield row
            return
        except BrokenProcessPool:
            if not left:
                raise
            print("a worker was killed; what it had begun is run again", flush=True)
