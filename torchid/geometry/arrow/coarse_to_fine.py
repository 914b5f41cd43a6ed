"""This module works from coarse to fine in time: a few frames solved first give the others their start.

Frames keep the start that fits them better, so the order of the frames may break (trials side by side) without harm.
The joint fit alone goes this way; inverse kinematics gains nothing (`docs/decisions.md`, Geometry).
"""

from dataclasses import replace

import torch
from torch import Tensor

from torchid.geometry.problem import MarkerProblem, retract
from torchid.model.rotation import rotation_matrix, rotation_vector
from torchid.model.tree import BASE_DOFS

STRIDE = 10
"""Distance of the frames that go first; chosen."""
FEWEST = 20
"""Fewer coarse frames than this are not worth the detour; chosen."""
FAR = 1.0
"""Neighbours further apart than this [rad or m] lie on different branches of the angles and have no mean; chosen."""


def coarse_frames(q: Tensor) -> Tensor:
    """Return the indices of the frames of q (dofs, frames) that go first."""
    return torch.arange(STRIDE // 2, q.shape[1], STRIDE, device=q.device)


def coarse_problem(problem: MarkerProblem, few: Tensor) -> MarkerProblem:
    """Return the problem on few frames, with the prior on xi as weak against them as against all.

    Args:
        few: indices of the frames to take.
    """
    loose = (problem.target.shape[2] / len(few)) ** 0.5
    geometry = replace(problem.geometry, sd=problem.geometry.sd * loose)
    return replace(problem.frames(few), geometry=geometry, place_sd=problem.place_sd * loose)


def between(solved: Tensor, few: Tensor, frames: int) -> Tensor:
    """Interpolate coordinates by cubics through the given frames (Catmull & Rom 1974).

    Between neighbours further apart than ``FAR`` the nearer one is taken.

    Args:
        solved: coordinates of the given frames (dofs, len(few)).
        few: indices of the given frames, ascending.

    Returns:
        Coordinates of all frames (dofs, frames).
    """
    last = len(few) - 1
    every = torch.arange(frames, device=solved.device)
    right = torch.searchsorted(few, every).clamp(min=1, max=last)
    s = ((every - few[right - 1]) / (few[right] - few[right - 1])).to(solved).clamp(0.0, 1.0)
    before = solved[:, right - 1]
    changes = [_increment(before, solved[:, k]) for k in ((right - 2).clamp(min=0), right, (right + 1).clamp(max=last))]
    far = torch.stack(changes).abs().amax((0, 1)) > FAR
    weights = (0.5 * (2 * s**2 - s**3 - s), 0.5 * (s + 4 * s**2 - 3 * s**3), 0.5 * (s**3 - s**2))
    nearest = (torch.zeros_like(s), s.round(), torch.zeros_like(s))
    steps = [torch.where(far, n, w) * c for n, w, c in zip(nearest, weights, changes, strict=True)]
    return retract(before, torch.stack(steps).sum(0))


def _increment(before: Tensor, after: Tensor) -> Tensor:
    """Return the increment with which ``retract`` leads from ``before`` to ``after``."""
    change = after - before
    R = rotation_matrix(after[3:BASE_DOFS].T) @ rotation_matrix(before[3:BASE_DOFS].T).mT
    change[3:BASE_DOFS] = rotation_vector(R).T
    return change


def better_start(problem: MarkerProblem, q: Tensor, other: Tensor, xi: Tensor, chunk: int = 1024) -> Tensor:
    """Choose, frame by frame, the one of two starts with the smaller cost.

    Args:
        q: first start (dofs, frames).
        other: second start (dofs, frames).
        chunk: frames to evaluate at a time.
    """
    picked = torch.empty_like(q)
    for start in range(0, q.shape[1], chunk):
        part = slice(start, start + chunk)
        piece = problem.frames(part)
        first, second = piece.frame_cost(q[:, part], xi), piece.frame_cost(other[:, part], xi)
        picked[:, part] = torch.where(second < first, other[:, part], q[:, part])
    return picked
