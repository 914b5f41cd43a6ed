"""The inertial solve from accumulated data: evidence, LMIs, certificate and posterior of the whole body."""

import time
from collections.abc import Callable

import numpy as np
import torch

from benchmarks.row_sums import base_gram
from torchid.dynamics.equations_of_motion import base_rows, body_rows, dynamic_state
from torchid.dynamics.row_equations import NormalEquations
from torchid.inertia.fit import InertiaFit, fit_inertia
from torchid.inertia.options import InertiaOptions
from torchid.kinematics.plan import plan_tree
from torchid.model.whole_body import whole_body

NOISE = 5.0
"""Of every row [N, N m]."""


def bench_inertia(rounds: int) -> dict[str, float]:
    """Milliseconds of a solve after the first (median), for few and for many frames, and the relative gap."""
    model = whole_body(1.75, 70.0, "male")
    prior, names = model.inertia, model.tree.names

    def solve(frames: int) -> Callable[[], InertiaFit]:
        equations = _equations(model, frames)
        return lambda: fit_inertia(equations, prior, names, InertiaOptions(noise="known"))

    few, many = solve(1_000), solve(20_000)
    fit = many()
    return {"few_ms": _median(few, rounds), "many_ms": _median(many, rounds), "gap": fit.certificate.optimality.gap}


def _equations(model, frames: int) -> NormalEquations:
    rng, plan = np.random.default_rng(3), plan_tree(model.tree)
    q, v, a = (torch.tensor(rng.normal(size=(len(model.tree.dofs), frames))) for _ in range(3))
    geometry = model.geometry.geometry(model.geometry.mean)
    rows = body_rows(dynamic_state(model.tree, geometry, 0.3 * q, v, a))
    truth = model.inertia.mean.reshape(-1)
    wrench = torch.einsum("ipt,p->it", base_rows(plan, rows), truth) + NOISE * torch.tensor(
        rng.normal(size=(6, frames))
    )
    gram, moment = base_gram(plan, [(rows, wrench)])
    return NormalEquations(gram, moment, float(wrench.square().sum()), 6 * frames).scale(NOISE**-2)


def _median(run: Callable[[], InertiaFit], rounds: int) -> float:
    spent = []
    for _ in range(rounds):
        start = time.process_time()
        run()
        spent.append(1e3 * (time.process_time() - start))
    return sorted(spent)[rounds // 2]
