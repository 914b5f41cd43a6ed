"""This module chooses between the postures that explain a frame about alike the ones that a body can run through.

A frame by itself may have several: few markers near the axis of a forearm allow two turns about it, an arm whose upper
half is lost two elbows, and where a model lacks a freedom (shoulders that rise with the arms), giving up the markers of
the shoulders or those of the pelvis can cost about the same. Each frame near a break is solved again from the postures
of frames around it, and of all that is found the sequence with the least sum of costs and breaks is taken (Viterbi,
IEEE Trans Inf Theory 13:260 (1967)).
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.problem import MarkerProblem
from torchid.kinematics.recursion import Poses, lengths
from torchid.runs import dilate

TURN = 0.35
"""A segment that turns by more than this from one frame to the next breaks off [rad]; chosen, as markers 60 mm apart
may feign as much when one is off by 20 mm."""
LEAP = 0.03
"""A modelled marker breaks off whose way from the measured one changes by more than this [m]; chosen. A label that
jumps does the same to all postures of a frame."""
APART_S = (0.01, 0.04, 0.16, 0.64)
"""Frames are solved again from those so long before and after them; chosen. With 0.27 s at most, most breaks
of a child's arm stayed."""
ROUNDS = 3
"""Times that this is done, each beginning from the postures of the one before; chosen."""


@dataclass
class _Tried:
    """Postures that were found for frames, each from a start, so that none is looked for twice."""

    start: Float[Tensor, "starts dofs frames"]
    """Start of each; NaN where there was none."""
    way: Float[Tensor, "starts dofs frames"]
    """Posture that was found from it."""
    cost: Float[Tensor, "starts frames"]
    """Cost of that posture."""

    @classmethod
    def none(cls, q: Float[Tensor, "dofs frames"], starts: int) -> "_Tried":
        """Return what is known before any was looked for."""
        empty = q.new_full((starts, *q.shape), torch.nan)
        return cls(empty, empty.clone(), empty[:, 0].clone())

    def from_starts(
        self, problem: MarkerProblem, starts: Float[Tensor, "starts dofs some"], some: Tensor, xi: Tensor
    ) -> tuple[Float[Tensor, "starts dofs some"], Float[Tensor, "starts some"]]:
        """Return the postures of some frames from each start, and their costs."""
        which, at = (starts != self.start[:, :, some]).any(1).nonzero(as_tuple=True)
        if len(which):
            begun, frames = starts[which, :, at].T, some[at]
            solved, cost = solve_poses(problem.frames(frames), begun, xi)
            self.start[which, :, frames], self.way[which, :, frames] = begun.T, solved.T
            self.cost[which, frames] = cost
        return self.way[:, :, some], self.cost[:, some]


def continuous(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    rate_hz: float,
    near: Float[Tensor, "dofs frames"] | None = None,
) -> Float[Tensor, "dofs frames"]:
    """Return postures without breaks, as far as the markers let them.

    Args:
        problem: consecutive frames of one trial.
        q: postures of all frames, each found by itself.
        rate_hz: frame rate [Hz].
        near: postures that followed nearly these markers; no fewer breaks are looked for than they have.

    Returns:
        The postures of all frames; those far from any break are as given.
    """
    # Chosen: with three and ten times as much, five trials of two children kept nearly the same breaks.
    price = float(problem.frame_cost(q, xi).median())
    apart = sorted({max(1, round(s * rate_hz)) for s in APART_S})
    steps = [k for d in apart for k in (-d, d)]
    tried, least = _Tried.none(q, len(steps)), 0
    if near is not None:
        least, before = int(breaks(problem, near, xi).sum()), _Tried.none(q, 1)
        if int((broken := breaks(problem, q, xi)).sum()) > least:
            some = _around(broken, max(apart)).nonzero()[:, 0]
            q = _chosen(problem, q, xi, some, price, before.from_starts(problem, near[None, :, some], some, xi))
    for _ in range(ROUNDS):
        broken = breaks(problem, q, xi)
        if int(broken.sum()) <= least:
            break
        some = _around(broken, max(apart)).nonzero()[:, 0]
        starts = torch.stack([q[:, (some + k).clamp(0, q.shape[1] - 1)] for k in steps])
        q = _chosen(problem, q, xi, some, price, tried.from_starts(problem, starts, some, xi))
    return q


def _chosen(
    problem: MarkerProblem, q: Tensor, xi: Tensor, some: Tensor, price: float, others: tuple[Tensor, Tensor]
) -> Float[Tensor, "dofs frames"]:
    """Return postures in which some frames follow the cheapest sequence of their own and others that were found for
    them."""
    found, last = q.clone(), q.shape[1] - 1
    ways = torch.cat([q[None, :, some], others[0]])
    costs = torch.cat([problem.frames(some).frame_cost(q[:, some], xi)[None], others[1]])
    for run in _runs(some):
        cost, at = costs[:, run], some[run]
        # What goes on unbroken before and behind is tied to it.
        cost[1:, [k for k in (0, len(at) - 1) if 0 < at[k] < last]] = torch.inf
        best = _cheapest(cost, price, _breaks_between(problem.frames(at), ways[..., run], xi))
        found[:, at] = ways[best, :, some.new_tensor(range(run.start, run.stop))].T
    return found


def breaks(problem: MarkerProblem, q: Float[Tensor, "dofs frames"], xi: Float[Tensor, " xi"]) -> Bool[Tensor, " steps"]:
    """Return the steps from one frame to the next in which the model breaks off.

    Args:
        problem: consecutive frames of one trial.
        q: postures of all frames.
    """
    at, _, residual = problem.residual(q, xi)
    seen = problem.weight > 0
    return _breaks_off(at.R[..., :-1], at.R[..., 1:], residual[..., :-1], residual[..., 1:], seen[:, :-1] & seen[:, 1:])


def _breaks_off(R: Tensor, then: Tensor, residual: Tensor, later: Tensor, seen: Tensor) -> Bool[Tensor, " steps"]:
    """Return where rotations (bodies, 3, 3, steps) or residuals (markers, 3, steps) change too much."""
    turned = ((R * then).sum((1, 2)) < 1.0 + 2.0 * np.cos(TURN)).any(0)
    return turned | ((lengths(later - residual) > LEAP) & seen).any(0)


def _around(broken: Bool[Tensor, " steps"], frames: int) -> Bool[Tensor, " frames"]:
    """Return frames within so many of a break, and one more on either side."""
    beside = torch.nn.functional.pad(broken, (1, 0)) | torch.nn.functional.pad(broken, (0, 1))
    return dilate(beside, frames + 1)


def _runs(some: Tensor) -> list[slice]:
    """Return the parts of ascending frame numbers that follow each other."""
    edges = [0, *((some.diff() > 1).nonzero()[:, 0] + 1).tolist(), len(some)]
    return [slice(a, b) for a, b in zip(edges, edges[1:], strict=False)]


def _breaks_between(
    problem: MarkerProblem, ways: Float[Tensor, "ways dofs frames"], xi: Float[Tensor, " xi"]
) -> Bool[Tensor, "ways ways steps"]:
    """Return whether the step from one way of a frame to another way of the next is a break."""
    each: list[tuple[Poses, Tensor]] = []
    for way in ways:
        at, _, residual = problem.residual(way, xi)
        each.append((at, residual))
    seen = problem.weight > 0
    both = seen[:, :-1] & seen[:, 1:]
    return torch.stack([
        torch.stack([_breaks_off(a.R[..., :-1], b.R[..., 1:], r[..., :-1], s[..., 1:], both) for b, s in each])
        for a, r in each
    ])  # fmt: skip


def _cheapest(cost: Float[Tensor, "ways frames"], price: float, broken: Bool[Tensor, "ways ways steps"]) -> Tensor:
    """Return the way of each frame in the sequence with the least sum of costs and of breaks, each at its price."""
    own, step = cost.cpu().numpy(), price * broken.double().cpu().numpy()
    total, came = own[:, 0], []
    for k in range(step.shape[2]):
        sums = total[:, None] + step[:, :, k]
        came.append(sums.argmin(0))
        total = sums.min(0) + own[:, k + 1]
    best = [int(total.argmin())]
    for before in reversed(came):
        best.append(int(before[best[-1]]))
    return torch.tensor(best[::-1], device=cost.device)
