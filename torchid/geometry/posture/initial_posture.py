"""This module finds where the solvers start.

The root's pose comes in closed form, joints start at rest, and frames that went astray start again from others.
A joint's rotation is expressed by those of its equivalent angles that the joint can take.
"""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.kinematics.recursion import poses
from torchid.model.rotation import nearest_rotation, rotation_vector
from torchid.model.tree import BASE_DOFS, Tree

ASTRAY = 3.0
"""A frame whose cost per marker is this many times that of the best fiftieth restarts from a neighbour; chosen."""
CLIFF = 1.5
"""A frame whose cost per marker is this many times that of the frame beside it restarts from that one; chosen."""
EXAMPLES, STARTS, SPREAD = 4, 8, 0.5
"""Frames that are tried from drawn postures, number of these, and their scatter about rest [rad]; chosen."""
CLIMB = 200
"""Frames in a row that are regained at most, from either side; chosen."""


def initial_posture(problem: MarkerProblem, xi: Float[Tensor, " xi"], rest: Float[Tensor, " dofs"]) -> Tensor:
    """Return coordinates with the root's pose by weighted Procrustes (Umeyama 1991) and joints at rest.

    Markers of the root body count fully; those of its neighbours, taken at the resting pose, help with a hundredth
    of the weight, so that a frame with fewer than three root markers still gets a pose. A frame without any of them
    takes the pose of the nearest frame that has one.

    Returns:
        The coordinates (dofs, frames).
    """
    geometry, place = problem.split(xi)
    q = rest[:, None].expand(-1, problem.target.shape[2]).clone()
    q[:6] = 0.0
    at = poses(problem.plan, q[:, :1], geometry)
    R0 = at.R[problem.body, :, :, 0].mT
    model = (R0 @ place[:, :, None])[:, :, 0] + at.p[problem.body, :, 0]
    near = torch.where(problem.body == 0, 1.0, 1e-2 * (problem.body < problem.plan.levels[1].stop)).to(q)
    certainty = problem.place_sd.square().sum(1).add(1e-4).reciprocal()
    weight = (problem.weight > 0) * (near * certainty / certainty.max())[:, None]
    seen = weight.sum(0) > 0
    R, t = _procrustes(model, problem.target, torch.where(seen, weight, 1.0))
    q[:3], q[3:6] = t.T, rotation_vector(R).T
    return hold(q, seen)


def _procrustes(model: Tensor, target: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Return R (frames, 3, 3) and t (frames, 3) that bring (markers, 3) onto (markers, 3, frames)."""
    share = (weight / weight.sum(0)).T
    to = target.permute(2, 0, 1)
    centre_m, centre_t = share @ model, (share[:, :, None] * to).sum(1)
    H = torch.einsum("tm,tmi,tmj->tij", share, to - centre_t[:, None], model - centre_m[:, None])
    R = nearest_rotation(H)
    return R, centre_t - (R @ centre_m[:, :, None])[:, :, 0]


def evenly(frames: int, wanted: int) -> Int[Tensor, " chosen"]:
    """Return the indices of at most ``wanted`` of the frames, evenly spaced."""
    return torch.linspace(0, frames - 1, min(frames, wanted)).round().long()


def hold(q: Tensor, good: Tensor) -> Tensor:
    """Return q (dofs, frames) with every column that is not good (frames,) replaced by the nearest good one."""
    if bool(good.all()) or not bool(good.any()):
        return q
    known = good.nonzero()[:, 0]
    every = torch.arange(q.shape[1], device=q.device)
    right = torch.searchsorted(known, every).clamp(max=len(known) - 1)
    left = (right - 1).clamp(min=0)
    nearest = torch.where((known[right] - every).abs() < (every - known[left]).abs(), known[right], known[left])
    return torch.where(good, q, q[:, nearest])


def settle(problem: MarkerProblem, q: Tensor, xi: Tensor, rounds: int = 12) -> Tensor:
    """Solve inverse kinematics from q, and again from good neighbours where the cost stands out.

    Least squares comes first: from far away a redescending loss would take every raised arm for an outlier. A limb
    that was lost for a while is regained from both ends, a few frames in every round; joints that ended beyond their
    limits are turned back before they pass for good neighbours, and before a robust loss could give up their markers.

    Args:
        q: coordinates to start from (dofs, frames).
        rounds: most restarts from good neighbours.

    Returns:
        The coordinates (dofs, frames), with the problem's robust loss if it has one.
    """
    plain = replace(problem, robust=None)
    q, cost = solve_poses(plain, q, xi)
    _turn_back(plain, q, cost, xi)
    _exemplify(plain, q, cost, xi)
    seen = (problem.weight > 0).any(0)
    for _ in range(rounds):
        astray = _astray(problem, cost)
        if not bool(astray.any()) or bool(astray.all()):
            break
        index = astray.nonzero()[:, 0]
        if not _retried(plain, q, cost, xi, index, hold(q, seen & ~astray)[:, index]):
            break
    _climb(plain, q, cost, xi)
    _turn_back(plain, q, cost, xi)
    return q if problem.robust is None else solve_poses(problem, q, xi)[0]


def mended(problem: MarkerProblem, q: Tensor, xi: Tensor) -> Tensor:
    """Solve inverse kinematics from postures that are nearly right, without restarts from other frames.

    Least squares comes first here too: markers may have been corrected by more than a robust loss believes.

    Args:
        q: coordinates to start from (dofs, frames).
    """
    q, _ = solve_poses(replace(problem, robust=None), q, xi)
    return q if problem.robust is None else solve_poses(problem, q, xi)[0]


def _turn_back(problem: MarkerProblem, q: Tensor, cost: Tensor, xi: Tensor) -> None:
    """Solve frames with a joint beyond its limits again from its other angles; q and cost change in place."""
    other = turned_back(problem.plan.tree, problem.posture, q)
    index = (other != q).any(0).nonzero()[:, 0]
    if len(index):
        _retried(problem, q, cost, xi, index, other[:, index])


def _exemplify(problem: MarkerProblem, q: Tensor, cost: Tensor, xi: Tensor) -> None:
    """Solve all frames again from examples, if drawn postures fare better than they; q and cost change in place.

    Where a hand comes to rest turned round in every frame, none stands out and none is a good neighbour: the examples
    come from postures drawn about rest.
    """
    enough = _enough(problem).nonzero()[:, 0]
    chosen = enough[evenly(len(enough), EXAMPLES)]
    part, draw = problem.frames(chosen.repeat_interleave(STARTS)), torch.Generator().manual_seed(0)
    drawn = torch.randn(len(q), len(chosen) * STARTS, generator=draw, dtype=q.dtype).to(q.device)
    start = (part.posture.mean + SPREAD * drawn).clamp(part.posture.lower, part.posture.upper)
    start[:BASE_DOFS] = q[:BASE_DOFS, chosen].repeat_interleave(STARTS, dim=1)
    found, new = solve_poses(part, start, xi)
    new, best = new.view(len(chosen), STARTS).min(1)
    gained = CLIFF * new < cost[chosen]
    if not bool(gained.any()):
        return
    example, known = q.clone(), torch.zeros_like(cost, dtype=torch.bool)
    example[:, chosen] = found.view(len(q), len(chosen), STARTS).gather(2, best.expand(len(q), -1)[:, :, None])[:, :, 0]
    known[chosen[gained]] = True
    other = hold(example, known)
    other[:BASE_DOFS] = torch.where(known, other, q)[:BASE_DOFS]
    _retried(problem, q, cost, xi, torch.arange(len(cost), device=q.device), other)


def _enough(problem: MarkerProblem) -> Tensor:
    """Return the mask of frames with at least the median number of markers; the others are no measure of the cost."""
    seen = (problem.weight > 0).sum(0)
    return seen >= seen.median().clamp(min=1)


def _astray(problem: MarkerProblem, cost: Tensor) -> Tensor:
    """Return the mask of frames whose cost per marker stands out of the best fiftieth of the frames."""
    rating, enough = _cost_per_marker(problem, cost), _enough(problem)
    return rating > ASTRAY * rating[enough].quantile(0.02) if bool(enough.any()) else torch.zeros_like(enough)


def _cost_per_marker(problem: MarkerProblem, cost: Tensor) -> Tensor:
    """Return each frame's cost (frames,) divided by the number of its markers."""
    return cost / (problem.weight > 0).sum(0).clamp(min=1)


def _climb(problem: MarkerProblem, q: Tensor, cost: Tensor, xi: Tensor) -> None:
    """Solve frames that stand out of a neighbour again from it, for as long as that helps, in place.

    The steps reach a limb that is lost for so long that no good frame is near: one beside the lost ones always is.
    """
    for _ in range(CLIMB):
        rating = _cost_per_marker(problem, cost)
        wide = torch.nn.functional.pad(rating, (1, 1), value=torch.inf)
        steep = rating > CLIFF * torch.minimum(wide[:-2], wide[2:])
        index = (steep & _astray(problem, cost)).nonzero()[:, 0]
        beside = torch.where(wide[index] < wide[index + 2], index - 1, index + 1)
        if not len(index) or not _retried(problem, q, cost, xi, index, q[:, beside]):
            break


def _retried(problem: MarkerProblem, q: Tensor, cost: Tensor, xi: Tensor, index: Tensor, start: Tensor) -> bool:
    """Solve some frames from other postures, keep those that fare better in place, and return whether any did."""
    again, new = solve_poses(problem.frames(index), start, xi)
    better = new < 0.99 * cost[index]
    q[:, index[better]], cost[index[better]] = again[:, better], new[better]
    return bool(better.any())


FULL = 2.0 * torch.pi
"""A full turn [rad]."""


def turned_back(tree: Tree, posture: PosturePrior, q: Float[Tensor, "dofs frames"]) -> Float[Tensor, "dofs frames"]:
    """Return coordinates of the same poses, each joint by the angles that the posture prior finds likeliest.

    Every rotation has two triples of angles about three different axes, and every angle is the same a full turn away.
    From rest, an arm overhead may end on those beyond the joint's limits, where least squares stays for good: no angle
    changes without leaving the markers. A robust loss would then give up the limb's markers for the limits' sake.
    A hinge without limits stays as it is, because from frame to frame it has no far side; so does a coordinate that
    drives more than its turn, which is elsewhere after a full one.

    Args:
        tree: joints with their axes.
        posture: prior of the coordinates, with soft limits.
    """
    found = q.clone()
    bounded = (posture.upper - posture.lower).expand(len(q), -1)[:, 0] < 2.0 * FULL
    for k, body in enumerate(tree.bodies):
        moving = tree.own_turns(k)
        rows = [turn.row for turn in moving]
        if len(moving) == len(body.turns) == len({turn.axis for turn in moving}) == 3:
            found[rows] = _likelier(posture.rows(rows), q[rows], _triples(q[rows]))
        else:
            for row in (row for row in rows if bounded[row]):
                found[[row]] = _likelier(posture.rows([row]), q[[row]], q[[row]][None])
    return found


def _triples(q: Float[Tensor, "3 frames"]) -> Float[Tensor, "2 3 frames"]:
    """Return both triples of angles of one rotation; the other one is (a1 + pi, pi - a2, a3 + pi)."""
    return torch.stack([q, torch.stack([q[0] + torch.pi, torch.pi - q[1], q[2] + torch.pi])])


def _likelier(
    posture: PosturePrior, q: Float[Tensor, "angles frames"], ways: Float[Tensor, "ways angles frames"]
) -> Float[Tensor, "angles frames"]:
    """Return the likeliest of q and the ways, these with each angle within half a turn of the expected one."""
    options = torch.cat([q[None], ways - FULL * torch.round((ways - posture.mean) / FULL)])
    best = posture.cost(options).sum(1).argmin(0)
    return options.gather(0, best.expand(1, *q.shape))[0]
