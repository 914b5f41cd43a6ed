"""This module solves the marker problem with Adam and LBFGS on the pytorch-kinematics chain.

The chain is independent of the arrow solver, which is tested against it.
"""

import torch
from torch import Tensor

from torchid.geometry.arrow.solver import OnIteration, Solution
from torchid.geometry.problem import MarkerProblem
from torchid.kinematics.chain import chain_points

CHUNK = 512
"""Frames whose graph is held at a time; chosen for memory."""
Q_STEP, XI_STEP = 0.02, 0.005
"""Learning rates of Adam for q and xi [rad or m]; calibrated as the best of a grid on synthetic subjects."""
Q_SCALE = 0.05
"""Unit of q for LBFGS [rad or m]; calibrated (`docs/decisions.md`, Geometry)."""


def chain_cost(problem: MarkerProblem, q: Tensor, xi: Tensor, part: slice) -> Tensor:
    """Return the cost of some frames through the chain, differentiable in q and xi.

    Args:
        problem: markers, weights and priors of all frames.
        q: coordinates of all frames (dofs, frames).
        part: frames to take.

    Returns:
        The cost of markers and postures, a scalar, without the prior on xi.
    """
    piece = problem.frames(part)
    return piece.robust_cost(chain_residual(piece, q[:, part], xi))[0].sum() + piece.posture.pull(q[:, part])[0].sum()


def chain_residual(problem: MarkerProblem, q: Tensor, xi: Tensor) -> Tensor:
    """Return the residuals of the markers through the chain, (markers, 3, frames) [m].

    Args:
        q: coordinates (dofs, frames).
    """
    geometry, place = problem.split(xi)
    body = torch.tensor(problem.plan.order, device=q.device)[problem.body]
    p = chain_points(problem.plan.tree, q.T, geometry, body, place)
    return p.permute(1, 2, 0) - problem.target


def accumulate_gradients(problem: MarkerProblem, q: Tensor, xi: Tensor) -> float:
    """Add the gradients of the whole cost to q and xi, chunk by chunk, and return the cost.

    Args:
        q: coordinates (dofs, frames), a leaf that requires a gradient, because every chunk frees its graph.
        xi: geometry and marker places, a leaf likewise.

    Returns:
        The cost of markers, postures and the prior on xi.
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
    """Minimise with Adam (Kingma & Ba 2015) on a cosine schedule of the learning rates.

    Args:
        q: coordinates to start from (dofs, frames).
        xi: geometry and marker places to start from.
        iterations: number of steps, all of which are taken.
        progress: called with the iteration and the cost.

    Returns:
        The point of the lowest cost that was met.
    """
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
    """Minimise with LBFGS (Liu & Nocedal 1989) and a strong-Wolfe line search.

    xi is scaled by its prior scatter and q by ``Q_SCALE``.

    Args:
        q: coordinates to start from (dofs, frames).
        xi: geometry and marker places to start from.
        iterations: limit of evaluations of the cost.
        progress: called with the number of evaluations and the cost.

    Returns:
        The last point; it has converged if the limit was not reached.
    """
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
