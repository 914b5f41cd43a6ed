"""Peak memory of one hour at 100 Hz: poses of one chunk after another, base rows and their sums."""

import sys
from collections.abc import Iterator
from pathlib import Path

import torch

from benchmarks.row_sums import base_gram
from benchmarks.subject import RATE, make_session
from torchid.dynamics.equations_of_motion import BodyRows, body_rows, dynamic_state
from torchid.geometry.arrow.inverse_kinematics import solve_poses

MINUTE = int(60 * RATE)


def main(minutes: int) -> None:
    """Print the megabytes that the chain needed beyond what it had before its first chunk."""
    torch.set_num_threads(1)
    session = make_session(MINUTE, 3)
    geometry, _ = session.problem.split(session.xi)
    tree, plan = session.model.tree, session.problem.plan
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew: making the session must not hide the chain's
    before = _status("VmRSS")

    def stream() -> Iterator[tuple[BodyRows, torch.Tensor]]:
        for _ in range(minutes):
            q, _ = solve_poses(session.problem, session.start, session.xi)
            for part in q.split(1024, dim=1):
                yield body_rows(dynamic_state(tree, geometry, part, part, part)), part[:6]

    base_gram(plan, stream())
    sys.stdout.write(f"{_status('VmHWM') - before}\n")


def _status(key: str) -> float:
    """A figure of /proc/self/status [MiB]."""
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith(key))
    return float(line.split()[1]) / 1024


if __name__ == "__main__":
    main(int(sys.argv[1]))
