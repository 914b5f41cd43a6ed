"""Small marker problems on random trees, for tests of the geometric solvers."""

import numpy as np
import torch
from trees import coupled_tree, random_tree

from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.kinematics.plan import plan_tree
from torchid.model.model import GeometryPrior


def random_problem(
    rng: np.random.Generator,
    frames: int = 4,
    bodies: int = 7,
    robust: float | None = None,
    noise: float = 0.005,
    coupled: bool = False,
) -> tuple[MarkerProblem, torch.Tensor, torch.Tensor]:
    """A tree with slides, hinges and constant rotations, tied parameters, gaps and free places; with true q and xi."""
    tree, geometry = random_tree(rng, bodies)
    tree = coupled_tree(rng, tree) if coupled else tree
    plan, n = plan_tree(tree), len(tree.dofs)
    body = torch.tensor([plan.position[k] for k in range(bodies) for _ in range(4)])
    place = torch.tensor(rng.normal(size=(len(body), 3)) * 0.15)
    posture = PosturePrior(
        mean=torch.tensor(rng.normal(size=(n, frames)) * 0.1),
        precision=torch.tensor(rng.uniform(0.1, 2.0, size=(n, frames))),
        lower=torch.full((n, 1), -0.5, dtype=torch.float64),
        upper=torch.full((n, 1), 0.4, dtype=torch.float64),
        limit_precision=7.0,
    )
    weight = torch.tensor(rng.uniform(0.5, 1.5, size=(len(body), frames))) / noise**2
    weight[torch.tensor(rng.random(weight.shape) < 0.1)] = 0.0
    problem = MarkerProblem(
        plan, random_prior(rng, geometry, bodies), body, torch.zeros(len(body), 3, frames, dtype=torch.float64), weight,
        place, torch.full_like(place, 0.02), torch.tensor(sorted(rng.permutation(len(body))[:6])), posture, robust,
    )  # fmt: skip
    q = torch.tensor(rng.normal(size=(n, frames)) * 0.3)
    xi = problem.xi_mean + 0.02 * torch.tensor(rng.normal(size=len(problem.xi_mean)))
    _, p, _ = problem.residual(q, xi)
    target = torch.where((weight > 0)[:, None], p + noise * torch.tensor(rng.normal(size=p.shape)), 0.0)
    return MarkerProblem(**{**problem.__dict__, "target": target}), q, xi


def random_prior(rng: np.random.Generator, geometry, bodies: int) -> GeometryPrior:
    """Single, tied and mixed parameters (an offset of one body with one of another; two axes of one body; hinges)."""
    raw = torch.cat([geometry.offset.reshape(-1), geometry.hinge])
    rows = [{3 + k: 1.0} for k in range(3 * (bodies - 1)) if rng.random() < 0.6]
    rows += [{3 * (bodies - 1): 0.5, 3 * (bodies - 2) + 1: -0.5}, {3: 1.0, 4: 0.3}]
    rows += [{3 * bodies + k: 1.0} for k in range(1, len(geometry.hinge))]
    if len(geometry.hinge):
        rows.append({3 * bodies: 1.0, 5: 0.1})
    matrix = torch.zeros(len(raw), len(rows), dtype=torch.float64)
    for k, row in enumerate(rows):
        for entry, value in row.items():
            matrix[entry, k] = value
    mean = torch.tensor(rng.normal(size=len(rows)) * 0.1)
    names = tuple(f"xi{k}" for k in range(len(rows)))
    sd = torch.full((len(rows),), 0.05, dtype=torch.float64)
    return GeometryPrior(names, ("m",) * len(rows), mean, sd, matrix, raw - matrix @ mean, len(geometry.hinge))


def retracted(q: torch.Tensor, row: int, step: float, retract) -> torch.Tensor:
    """q moved along one coordinate in all frames."""
    dq = torch.zeros_like(q)
    dq[row] = step
    return retract(q, dq)
