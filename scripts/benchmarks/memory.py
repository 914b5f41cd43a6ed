"""Peak memory of one hour at 100 Hz: poses of one chunk after another, base rows and their sums."""

import resource
import sys

import torch

from benchmarks.subject import RATE, make_session
from torchid.dynamics import base_gram, body_rows, dynamic_state
from torchid.geometry.inverse import solve_poses

MINUTE = int(60 * RATE)


def main(minutes: int) -> None:
    """Print the megabytes that the chain needed beyond what it had before its first chunk."""
    torch.set_num_threads(1)
    session = make_session(MINUTE, 3)
    geometry, _ = session.problem.split(session.xi)
    tree, plan = session.model.tree, session.problem.plan
    before, total = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, None
    for _ in range(minutes):
        q, _ = solve_poses(session.problem, session.start, session.xi)
        for part in q.split(1024, dim=1):
            rows = body_rows(dynamic_state(tree, geometry, part, part, part))
            gram, _ = base_gram(plan, rows, part[:6])
            total = gram if total is None else total + gram
    sys.stdout.write(f"{(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024}\n")


if __name__ == "__main__":
    main(int(sys.argv[1]))
