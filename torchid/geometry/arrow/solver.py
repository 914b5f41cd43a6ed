"""This module is Levenberg-Marquardt on all frames and all that they share, through the arrow's Schur complement.

The normal matrix is an arrow: one small block per frame and one border for xi. The blocks are factorised in a batch,
V = L^-1 [H_qx g_q] takes one triangular solve, and xi comes from H_xx - V'V. Damping is per frame and driven by the
frame's own model error, because near the joint optimum the cost of half the frames rightly rises. Blocks of the first
steps are in single precision, for half the time; sums over frames, cost and point are in the input's, and so are the
last steps, which weak directions of few frames need.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow.coarse_to_fine import FEWEST, STRIDE, better_start, between, coarse_frames, coarse_problem
from torchid.geometry.arrow.elimination import back_substitute, eliminate, reduce_shared
from torchid.geometry.arrow.index_tables import ArrowLayout, make_layout
from torchid.geometry.arrow.inverse_kinematics import LEAST_DAMPING, STEP_DTYPE, solve_poses
from torchid.geometry.arrow.limb_partition import Partition, make_partition
from torchid.geometry.arrow.normal_blocks import make_pieces, shared_block, shared_curve
from torchid.geometry.problem import MarkerProblem, retract

log = logging.getLogger(__name__)
OnIteration = Callable[[int, float], None]
"""Callback of a solver, called with the iteration and the cost."""
CHUNK = 1024
"""Frames per batch; chosen, because smaller ones pay for calls and larger ones leave the cache."""
STEP_SHARES = (0.4, 0.15)
"""Shares of a step that fails, tried one after the other; chosen."""
COLD_DAMPING, WARM_DAMPING = 1e-3, 1e-6
"""Damping of the first step from a cold start, and from the coarse solution; chosen."""
SINGLE_TOLERANCE = 1e-4
"""Relative fall of the cost below which steps are in the problem's precision; chosen."""
POSES_ITERATIONS = 4
"""Iterations of inverse kinematics between the coarse and the fine problem; chosen."""
POSES_TOLERANCE = 1e-3
"""Relative fall of their cost at which these poses are good enough; chosen."""
COARSE_FALL = 0.3
"""Fall of the coarse cost, per entry of xi, that is good enough; chosen, as the frames left out move it by more."""


@dataclass(frozen=True)
class Solution:
    """The point at which a solver stopped."""

    q: Float[Tensor, "dofs frames"]
    xi: Float[Tensor, " xi"]
    cost: float
    """Cost of markers, postures and the prior on xi."""
    iterations: int
    """Steps taken, or evaluations of LBFGS."""
    converged: bool
    trace: tuple[float, ...]
    """Cost at the start and after every accepted step; of Adam and LBFGS, at every evaluation."""


@dataclass
class _Damping:
    """The damping of each frame's block (frames,) and of the border, relative to the diagonal."""

    frame: Tensor
    shared: float = 1e-9


def solve_arrow(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    iterations: int = 60,
    tolerance: float = 1e-6,
    progress: OnIteration | None = None,
) -> Solution:
    """Minimise the cost of a problem over q and xi together.

    Args:
        q: coordinates to start from.
        xi: geometry and marker places to start from.
        iterations: most steps.
        tolerance: relative fall of the cost at which to stop.

    Returns:
        The last point; not converged if the steps ran out or no step lowered the cost any more.
    """
    start = Solution(q, xi, _cost(problem, q, xi), 0, False, ())
    if q.shape[1] < FEWEST * STRIDE:
        return _descend_in_two_precisions(problem, start, COLD_DAMPING, iterations, tolerance, progress)
    few = coarse_frames(q)
    part = coarse_problem(problem, few)
    rough = Solution(q[:, few], xi, _cost(part, q[:, few], xi), 0, False, ())
    rough = _descend(part, rough, COLD_DAMPING, iterations, tolerance, None, STEP_DTYPE, COARSE_FALL * len(xi))
    q_better = better_start(problem, q, between(rough.q, few, q.shape[1]), rough.xi)
    # Frames that the interpolation led astray are soon home alone, and would hold up the joint descent.
    q_better, cost = solve_poses(problem, q_better, rough.xi, POSES_ITERATIONS, POSES_TOLERANCE)
    better = Solution(q_better, rough.xi, float(cost.sum()) + problem.xi_cost(rough.xi), rough.iterations, False, ())
    if better.cost < start.cost:
        return _descend_in_two_precisions(problem, better, WARM_DAMPING, iterations, tolerance, progress)
    return _descend_in_two_precisions(problem, start, COLD_DAMPING, iterations, tolerance, progress)


def _descend_in_two_precisions(
    problem: MarkerProblem,
    start: Solution,
    first_damping: float,
    iterations: int,
    tolerance: float,
    progress: OnIteration | None,
) -> Solution:
    """Descend in single precision as long as the steps help much, then in the problem's precision."""
    near = _descend(problem, start, first_damping, iterations, max(tolerance, SINGLE_TOLERANCE), progress, STEP_DTYPE)
    left = iterations - (near.iterations - start.iterations)
    if tolerance >= SINGLE_TOLERANCE or left <= 0:
        return near
    return _descend(problem, near, WARM_DAMPING, left, tolerance, progress, near.q.dtype)


def _cost(problem: MarkerProblem, q: Tensor, xi: Tensor) -> float:
    """Return the cost of markers, postures and the prior on xi."""
    return float(_frame_cost(problem, q, xi).sum()) + problem.xi_cost(xi)


def _frame_cost(problem: MarkerProblem, q: Tensor, xi: Tensor) -> Tensor:
    """Return the cost of each frame (frames,), evaluated in chunks."""
    parts = [slice(start, start + CHUNK) for start in range(0, q.shape[1], CHUNK)]
    shape = problem.shape(xi)
    return torch.cat([problem.frames(part).evaluate(q[:, part], shape).cost for part in parts])


def _descend(
    problem: MarkerProblem,
    start: Solution,
    first_damping: float,
    iterations: int,
    tolerance: float,
    progress: OnIteration | None,
    dtype: torch.dtype,
    enough: float = 0.0,
) -> Solution:
    """Step until the cost falls by less than ``enough`` or, relative to itself, ``tolerance``."""
    q, xi, cost = start.q, start.xi, start.cost
    layout = make_layout(problem, dtype)
    partition = make_partition(problem.plan, layout, len(xi))
    damping = _Damping(q.new_full((q.shape[1],), first_damping))
    trace, rejected, step = [*start.trace] or [cost], 0, 0
    for step in range(1, iterations + 1):
        dq, dxi, error = _step(problem, layout, partition, q, xi, damping)
        attempt = _backtrack(problem, (q, dq), (xi, dxi), cost)
        eta = error(attempt.frames)
        if attempt.cost <= cost:
            fall, q, xi, cost = (cost - attempt.cost) / max(cost, 1e-300), attempt.q, attempt.xi, attempt.cost
            damping.frame = _next_damping(damping.frame, eta)
            damping.shared, rejected = max(damping.shared / 10.0, 1e-9), 0
            trace.append(cost)
        else:
            fall, rejected = (attempt.cost - cost) / max(cost, 1e-300), rejected + 1
            damping.frame = torch.where(eta > 0.25, damping.frame * 10.0 + 1e-4, damping.frame * 2.0)
            damping.shared = damping.shared * 10.0 + 1e-6
        if progress:
            progress(step, cost)
        log.debug("arrow %d: cost %.6g, change %.1e, rejected %d", step, cost, fall, rejected)
        if (fall < max(tolerance, enough / max(cost, 1e-300)) and rejected in (0, 3)) or rejected > 12:
            break
    return Solution(q, xi, cost, start.iterations + step, rejected <= 3 and step < iterations, tuple(trace))


@dataclass(frozen=True)
class _Attempt:
    """The point to which a step, or a share of it, leads."""

    q: Tensor
    xi: Tensor
    frames: Tensor
    """Cost of each frame after the whole step."""
    cost: float


def _backtrack(problem: MarkerProblem, q: tuple[Tensor, Tensor], xi: tuple[Tensor, Tensor], cost: float) -> _Attempt:
    """Take the whole step, or the longest of some shares of it that lowers the cost; if none does, the whole step.

    A step too long in a weak direction of xi misleads all frames at once, and the cost of a shorter one takes far less
    time than new blocks (`docs/decisions.md`, Geometry).

    Args:
        q: coordinates and their step.
        xi: geometry and marker places, and their step.
        cost: cost before the step.
    """
    whole = last = _attempt(problem, q, xi, 1.0)
    for share in STEP_SHARES:
        if last.cost <= cost:
            return replace(last, frames=whole.frames)
        last = _attempt(problem, q, xi, share)
    return replace(last, frames=whole.frames) if last.cost <= cost else whole


def _attempt(problem: MarkerProblem, q: tuple[Tensor, Tensor], xi: tuple[Tensor, Tensor], share: float) -> _Attempt:
    """Return the point after some share of a step; arguments are those of ``_backtrack``."""
    q_new, xi_new = retract(q[0], share * q[1]), xi[0] + share * xi[1]
    frames = _frame_cost(problem, q_new, xi_new)
    return _Attempt(q_new, xi_new, frames, float(frames.sum()) + problem.xi_cost(xi_new))


def _next_damping(damping: Tensor, eta: Tensor) -> Tensor:
    """Return each frame's damping after an accepted step, by its model error ``eta`` (frames,)."""
    grown = torch.where(eta > 0.75, damping * 8.0 + 1e-4, torch.where(eta < 0.25, damping / 10.0, damping))
    return grown.clamp(min=LEAST_DAMPING)


def _step(
    problem: MarkerProblem, layout: ArrowLayout, partition: Partition, q: Tensor, xi: Tensor, damping: _Damping
) -> tuple[Tensor, Tensor, Callable[[Tensor], Tensor]]:
    """Compute one damped Gauss-Newton step.

    Returns:
        The step of q (dofs, frames), the step of xi, and a function that gives each frame's model error (frames,),
        relative to its quadratic term, from the frames' new cost.
    """
    n = len(xi)
    entries, reduced, rhs = xi.new_zeros(len(layout.entries), len(layout.entries)), xi.new_zeros(n, n), xi.new_zeros(n)
    dtype = layout.subtree.dtype
    kept, cost, shape = [], q.new_empty(q.shape[1]), problem.shape(xi)
    for start in range(0, q.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        piece = problem.frames(part)
        pieces = make_pieces(piece, layout, piece.evaluate(q[:, part], shape), shared=True)
        eliminated = eliminate(partition, pieces, damping.frame[part].to(dtype))
        entries += shared_block(layout, pieces)
        rhs += eliminated.g_x.sum(0)
        reduce_shared(partition, eliminated, reduced, rhs)
        cost[part] = pieces.cost
        kept.append((part, pieces, eliminated))
    fold = torch.nn.functional.one_hot(layout.entry_xi, n).to(xi)[:, partition.xi]
    H_xx, precision = fold.T @ entries @ fold, problem.xi_precision[partition.xi]
    rhs += precision * (xi - problem.xi_mean)[partition.xi]
    L = _factorise_shared(H_xx + reduced + torch.diag(precision), torch.diagonal(H_xx) + precision, damping)
    dx = -torch.cholesky_solve(rhs[:, None], L)[:, 0]
    dq, dxi = torch.empty_like(q), torch.empty_like(xi)
    predicted, curvature = torch.empty_like(cost), torch.empty_like(cost)
    dxi[partition.xi] = dx
    for part, pieces, eliminated in kept:
        d, fall, quadratic = back_substitute(partition, eliminated, dx.to(dtype))
        alone = shared_curve(layout, pieces, dxi.to(dtype))
        dq[partition.dof_rows, part] = d.T.to(dq)
        predicted[part], curvature[part] = cost[part] - fall + alone, quadratic + alone

    def error(new: Tensor) -> Tensor:
        missed, size = new - predicted, curvature.abs() + 1e-5 * new.mean()
        # Where the other frames together are as predicted, only those that went astray are at fault. Frames rated
        # each alone would be damped ever more and hold xi back.
        eta, sound = missed / size, missed <= size
        fine = missed[sound].sum().abs() < 0.25 * size[sound].sum()
        return torch.where(sound & fine, 0.0, eta)

    return dq, dxi, error


def _factorise_shared(S: Tensor, scale: Tensor, damping: _Damping) -> Tensor:
    """Factorise the border's Schur complement, its damping raised in place until it is positive definite."""
    L, info = torch.linalg.cholesky_ex(S + torch.diag(damping.shared * scale))
    while int(info) != 0:
        damping.shared = damping.shared * 10.0 + 1e-6
        L, info = torch.linalg.cholesky_ex(S + torch.diag(damping.shared * scale))
    return L
