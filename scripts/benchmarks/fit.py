"""Geometric fit: CPU seconds to within 0.01 % of the best cost, and how they grow."""

import time

from benchmarks.first_order import Trace, adam, scipy_sparse
from benchmarks.subject import Session, make_session
from torchid.geometry.arrow.solver import solve_arrow

CLOSE = 1e-4
FEW, ALL = 3, 50
"""Markers whose places are unknown."""


def arrow(session: Session) -> Trace:
    """CPU seconds and cost after every step on all frames."""
    start, trace = time.process_time(), []
    solution = solve_arrow(
        session.problem, session.start, session.problem.xi_mean, tolerance=1e-6,
        progress=lambda _, cost: trace.append((time.process_time() - start, cost)),
    )  # fmt: skip
    return [*trace, (time.process_time() - start, solution.cost)]


def reach(trace: Trace, cost: float) -> float | None:
    """When the trace comes within 0.01 % of ``cost``."""
    return next((t for t, c in trace if c <= cost * (1 + CLOSE)), None)


def bench_fit(frames: int, rounds: int, peers: bool) -> dict[str, object]:
    """Times of all solvers, and of the arrow with more unknowns and frames."""
    few, every, long = make_session(frames, FEW), make_session(frames, ALL), make_session(20 * frames, FEW)
    kinds = {"few": few, "all": every}
    runs: dict[str, list[Trace]] = {name: [] for name in kinds}
    arrow(few)
    for _ in range(rounds):
        for name, session in kinds.items():
            runs[name].append(arrow(session))
    runs["long"] = [arrow(long)]
    if peers:
        budget = 60.0
        runs["adam"] = [adam(few.problem, few.start, few.problem.xi_mean, n, budget) for n in (300, 1000, 3000)]
        runs["scipy"] = [scipy_sparse(few.problem, few.start, few.problem.xi_mean, budget)]
    best = {name: min(c for trace in traces for _, c in trace) for name, traces in runs.items()}
    best["adam"] = best["scipy"] = best["few"] = min(best.get(k, best["few"]) for k in ("few", "adam", "scipy"))
    out: dict[str, object] = {"frames": frames, "unknowns": [len(s.problem.xi_mean) for s in kinds.values()]}
    for name, traces in runs.items():
        times = sorted(t for trace in traces if (t := reach(trace, best[name])) is not None)
        whole = sorted(trace[-1][0] for trace in traces)
        out[f"{name}_s"] = (times[0] if name == "adam" else times[len(times) // 2]) if times else None
        out[f"{name}_whole_s"] = whole[len(whole) // 2]
        out[f"{name}_gap"] = min(trace[-1][1] for trace in traces) / best[name] - 1
    return out
