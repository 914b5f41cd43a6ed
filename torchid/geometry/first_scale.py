"""This module gives a subject the first scale, from landmarks alone, and places all other markers on it."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError, Note
from torchid.geometry.arrow.solver import solve_arrow
from torchid.geometry.attachment import Attachment
from torchid.geometry.marker_weights import stated_sigma
from torchid.geometry.options import GeometryOptions
from torchid.geometry.posture.initial_posture import evenly
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.result import GeometryFit, fixed, parameters
from torchid.geometry.trial_problem import posture_prior, settled, side_by_side, trial_problem
from torchid.model.model import Model
from torchid.recording import Markers

LANDMARK_SIGMA = 0.02
"""Landmark markers scatter this much about the template's places while only they are followed [m].

The value is chosen, wide because the template is not scaled yet.
"""


def start_fit(
    model: Model,
    attachment: Attachment,
    trials: dict[str, Markers],
    static: Markers | None,
    options: GeometryOptions = GeometryOptions(),
    free: bool = True,
) -> GeometryFit:
    """Scale the template and place the markers once, before any joint fit.

    A static trial is preferred; without one, some frames of the longest motion trial serve, and a note says so.

    Args:
        model: template, bodies without markers locked.
        static: standing trial in (about) the neutral pose, None if there is none.
        options: scatter of the markers, symmetry, groups and number of static frames.
        free: False keeps the template's geometry and finds only where the markers sit.

    Returns:
        The fit with its first xi, without uncertainty and solution.

    Raises:
        ConfigError: ``geometry.group``, when the options name a group of parameters that cannot be one.
        DataError: ``geometry.static``, when the static trial shows none of the markers.
    """
    prior = parameters(model, options) if free else fixed(model.geometry)
    xi = torch.cat([prior.mean, attachment.mean.reshape(-1)])
    fit = GeometryFit(model, attachment, prior, xi, stated_sigma(attachment, options), options)
    if static is not None:
        return _from_static(fit, static)
    note = Note("geometry.no_static", "no static trial: scaled and placed from the motion trials")
    return replace(_from_landmarks(fit, trials), notes=(note,))


def _from_static(fit: GeometryFit, static: Markers) -> GeometryFit:
    """Scale the template to a standing subject and place the markers: landmarks first, then everything."""
    index = evenly(len(static.time), fit.options.static_frames)
    problem = trial_problem(fit, static, posture_prior(fit, fit.options.static_posture_sd), index)
    if not bool((problem.weight > 0).any()):
        raise DataError(
            "geometry.static", "the static trial shows none of the subject's markers",
            remedy="Correct markers: for this trial's labels, or give it the role fit",
        )  # fmt: skip
    problem = replace(problem, robust=None)
    q = _follow_landmarks(fit, problem)
    return replace(fit, xi=solve_arrow(side_by_side([problem]), q, _placed(problem, q, fit), tolerance=1e-6).xi)


def _from_landmarks(fit: GeometryFit, trials: dict[str, Markers]) -> GeometryFit:
    """Follow the landmarks through some frames of the longest trial and place all other markers on them."""
    longest = max(trials.values(), key=lambda m: len(m.time))
    problem = trial_problem(fit, longest, posture_prior(fit), evenly(len(longest.time), 4 * fit.options.static_frames))
    return replace(fit, xi=_placed(problem, _follow_landmarks(fit, problem), fit))


def _follow_landmarks(fit: GeometryFit, problem: MarkerProblem) -> Float[Tensor, "dofs frames"]:
    """Find the postures in which the landmark markers alone are where the template has them."""
    known = fit.attachment.known.to(problem.weight)
    weight = (problem.weight > 0) * known[:, None] / LANDMARK_SIGMA**2
    return settled(fit, replace(problem, robust=None, weight=weight))


def _placed(problem: MarkerProblem, q: Float[Tensor, "dofs frames"], fit: GeometryFit) -> Float[Tensor, " xi"]:
    """Return xi with every marker that is on no landmark put where the poses at q see it on its segment."""
    at, _, _ = problem.residual(q, fit.xi)
    R = at.R[problem.body]
    local = torch.einsum("maxt,mxt->mat", R, problem.target - at.p[problem.body])
    seen = (problem.weight > 0).to(local)
    mean = (local * seen[:, None]).sum(2) / seen.sum(1).clamp(min=1.0)[:, None]
    move = ~fit.attachment.known & (seen.sum(1) > 0)
    place = torch.where(move[:, None], mean, fit.place)
    return torch.cat([fit.xi[: len(fit.prior.mean)], place.reshape(-1)])
