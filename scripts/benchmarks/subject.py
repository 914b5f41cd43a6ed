"""A synthetic session on the built-in model (50 markers, smooth motion, 5 mm of noise), and timing by turns."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import roma
import torch
from torch import Tensor

from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.kinematics.plan import plan_tree
from torchid.model.model import Model
from torchid.model.tree import Tree
from torchid.model.whole_body import whole_body

RATE, NOISE, PLACE_SD = 100.0, 0.005, 0.01
LIMIT_PRECISION = 1e4
BOXES = {
    "pelvis": (4, (-0.12, -0.14, 0.02), (0.10, 0.14, 0.10)),
    "abdomen": (2, (-0.10, -0.12, 0.02), (0.10, 0.12, 0.12)),
    "thorax": (4, (-0.11, -0.15, 0.05), (0.12, 0.15, 0.30)),
    "head": (4, (-0.08, -0.08, 0.05), (0.10, 0.08, 0.20)),
    "upper_arm": (3, (-0.05, -0.05, -0.27), (0.05, 0.05, -0.03)),
    "forearm": (3, (-0.04, -0.04, -0.24), (0.04, 0.04, -0.03)),
    "hand": (3, (-0.03, -0.04, -0.12), (0.03, 0.04, -0.02)),
    "thigh": (3, (-0.08, -0.08, -0.40), (0.08, 0.08, -0.05)),
    "shank": (3, (-0.06, -0.06, -0.38), (0.06, 0.06, -0.05)),
    "foot": (3, (-0.06, -0.05, -0.06), (0.16, 0.05, -0.01)),
}
"""Number of markers on each segment and the box whose opposite corners they sit near [m]."""
CORNERS = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]])


@dataclass(frozen=True)
class Session:
    """A problem, what made it, and where solvers start."""

    model: Model
    problem: MarkerProblem
    q: Tensor
    xi: Tensor
    start: Tensor
    """Root pose in closed form from its own markers, joints at rest."""


def make_session(frames: int, free_places: int, seed: int = 0) -> Session:
    """A session in which every geometric parameter and ``free_places`` markers' places are unknown."""
    rng, model = np.random.default_rng(seed), whole_body(1.75, 70.0, "male")
    tree, prior, plan = model.tree, model.geometry, plan_tree(model.tree)
    body, place = _markers(tree, rng)
    free = torch.linspace(0, len(body) - 1, free_places).round().long()
    position = torch.tensor(plan.position)[body]
    blank = torch.zeros(len(body), 3, frames, dtype=torch.float64)
    problem = MarkerProblem(
        plan, prior, position, blank, torch.full((len(body), frames), NOISE**-2, dtype=torch.float64), place,
        torch.full_like(place, PLACE_SD), free, _posture(tree),
    )  # fmt: skip
    spread = torch.cat([0.7 * prior.sd, torch.full((3 * free_places,), PLACE_SD, dtype=torch.float64)])
    xi = problem.xi_mean + spread * torch.tensor(rng.normal(size=len(spread)))
    q = _motion(tree, frames, rng)
    p = problem.residual(q, xi)[1]
    problem = replace(problem, target=p + NOISE * torch.tensor(rng.normal(size=p.shape)))
    return Session(model, problem, q, xi, _start(problem))


def _markers(tree: Tree, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    body, place = [], []
    for k, name in enumerate(tree.names):
        count, low, high = BOXES[name.removesuffix("_l").removesuffix("_r")]
        for corner in rng.permutation(4)[:count]:
            share = 0.8 * CORNERS[corner] + 0.2 * rng.uniform(size=3)
            body.append(k)
            place.append(np.array(low) + share * (np.array(high) - np.array(low)))
    return torch.tensor(body), torch.tensor(np.array(place))


def _posture(tree: Tree) -> PosturePrior:
    rest, sd, lower, upper = (
        torch.tensor([getattr(dof, field) for dof in tree.dofs], dtype=torch.float64)[:, None]
        for field in ("rest", "sd", "lower", "upper")
    )
    return PosturePrior(rest, sd.square().reciprocal(), lower, upper, LIMIT_PRECISION)


def _motion(tree: Tree, frames: int, rng: np.random.Generator) -> Tensor:
    """Three sines of 0.1-1.5 Hz on every coordinate, within its limits."""
    t = np.arange(frames) / RATE
    q = np.zeros((len(tree.dofs), frames))
    for k, dof in enumerate(tree.dofs):
        rest, amplitude = dof.rest, 0.3
        if k >= 6:
            rest = float(np.clip(dof.rest, dof.lower + 0.15, dof.upper - 0.15))
            amplitude = min(0.35, 0.8 * min(dof.upper - rest, rest - dof.lower))
        q[k] = rest
        for _ in range(3):
            swing = amplitude / 1.7 * rng.uniform(0.2, 1.0)
            q[k] += swing * np.sin(2 * np.pi * rng.uniform(0.1, 1.5) * t + rng.uniform(0, 2 * np.pi))
    return torch.tensor(q)


def _start(problem: MarkerProblem) -> Tensor:
    on = (problem.body == problem.plan.position[0]).nonzero()[:, 0]
    model, target = problem.place[on], problem.target[on].permute(2, 0, 1)
    R, t = roma.rigid_points_registration(model.expand_as(target), target)
    q = problem.posture.mean.expand(-1, len(target)).clone()
    q[:3], q[3:6] = t.T, roma.rotmat_to_rotvec(R).T
    return q


def by_turns(runs: dict[str, Callable[[], object]], rounds: int, warm: bool = True) -> dict[str, float]:
    """Median CPU seconds of each, measured A B A B."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for k in range(rounds + warm):
        for name, run in runs.items():
            start = time.process_time()
            own = run()
            spent = own if isinstance(own, float) else time.process_time() - start
            if k >= warm:
                times[name].append(spent)
    return {name: statistics.median(values) for name, values in times.items()}
