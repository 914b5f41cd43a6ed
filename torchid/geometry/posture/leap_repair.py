"""This module repairs short runs of frames in which a robust loss chose another explanation than around them.

Where a model lacks a freedom (shoulders that rise with the arms), giving up the markers of the shoulders or those of
the pelvis can cost about the same, and the posture may leap from one to the other and back.
"""

from itertools import combinations, pairwise

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.posture.initial_posture import hold
from torchid.geometry.problem import MarkerProblem

LEAP = 0.03
"""A leap changes both the pace of a modelled marker and its way from the measured one by more than this [m]; chosen.

The first alone happens to a foot that strikes the floor, the second alone to a label that jumps.
"""
LONGEST_S = 0.4
"""Longest run [s]; chosen, because what lasts longer may be right, and what is around it wrong."""
TRIED = 12
"""Runs that are tried at most; chosen."""
CHEAPER = 0.99
"""A run is regained when it costs less than this share of what it did; chosen."""
DEARER = 2.0
"""A run is steadied when it costs at most this many times what it did; chosen."""


def steadied(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    rate_hz: float,
    near: Float[Tensor, "dofs frames"] | None = None,
) -> Float[Tensor, "dofs frames"]:
    """Follow runs between two leaps frame by frame from what is before them, and keep those without a leap.

    The longest run is tried first: of several leaps, the outermost lead back to what most frames have.

    Args:
        problem: consecutive frames of one trial.
        q: postures of all frames.
        xi: geometry and marker places.
        rate_hz: frame rate [Hz].
        near: postures that were steadied before and from which a run is followed, all frames at once; None follows
            each frame from the one before it.

    Returns:
        The postures of all frames.
    """
    longest = round(LONGEST_S * rate_hz)
    tried: set[tuple[int, int]] = set()
    for _ in range(TRIED):
        at = leaps(problem, q, xi).tolist()
        runs = [(a, b) for a, b in combinations(at, 2) if b - a <= longest and (a, b) not in tried]
        if not runs:
            break
        first, last = max(runs, key=lambda run: run[1] - run[0])
        tried.add((first, last))
        found = (
            _followed(problem, q, xi, first, last)
            if near is None
            else _followed_near(problem, q, xi, first, last, near)
        )
        q = q if found is None or _worse(problem, q, found, xi, first, last) else found
    return q


def regained(
    problem: MarkerProblem, q: Float[Tensor, "dofs frames"], xi: Float[Tensor, " xi"], rate_hz: float
) -> Float[Tensor, "dofs frames"]:
    """Follow runs to which the model leaps and back from the frames beside them, and keep those that cost less.

    Where an upper arm is lost, its forearm alone allows two, and rest may lead to the dearer one.

    Args:
        problem: consecutive frames of one trial.
        q: postures of all frames.
        xi: geometry and marker places.
        rate_hz: frame rate [Hz].

    Returns:
        The postures of all frames.
    """
    at = (_pace_change(problem.residual(q, xi)[1]) > LEAP).any(0).nonzero()[:, 0].tolist()
    runs = [torch.arange(a + 1, b + 1) for a, b in pairwise(at) if b - a <= round(LONGEST_S * rate_hz)]
    if not runs:
        return q
    some, good = torch.cat(runs).to(q.device), torch.ones(q.shape[1], dtype=torch.bool, device=q.device)
    good[some] = False
    part, lengths, found = problem.frames(some), [len(run) for run in runs], q.clone()
    again, cost = solve_poses(part, hold(q, good)[:, some], xi)
    sides = (x.split(lengths, dim=-1) for x in (part.frame_cost(q[:, some], xi), cost, again))
    for run, before, after, posture in zip(runs, *sides, strict=True):
        if after.sum() < CHEAPER * before.sum():
            found[:, run] = posture
    return found


def leaps(problem: MarkerProblem, q: Float[Tensor, "dofs frames"], xi: Float[Tensor, " xi"]) -> Int[Tensor, " leaps"]:
    """Return the indices of the frames after which the model leaps and the markers do not.

    Args:
        problem: consecutive frames of one trial.
        q: postures of all frames.
        xi: geometry and marker places.
    """
    _, p, residual = problem.residual(q, xi)
    both = (problem.weight[:, 1:] > 0) & (problem.weight[:, :-1] > 0)
    away = torch.where(both, residual.diff(dim=2).norm(dim=1), 0.0)
    return (torch.minimum(away, _pace_change(p)) > LEAP).any(0).nonzero()[:, 0]


def _pace_change(p: Float[Tensor, "markers 3 frames"]) -> Float[Tensor, "markers steps"]:
    """Return the change of each modelled marker's step to the next frame against the step before it [m]."""
    return torch.nn.functional.pad(p.diff(dim=2).diff(dim=2).norm(dim=1), (1, 0))


def _followed(problem: MarkerProblem, q: Tensor, xi: Tensor, first: int, last: int) -> Tensor | None:
    """Follow each frame after ``first`` up to ``last`` from the one before it; return None where they leap."""
    found = q.clone()
    for k in range(first + 1, last + 1):
        found[:, k : k + 1], _ = solve_poses(problem.frames(slice(k, k + 1)), found[:, k - 1 : k], xi)
        behind = slice(max(first - 1, k - 2, 0), k + 1)
        if len(leaps(problem.frames(behind), found[:, behind], xi)):
            return None
    return found


def _followed_near(problem: MarkerProblem, q: Tensor, xi: Tensor, first: int, last: int, near: Tensor) -> Tensor:
    """Follow each frame after ``first`` up to ``last`` from the posture near it."""
    found, run = q.clone(), slice(first + 1, last + 1)
    found[:, run], _ = solve_poses(problem.frames(run), near[:, run], xi)
    return found


def _worse(problem: MarkerProblem, q: Tensor, found: Tensor, xi: Tensor, first: int, last: int) -> bool:
    """Return whether a run that was found costs too much, or does not end where the other frames go on."""
    around = slice(max(first - 1, 0), last + 2)
    part = problem.frames(around)
    dearer = part.frame_cost(found[:, around], xi).sum() > DEARER * part.frame_cost(q[:, around], xi).sum()
    return bool(dearer) or len(leaps(part, found[:, around], xi)) > 0
