"""This module is a temporal prior: where markers are missing, each coordinate is drawn to its own smooth course.

The prior is diagonal per frame (its mean is a smoothing spline through the current coordinates, weighted by what the
markers of each frame tell about each of them), so that the arrow keeps its shape. A robust loss needs it under gaps
(`docs/decisions.md`, Geometry).
"""

from dataclasses import replace

import torch
from torch import Tensor

from torchid.filters import Smoother
from torchid.geometry.arrow.index_tables import make_layout
from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.arrow.normal_blocks import posture_block
from torchid.geometry.problem import MarkerProblem, PosturePrior

SMOOTH = 0.06
"""Cut-off of the course as a share of the frame rate (6 Hz at 100 Hz); chosen."""
LEAST_SCATTER = 1e-3
"""Least scatter about the course [m or rad]; chosen."""
CHUNK = 256
"""Frames whose covariances are held at a time; chosen for memory."""


def bridge_gaps(
    problem: MarkerProblem, q: Tensor, xi: Tensor, typical: Tensor | None = None, rounds: int = 2
) -> Tensor:
    """Solve again, with the temporal prior, the frames that lack a marker which others show.

    A course is for what no marker tells: where those that are seen would pay for it, the frame stays as it was.

    Args:
        problem: consecutive frames of one trial.
        q: solution without the prior (dofs, frames).
        typical: variance (dofs, 1) of each coordinate in the trial that these frames are part of; None takes that in
            these frames.
        rounds: number of times that course and frames are found again from each other.

    Returns:
        The coordinates of all frames (dofs, frames).
    """
    gaps = _gaps(problem).nonzero()[:, 0]
    for _ in range(rounds if len(gaps) else 0):
        posture = smooth_course(problem, q, xi, typical)
        known, pulled = (one.frames(gaps) for one in (problem, replace(problem, posture=posture)))
        start = torch.where(pulled.posture.precision > problem.posture.precision, pulled.posture.mean, q[:, gaps])
        drawn, q = solve_poses(pulled, start, xi)[0], q.clone()
        paid = known.frame_cost(drawn, xi) - known.frame_cost(q[:, gaps], xi)
        kept = paid < 0.5 * len(q)
        q[:, gaps[kept]] = drawn[:, kept]
    return q


def _gaps(problem: MarkerProblem) -> Tensor:
    """Return the mask of frames that lack a marker which is seen in others."""
    seen = problem.weight > 0
    return (~seen[seen.any(1)]).any(0)


def smooth_course(problem: MarkerProblem, q: Tensor, xi: Tensor, typical: Tensor | None = None) -> PosturePrior:
    """Return the posture prior with the smooth course of each coordinate where its frame lacks a marker.

    Args:
        problem: consecutive frames of one trial.
        q: solution without the course (dofs, frames).
        typical: variance (dofs, 1) of each coordinate with all markers; None takes the median of these frames.
    """
    variance = _variance(problem, q, xi)
    typical = variance.median(dim=1, keepdim=True).values if typical is None else typical
    weight = (typical / variance).clamp(max=1.0)
    smoother = Smoother(SMOOTH, 1.0)
    course = torch.stack([smoother(row, w.clamp(min=1e-9)) for row, w in zip(q, weight, strict=True)])
    sure = weight > 0.5
    scatter = torch.where(sure, (q - course).abs(), torch.nan).nanmedian(dim=1, keepdim=True).values * 1.5
    precision = torch.nan_to_num(scatter, LEAST_SCATTER).clamp(min=LEAST_SCATTER).square().reciprocal()
    unsure = _gaps(problem) & (weight < 0.9)
    unsure[3:6] &= (q[3:6].diff(dim=1).abs().amax() < torch.pi).item()
    base = problem.posture
    return replace(
        base,
        mean=torch.where(unsure, course, base.mean),
        precision=torch.where(unsure, precision, base.precision),
    )


def typical_variance(problem: MarkerProblem, q: Tensor, xi: Tensor) -> Tensor:
    """Return the median over the frames of each coordinate's variance given its frame's markers (dofs, 1)."""
    return _variance(problem, q, xi).median(dim=1, keepdim=True).values


def _variance(problem: MarkerProblem, q: Tensor, xi: Tensor) -> Tensor:
    """Return the variance of each coordinate given the markers of its frame (dofs, frames)."""
    layout, out = make_layout(problem), torch.empty_like(q)
    for start in range(0, q.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        H = posture_block(problem.frames(part), layout, q[:, part], xi)
        torch.diagonal(H, dim1=1, dim2=2).add_(1e-3)
        L = torch.linalg.cholesky(H)
        eye = torch.eye(H.shape[1], dtype=H.dtype, device=H.device).expand_as(H)
        inverse = torch.linalg.solve_triangular(L, eye, upper=False)
        out[layout.dof_rows, start : start + CHUNK] = inverse.square().sum(1).T
    return out
