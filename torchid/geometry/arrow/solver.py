"""Levenberg-Marquardt on all frames and everything they share, through the arrow's Schur complement.

The normal matrix is an arrow: one small block per frame and one border for xi. The blocks are factorised in a batch,
V = L^-1 [H_qx g_q] takes one triangular solve, and xi comes from H_xx - V'V. Damping is per frame and driven by the
frame's own model error: near the joint optimum the cost of half the frames rightly rises, and damping them for it
cost fifty iterations instead of five. Blocks of the first steps are in single precision, for half the time; sums over
frames, cost and point are in the input's, and so are the last steps, which weak directions of few frames need.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.arrow.coarse_to_fine import LEAST, STRIDE, better_start, between, coarse_frames, coarse_problem
from torchid.geometry.arrow.elimination import back_substitute, eliminate, reduce_shared
from torchid.geometry.arrow.index_tables import Layout, make_layout
from torchid.geometry.arrow.inverse_kinematics import LEAST_DAMPING, STEP, solve_poses
from torchid.geometry.arrow.limb_partition import Partition, make_partition
from torchid.geometry.arrow.normal_blocks import make_pieces, shared_block, shared_curve
from torchid.geometry.problem import MarkerProblem, retract

log = logging.getLogger(__name__)
OnIteration = Callable[[int, float], None]
CHUNK = 1024
"""Frames per batch: smaller ones pay for calls, larger ones leave the cache."""
SHARES = (0.4, 0.15)
"""Of a step that fails, tried one after the other."""
DAMPING, FINE = 1e-3, 1e-6
"""Of the first step, from a cold start and from the coarse solution."""
SINGLE = 1e-4
"""Relative fall of the cost below which steps are in the problem's precision."""
ALONE = 4
"""Iterations of inverse kinematics between the coarse and the fine problem."""
COARSE = 1e-3
"""Relative fall of their cost at which these poses are good enough."""
SCATTER = 0.3
"""Fall of the coarse problem's cost, per entry of xi, that is good enough: the frames left out move it by more."""


@dataclass(frozen=True)
class Solution:
    """Where a solver stopped."""

    q: Float[Tensor, "dofs frames"]
    xi: Float[Tensor, " xi"]
    cost: float
    iterations: int
    converged: bool
    trace: tuple[float, ...]
    """Cost at the start and after every accepted step."""


@dataclass
class _Damping:
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
    """Minimise over q and xi.

    Args:
        problem: markers, weights and priors.
        q, xi: start.
        iterations: limit.
        tolerance: relative fall of the cost at which to stop.
        progress: called with the iteration and the cost.
    """
    start = Solution(q, xi, _cost(problem, q, xi), 0, False, ())
    if q.shape[1] < LEAST * STRIDE:
        return _twice(problem, start, DAMPING, iterations, tolerance, progress)
    few = coarse_frames(q)
    part = coarse_problem(problem, few)
    rough = Solution(q[:, few], xi, _cost(part, q[:, few], xi), 0, False, ())
    rough = _descend(part, rough, DAMPING, iterations, tolerance, None, STEP, SCATTER * len(xi))
    q_better = better_start(problem, q, between(rough.q, few, q.shape[1]), rough.xi)
    # A few frames astray cost the joint descent three to five of its steps; alone they are soon home.
    q_better, cost = solve_poses(problem, q_better, rough.xi, ALONE, COARSE)
    better = Solution(q_better, rough.xi, float(cost.sum()) + problem.xi_cost(rough.xi), rough.iterations, False, ())
    if better.cost < start.cost:
        return _twice(problem, better, FINE, iterations, tolerance, progress)
    return _twice(problem, start, DAMPING, iterations, tolerance, progress)


def _twice(
    problem: MarkerProblem,
    start: Solution,
    first_damping: float,
    iterations: int,
    tolerance: float,
    progress: OnIteration | None,
) -> Solution:
    """Steps in single precision as long as they help much, then in the problem's."""
    near = _descend(problem, start, first_damping, iterations, max(tolerance, SINGLE), progress, STEP)
    left = iterations - (near.iterations - start.iterations)
    if tolerance >= SINGLE or left <= 0:
        return near
    return _descend(problem, near, FINE, left, tolerance, progress, near.q.dtype)


def _cost(problem: MarkerProblem, q: Tensor, xi: Tensor) -> float:
    return float(_frame_cost(problem, q, xi).sum()) + problem.xi_cost(xi)


def _frame_cost(problem: MarkerProblem, q: Tensor, xi: Tensor) -> Tensor:
    """Cost of each frame, in chunks."""
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
    """Steps until the cost falls by less than ``enough`` or, relative to itself, ``tolerance``."""
    q, xi, cost = start.q, start.xi, start.cost
    layout = make_layout(problem, dtype)
    partition = make_partition(problem.plan, layout, len(xi))
    damping = _Damping(q.new_full((q.shape[1],), first_damping))
    trace, rejected, step = [*start.trace] or [cost], 0, 0
    for step in range(1, iterations + 1):
        dq, dxi, error = _step(problem, layout, partition, q, xi, damping)
        trial = _follow(problem, (q, dq), (xi, dxi), cost)
        eta = error(trial.frames)
        if trial.cost <= cost:
            fall, q, xi, cost = (cost - trial.cost) / max(cost, 1e-300), trial.q, trial.xi, trial.cost
            damping.frame = _relax(damping.frame, eta)
            damping.shared, rejected = max(damping.shared / 10.0, 1e-9), 0
            trace.append(cost)
        else:
            fall, rejected = (trial.cost - cost) / max(cost, 1e-300), rejected + 1
            damping.frame = torch.where(eta > 0.25, damping.frame * 10.0 + 1e-4, damping.frame * 2.0)
            damping.shared = damping.shared * 10.0 + 1e-6
        if progress:
            progress(step, cost)
        log.debug("arrow %d: cost %.6g, change %.1e, rejected %d", step, cost, fall, rejected)
        if (fall < max(tolerance, enough / max(cost, 1e-300)) and rejected in (0, 3)) or rejected > 12:
            break
    return Solution(q, xi, cost, start.iterations + step, rejected <= 3 and step < iterations, tuple(trace))


@dataclass(frozen=True)
class _Trial:
    """Where a step, or a share of it, leads."""

    q: Tensor
    xi: Tensor
    frames: Tensor
    """Cost of each frame after the whole step."""
    cost: float


def _follow(problem: MarkerProblem, q: tuple[Tensor, Tensor], xi: tuple[Tensor, Tensor], cost: float) -> _Trial:
    """The step (point, step), or the longest of some shares of it that lowers the cost; else the whole step.

    A step too long in a weak direction of xi misleads all frames at once: a look at the cost of a shorter one takes a
    tenth of the time of new blocks. (Settling the poses at the long step's xi instead took longer: the step is wrong
    about xi too.)
    """
    whole = last = _trial(problem, q, xi, 1.0)
    for share in SHARES:
        if last.cost <= cost:
            return replace(last, frames=whole.frames)
        last = _trial(problem, q, xi, share)
    return replace(last, frames=whole.frames) if last.cost <= cost else whole


def _trial(problem: MarkerProblem, q: tuple[Tensor, Tensor], xi: tuple[Tensor, Tensor], share: float) -> _Trial:
    q_new, xi_new = retract(q[0], share * q[1]), xi[0] + share * xi[1]
    frames = _frame_cost(problem, q_new, xi_new)
    return _Trial(q_new, xi_new, frames, float(frames.sum()) + problem.xi_cost(xi_new))


def _relax(damping: Tensor, eta: Tensor) -> Tensor:
    grown = torch.where(eta > 0.75, damping * 8.0 + 1e-4, torch.where(eta < 0.25, damping / 10.0, damping))
    return grown.clamp(min=LEAST_DAMPING)


def _step(
    problem: MarkerProblem, layout: Layout, partition: Partition, q: Tensor, xi: Tensor, damping: _Damping
) -> tuple[Tensor, Tensor, Callable[[Tensor], Tensor]]:
    """One damped Gauss-Newton step; also a function that rates each frame's model error from its new cost."""
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
    L = _positive(H_xx + reduced + torch.diag(precision), torch.diagonal(H_xx) + precision, damping)
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
        # Where the other frames together are as predicted, only those that went astray are at fault. Rated alone,
        # frames were damped ever more and held xi back, 0.5 % of the cost above the optimum.
        eta = missed / size
        sound = eta <= 1.0
        fine = missed[sound].sum().abs() < 0.25 * size[sound].sum()
        return torch.where(sound & fine, 0.0, eta)

    return dq, dxi, error


def _positive(S: Tensor, scale: Tensor, damping: _Damping) -> Tensor:
    L, info = torch.linalg.cholesky_ex(S + torch.diag(damping.shared * scale))
    while int(info) != 0:
        damping.shared = damping.shared * 10.0 + 1e-6
        L, info = torch.linalg.cholesky_ex(S + torch.diag(damping.shared * scale))
    return L
