"""Adam and LBFGS on the pytorch-kinematics chain: the same problem by first-order means."""

import torch
from torch import Tensor

from torchid.geometry.arrow.solver import OnIteration, Solution
from torchid.geometry.problem import MarkerProblem
from torchid.kinematics.chain import chain_points

CHUNK = 512
Q_STEP, XI_STEP = 0.02, 0.005
"""Learning rates of Adam [rad or m]; the best of a grid on synthetic subjects."""
Q_SCALE = 0.05
"""Unit of q for LBFGS [rad or m]: 500 evaluations end 0.1 % above the optimum of a small problem, with 1 rad 5 %."""


def chain_cost(problem: MarkerProblem, q: Tensor, xi: Tensor, part: slice) -> Tensor:
    """Cost of some frames through the chain, differentiable in q (dofs, frames) and xi."""
    piece = problem.frames(part)
    geometry, place = problem.split(xi)
    body = torch.tensor(problem.plan.order, device=q.device)[problem.body]
    p = chain_points(problem.plan.tree, q[:, part].T, geometry, body, place)
    residual = p.permute(1, 2, 0) - piece.target
    return piece.robust_cost(residual)[0].sum() + piece.posture.pull(q[:, part])[0].sum()


def chain_residual(problem: MarkerProblem, q: Tensor, xi: Tensor) -> Tensor:
    """Marker residuals (markers, 3, frames) through the chain."""
    geometry, place = problem.split(xi)
    body = torch.tensor(problem.plan.order, device=q.device)[problem.body]
    p = chain_points(problem.plan.tree, q.T, geometry, body, place)
    return p.permute(1, 2, 0) - problem.target


def accumulate_gradients(problem: MarkerProblem, q: Tensor, xi: Tensor) -> float:
    """Add the gradients of the whole cost to the leaves q (dofs, frames) and xi, chunk by chunk, and return the cost.

    Every chunk frees its graph; q and xi must therefore be leaves.
    """
    assert q.is_leaf and xi.is_leaf, "a graph in front of q or xi would be freed by the first chunk"
    total = 0.0
    for start in range(0, q.shape[1], CHUNK):
        cost = chain_cost(problem, q, xi, slice(start, start + CHUNK))
        cost.backward()
        total += float(cost.detach())
    prior = 0.5 * (problem.xi_precision * (xi - problem.xi_mean).square()).sum()
    prior.backward()
    return total + float(prior.detach())


def solve_adam(
    problem: MarkerProblem, q: Tensor, xi: Tensor, iterations: int = 2000, progress: OnIteration | None = None
) -> Solution:
    """Minimise with Adam on a cosine schedule; the best point met is returned."""
    q, xi = q.clone().requires_grad_(), xi.clone().requires_grad_()
    optimiser = torch.optim.Adam([{"params": [q], "lr": Q_STEP}, {"params": [xi], "lr": XI_STEP}], betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    best, kept, trace = float("inf"), (q.detach().clone(), xi.detach().clone()), []
    for k in range(iterations):
        optimiser.zero_grad()
        cost = accumulate_gradients(problem, q, xi)
        trace.append(cost)
        if cost < best:
            best, kept = cost, (q.detach().clone(), xi.detach().clone())
        optimiser.step()
        schedule.step()
        if progress:
            progress(k + 1, cost)
    return Solution(*kept, best, iterations, True, tuple(trace))


def solve_lbfgs(
    problem: MarkerProblem, q: Tensor, xi: Tensor, iterations: int = 2000, progress: OnIteration | None = None
) -> Solution:
    """Minimise with LBFGS and a strong-Wolfe line search, xi scaled by its prior scatter and q by ``Q_SCALE``."""
    scale = problem.xi_precision.rsqrt()
    y, z = (q / Q_SCALE).requires_grad_(), (xi / scale).requires_grad_()
    trace: list[float] = []

    def closure() -> float:
        q, xi = (y.detach() * Q_SCALE).requires_grad_(), (z.detach() * scale).requires_grad_()
        trace.append(accumulate_gradients(problem, q, xi))
        assert q.grad is not None and xi.grad is not None
        y.grad, z.grad = q.grad * Q_SCALE, xi.grad * scale
        if progress:
            progress(len(trace), trace[-1])
        return trace[-1]

    optimiser = torch.optim.LBFGS(
        [y, z], lr=1.0, max_iter=iterations, max_eval=iterations, history_size=30, line_search_fn="strong_wolfe",
        tolerance_grad=1e-9, tolerance_change=1e-12,
    )  # fmt: skip
    optimiser.step(closure)
    q, xi = y.detach() * Q_SCALE, z.detach() * scale
    cost = float(problem.frame_cost(q, xi).sum()) + problem.xi_cost(xi)
    return Solution(q, xi, cost, len(trace), len(trace) < iterations, tuple(trace))
