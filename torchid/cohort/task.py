"""One member as a task that a worker takes: a process that is watched, tried twice, and leaves a row."""

import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from torchid.cohort.members import LABELS, Participant
from torchid.cohort.one_run import Row, write_order
from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.run.sequence import inputs
from torchid.storage.files import file_sha256, safe_name, write_json
from torchid.storage.provenance import stage_key

TRIES = 2
"""Times that a member is run which crashes, hangs or exhausts memory; one that is refused is run once; chosen."""
LOOK_S = 0.25
"""Time between looks at a run [s]; resolution."""
BYTES = 2**30
"""Of a gibibyte."""
AGAIN = ("defect", "results.", "tables.")
"""Beginnings of codes of refusals that are not the recordings': another run may end otherwise."""
PAUSE_S = 3.0
"""Time before another try [s]; chosen: a run whose worker was killed is gone by then."""
COMMAND = (sys.executable, "-m", "torchid.cohort.process")
"""What runs an order."""
ROWS, CONFIGS, LOGS = "rows", "configs", "logs"
"""Folders of a cohort beside those of its members' results."""


@dataclass(frozen=True)
class RunLimits:
    """What one run may take."""

    memory_gb: float
    seconds: float


def row_path(member: Participant, out: Path) -> Path:
    """Return the file of a member's row.

    Args:
        member: whose.
        out: folder of the cohort.
    """
    return out / ROWS / f"{safe_name(member.name)}.json"


def log_path(member: Participant, out: Path) -> Path:
    """Return the file of what a member's run said, beside its row's.

    Args:
        member: whose.
        out: folder of the cohort.
    """
    return out / LOGS / f"{safe_name(member.name)}.txt"


def files_of(member: Participant) -> list[Path]:
    """Return the files on which a member's run depends: all of its folder, or its config and what that names.

    Args:
        member: whose.
    """
    if member.source.is_dir():
        return sorted(file for file in member.source.rglob("*") if file.is_file())
    try:
        named = inputs(load_config(member.source))
    except TorchidError:  # a file of many trials, or a config whose run will say what is wrong with it
        named = []
    return sorted({member.source, *map(Path.resolve, named)})


def looks(member: Participant) -> str:
    """Return what tells a member's files from others without reading them: names, sizes, times of change.

    Args:
        member: whose.
    """
    seen = []
    for file in files_of(member):
        with suppress(OSError):  # one that is gone is another state of the files
            one = file.stat()
            seen.append((str(file), one.st_size, one.st_mtime_ns))
    return stage_key(person=member.person.known, files=seen)


def content(member: Participant) -> str:
    """Return what tells a member's recordings from others: what is in its files.

    Args:
        member: whose.
    """
    seen = []
    for file in files_of(member):
        with suppress(OSError):
            seen.append((os.path.relpath(file, member.source.parent), file_sha256(file)))
    return stage_key(person=member.person.known, files=seen)


def stored(member: Participant, out: Path) -> Row | None:
    """Return the row of an earlier call; None where there is none, or files, facts or torchid have changed since.

    Neither is one kept of a run that crashed or exceeded its limits: another may end otherwise.

    Args:
        member: whose.
        out: folder of the cohort.
    """
    try:
        row = json.loads(row_path(member, out).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(row, dict) or row.get("again", True):
        return None
    if row["status"] == "done" and not (out / safe_name(member.name) / "report.html").is_file():
        return None
    if row.get("looks") != looks(member):
        if row.get("content") != content(member):
            return None
        row |= {"looks": looks(member)}
        write_json(row_path(member, out), row)
    return {key: value for key, value in row.items() if key not in LABELS} | _who(member)


def _who(member: Participant) -> Row:
    return {"subject": member.name, **member.labels}


def perform(member: Participant, out: Path, limits: RunLimits) -> Row:
    """Run a member and keep its row.

    Args:
        member: whom.
        out: folder of the cohort.
        limits: what the run may take.

    Returns:
        The row; a run that was done by another worker in the meantime is not done again.
    """
    row = stored(member, out)
    if row is not None:
        return row
    signs, begin = {"looks": looks(member), "content": content(member)}, time.monotonic()
    row = _attempt(member, out, limits)
    for _ in range(TRIES - 1):
        if row["again"]:
            time.sleep(PAUSE_S)
            row = _attempt(member, out, limits)
    row = _who(member) | row | signs | {"seconds": time.monotonic() - begin}
    write_json(row_path(member, out), row)
    return row


def _attempt(member: Participant, out: Path, limits: RunLimits) -> Row:
    """The row of one run; ``again`` where another try may end otherwise."""
    name = safe_name(member.name)
    config, log = out / CONFIGS / name / f"{name}.yaml", log_path(member, out)
    own = f"{name}.{os.getpid()}.{time.monotonic_ns()}"  # another worker may be at the same member
    order, found = config.with_name(f"{own}.order.json"), out / ROWS / f".{own}.json"
    for file in (order, found, log):
        file.parent.mkdir(parents=True, exist_ok=True)
    write_order(order, member, out / name, config, found)
    with log.open("wb") as said:
        # In a session of its own: an interrupt of the command is none of the run's, which ends when none waits for it.
        process = subprocess.Popen(  # noqa: S603 - our own
            [*COMMAND, str(order)], stdout=said, stderr=said, env=_one_thread(), start_new_session=True
        )
        with process:
            why = _watched(process, limits)
    order.unlink(missing_ok=True)
    if why or not found.is_file():
        return {"status": "set aside", "reason": f"{why or _ended(process.returncode)}; log: {log}", "again": True}
    row = json.loads(found.read_text(encoding="utf-8"))
    found.unlink()
    return row | {"again": row.get("code", "").startswith(AGAIN)}


def _one_thread() -> dict[str, str]:
    return os.environ | {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")}


def _watched(process: subprocess.Popen, limits: RunLimits) -> str:
    """Wait for a run; why it was killed, empty where it ended by itself."""
    begin, own = time.monotonic(), psutil.Process(process.pid)
    while process.poll() is None:
        why = _beyond(own, time.monotonic() - begin, limits)
        if why:
            process.kill()
            process.wait()
            return why
        time.sleep(LOOK_S)
    return ""


def _beyond(process: psutil.Process, seconds: float, limits: RunLimits) -> str:
    if seconds > limits.seconds:
        return f"took longer than {limits.seconds:.0f} s"
    try:
        seen = process.memory_info()
        taken = (seen.rss - getattr(seen, "shared", 0)) / BYTES  # pages of mapped files can be dropped
    except psutil.Error:
        return ""
    return f"needed more than {limits.memory_gb:.1f} GiB of memory" if taken > limits.memory_gb else ""


def _ended(code: int) -> str:
    return f"was ended by signal {-code}" if code < 0 else f"ended with {code} and without a result"
