#!/usr/bin/env python
"""Fit a subject's geometry with the loop in sight: Adam, LBFGS or the arrow's steps, on all frames at once.

    python scripts/fit_geometry.py --config configs/demo.yaml --solver adam --iterations 2000 --out out/train

Adam and LBFGS differentiate through the pytorch-kinematics chain; the arrow takes Gauss-Newton steps. Writes
metrics.jsonl, checkpoint.snapshot (the next call goes on from its q and xi; the optimiser's memory starts afresh) and,
at the end, geometry.snapshot.
"""

import json
import time
from dataclasses import replace
from pathlib import Path

import torch
from harness.command import Among, Command
from torch import Tensor

from torchid.config import load_config
from torchid.geometry.arrow.solver import Solution, solve_arrow
from torchid.geometry.fit import finish_fit, joint_problem, start_fit
from torchid.geometry.gradient_solvers import Q_SCALE, Q_STEP, XI_STEP, accumulate_gradients
from torchid.geometry.marker_weights import reweighted
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.result import GeometryFit
from torchid.run.simulation import with_recordings
from torchid.session.opening import read_session
from torchid.storage.allocator import keep_memory
from torchid.storage.snapshot import from_bytes, to_bytes

SHOWN = 50
"""A line of progress and a checkpoint every so many iterations."""


def prepare(path: str, overrides: list[str]) -> tuple[GeometryFit, MarkerProblem, Tensor]:
    """The problem that is minimised, and where it starts."""
    # Recordings, a template that carries their markers, a first scale from the static trial.
    config = with_recordings(load_config(path, overrides), lambda stage, fraction: None)
    session = read_session(config)
    trials = {name: trial.markers for name, trial in session.fit("geometry").items()}
    static = None if session.static is None else session.static.markers
    given = session.assignment
    fit = start_fit(given.model, given.attachment, trials, static, config.geometry)

    # One problem: q of every frame (dofs, frames) and xi, which all frames share. Weights match the residuals of a
    # quick least-squares fit: a marker on loose skin says less, and skin that slides for a second is one observation.
    problem, q, lengths = joint_problem(fit, trials, static)
    rough = solve_arrow(replace(problem, robust=None), q, fit.xi, tolerance=1e-4)
    return *reweighted(fit, problem, rough, lengths), q


def main(argv: list[str] | None = None) -> None:
    keep_memory()
    args = Command(
        __doc__, ("overrides",), config={"required": True}, solver=Among(("adam", "lbfgs", "arrow"), "adam"),
        iterations=2000, out=Path("out/train"), overrides=({"nargs": "*"}, "key=value"),
    ).asked(argv)  # fmt: skip
    args.out.mkdir(parents=True, exist_ok=True)
    fit, problem, q = prepare(args.config, args.overrides)
    state = load(args.out / "checkpoint.snapshot", {"iteration": 0, "solver": args.solver, "q": q, "xi": fit.xi})

    # Unknowns in units in which their steps are alike: LBFGS needs it, Adam has a rate for each instead.
    units = (Q_SCALE, problem.xi_precision.rsqrt()) if args.solver == "lbfgs" else (1.0, 1.0)
    y, z = (state["q"] / units[0]).requires_grad_(), (state["xi"] / units[1]).requires_grad_()
    optimiser = {
        "adam": lambda: torch.optim.Adam([{"params": [y], "lr": Q_STEP}, {"params": [z], "lr": XI_STEP}]),
        "lbfgs": lambda: torch.optim.LBFGS(
            [y, z], max_iter=4, history_size=30, line_search_fn="strong_wolfe", tolerance_change=1e-12
        ),
        "arrow": lambda: None,
    }[args.solver]()

    def closure() -> float:
        """Cost of all frames, and its gradients with respect to the scaled unknowns."""
        q, xi = ((x.detach() * unit).requires_grad_() for x, unit in zip((y, z), units, strict=True))
        cost = accumulate_gradients(problem, q, xi)
        y.grad, z.grad = q.grad * units[0], xi.grad * units[1]
        return cost

    cost, begun = float("nan"), time.perf_counter()
    with (args.out / "metrics.jsonl").open("a") as metrics:
        for k in range(state["iteration"], args.iterations):
            if optimiser is None:
                step = solve_arrow(problem, y.detach(), z.detach(), iterations=1)
                y, z, cost = step.q, step.xi, step.cost
            else:
                cost = optimiser.step(closure)
            q, xi = y.detach() * units[0], z.detach() * units[1]
            row = {"iteration": k + 1, "cost": cost, "marker_rms_mm": rms_mm(problem, q, xi)}
            metrics.write(json.dumps(row | {"seconds": time.perf_counter() - begun}) + "\n")
            if (k + 1) % SHOWN == 0 or k + 1 == args.iterations:
                print(f"{k + 1:6d}  cost {cost:12.2f}  markers {row['marker_rms_mm']:7.3f} mm", flush=True)
                state = {"iteration": k + 1, "solver": args.solver, "q": q, "xi": xi}
                (args.out / "checkpoint.snapshot").write_bytes(to_bytes(state))

    # Standard deviations and undetermined directions from the chain's Jacobians, whatever solver came before.
    solution = Solution(state["q"], state["xi"], cost, state["iteration"], False, ())
    fit = finish_fit(fit, problem, solution)
    (args.out / "geometry.snapshot").write_bytes(to_bytes(fit))
    assert fit.uncertainty is not None
    for name, unit, value, sd in zip(fit.prior.names, fit.prior.units, fit.xi, fit.uncertainty.sd, strict=False):
        print(f"{name:28s} {float(value):8.4f} +- {float(sd):.4f} {unit}")


def rms_mm(problem: MarkerProblem, q: Tensor, xi: Tensor) -> float:
    """Root mean square distance of measured and modelled markers [mm]."""
    _, _, residual = problem.residual(q, xi)
    return 1e3 * float(residual.square().sum(1)[problem.weight > 0].mean().sqrt())


def load(path: Path, fresh: dict) -> dict:
    """The checkpoint, if it belongs to the same solver and unknowns."""
    if not path.exists():
        return fresh
    state = from_bytes(path.read_bytes())
    same = state["solver"] == fresh["solver"] and all(state[x].shape == fresh[x].shape for x in ("q", "xi"))
    return state if same else fresh


if __name__ == "__main__":
    main()
