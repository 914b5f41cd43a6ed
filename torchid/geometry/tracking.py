"""This module follows the markers of a trial with the model at fixed geometry, held-out trials too."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.geometry.posture.continuity import continuous
from torchid.geometry.posture.gap_filling import bridge_gaps, typical_variance
from torchid.geometry.posture.initial_posture import evenly
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.result import GeometryFit
from torchid.geometry.trial_problem import posture_prior, settled, trial_problem
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import lengths, points, poses
from torchid.recording import Markers

PIECE = 8192
"""Frames followed at a time; chosen for memory (`docs/decisions.md`, Geometry)."""
SAMPLE = 2048
"""Frames that say how well the markers of a trial in pieces typically determine each coordinate; chosen.

The figure is taken once for the whole trial, because coordinates near the limit where a gap's course takes over would
otherwise change sides from piece to piece.
"""
BESIDE = 256
"""Frames on either side that are followed with a piece, so that gaps and lost limbs find their neighbours; chosen."""


@dataclass(frozen=True)
class Tracked:
    """The posture of every frame of a trial, and how far its markers are from the model."""

    time: Float[Tensor, " frames"]
    """Time of each frame [s]."""
    q: Float[Tensor, "frames dofs"]
    """Coordinates of the model [m or rad]."""
    error: Float[Tensor, "frames markers"]
    """Distance between measured and modelled marker, NaN where missing [m]."""
    observable: Bool[Tensor, " frames"]
    """True where the markers of the frame determine every coordinate."""

    def frames(self, part: slice) -> "Tracked":
        """Return the result for some of the frames."""
        return Tracked(self.time[part], self.q[part], self.error[part], self.observable[part])

    @property
    def rmse(self) -> float:
        """Return the root mean square of all distances that are not NaN [m]."""
        return float(self.error[torch.isfinite(self.error)].square().mean().sqrt())


def track(
    fit: GeometryFit, markers: Markers, bridge: bool | None = None, near: Float[Tensor, "frames dofs"] | None = None
) -> Tracked:
    """Follow the markers of a trial at the fit's geometry.

    Long trials are followed in overlapping pieces.

    Args:
        fit: geometry, places of the markers and their scatter.
        markers: paths of the trial's markers.
        bridge: True bridges gaps by the course around them; None does as the fit's options say.
        near: postures that followed nearly these markers and need only be mended; None finds postures from rest.

    Returns:
        Coordinates, distances and observable frames, for all frames of ``markers``.
    """
    frames, wanted = len(markers.time), fit.options.temporal if bridge is None else bridge
    q = fit.xi.new_empty(frames, len(fit.model.tree.dofs))
    error = fit.xi.new_empty(frames, len(fit.attachment.labels))
    observable = torch.empty(frames, dtype=torch.bool, device=fit.xi.device)
    typical = _sampled_variance(fit, markers) if wanted and frames > PIECE else None
    for start in range(0, frames, PIECE):
        first, stop = max(0, start - BESIDE), min(frames, start + PIECE)
        piece = slice(first, min(frames, stop + BESIDE))
        found = _track_piece(fit, markers.frames(piece), wanted, typical, None if near is None else near[piece].T)
        inner = slice(start - first, stop - first)
        for whole, part in zip((q, error, observable), found, strict=True):
            whole[start:stop] = part[inner]
    return Tracked(markers.time, q, error, observable)


def _sampled_variance(fit: GeometryFit, markers: Markers) -> Tensor:
    """Return the variance (dofs, 1) that the markers of a frame typically leave to each coordinate of the trial."""
    problem = trial_problem(fit, markers, posture_prior(fit), evenly(len(markers.time), SAMPLE))
    return typical_variance(problem, settled(fit, problem), fit.xi)


def _track_piece(
    fit: GeometryFit, markers: Markers, bridge: bool, typical: Tensor | None, near: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Return q (frames, dofs), distances (frames, markers) and observable frames of one piece of a trial."""
    problem = trial_problem(fit, markers, posture_prior(fit))
    q = settled(fit, problem, near)
    if q.shape[1] > 2:
        q = continuous(problem, q, fit.xi, markers.rate, near)
    if bridge and not bool((problem.weight > 0).all()):
        q = bridge_gaps(problem, q, fit.xi, typical)
    _, _, residual = problem.residual(q, fit.xi)
    error = torch.where(problem.weight > 0, lengths(residual), torch.nan)
    return q.T, error.T, _observable(problem)


def modelled(fit: GeometryFit, q: Float[Tensor, "frames dofs"]) -> Float[Tensor, "frames markers 3"]:
    """Return the positions p_WM_W of the fit's markers at these coordinates [m]."""
    plan = plan_tree(fit.model.tree)
    body = torch.tensor(plan.position, device=q.device)[fit.attachment.body]
    at = poses(plan, q.T.contiguous(), fit.geometry)
    return points(at, body, fit.place).permute(2, 0, 1)


def _observable(problem: MarkerProblem) -> Bool[Tensor, " frames"]:
    """Return the mask of frames in which every body that carries markers shows three, or all it has."""
    seen = (problem.weight > 0).to(torch.float64)
    ok = torch.ones(seen.shape[1], dtype=torch.bool, device=seen.device)
    for body in problem.body.unique():
        of = problem.body == body
        ok &= seen[of].sum(0) >= min(3, int(of.sum()))
    return ok
