"""This module is the geometric fit of a subject: a first scale, then all fit trials and the static one jointly."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError, Note
from torchid.geometry.arrow.solver import OnIteration, Solution, solve_arrow
from torchid.geometry.attachment import Attachment
from torchid.geometry.gradient_solvers import solve_adam, solve_lbfgs
from torchid.geometry.marker_weights import looseness, reweighted, stated_sigma
from torchid.geometry.options import GeometryOptions
from torchid.geometry.posture.initial_posture import evenly
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.result import GeometryFit, fixed, parameters
from torchid.geometry.trial_problem import posture_prior, settled, side_by_side, trial_problem
from torchid.geometry.uncertainty import estimate_uncertainty
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


ROUNDS = 3
"""The joint problem is solved so many times, and all but the last set the weights of the next; chosen."""
WEIGHTS_TOLERANCE = 1e-4
"""Fits whose residuals only set weights stop at this relative fall of the cost; chosen."""


def fit_geometry(
    model: Model,
    attachment: Attachment,
    trials: dict[str, Markers],
    static: Markers | None,
    options: GeometryOptions = GeometryOptions(),
    free: bool = True,
    progress: OnIteration | None = None,
    near: GeometryFit | None = None,
) -> GeometryFit:
    """Identify the geometry of a subject and the places of the markers on the segments.

    Args:
        model: template, bodies without markers locked.
        attachment: markers on its bodies.
        trials: fit trials by name.
        static: standing trial in (about) the neutral pose, None if there is none.
        options: see ``GeometryOptions``.
        free: False keeps the template's geometry and finds only where the markers sit (the scaled template).
        progress: called after every iteration of the joint fit.
        near: fit of the same model, attachment, options and frames to nearly these markers, from whose solution to
            begin; None begins from the template.

    Returns:
        The fit with its uncertainty and solution; both are None where ``free`` is False and the static trial placed the
        markers already.

    Raises:
        ConfigError: ``geometry.group``, when the options name a group of parameters that cannot be one.
        DataError: ``geometry.static``, when the static trial shows none of the markers.
    """
    if near is not None and near.solution is not None:
        return _fit_jointly(replace(near, uncertainty=None, solution=None), trials, static, progress, near.solution)
    fit = start_fit(model, attachment, trials, static, options, free)
    if not free and static is not None:
        return fit
    return _fit_jointly(fit, trials, static, progress)


def _fit_jointly(
    fit: GeometryFit, trials: dict[str, Markers], static: Markers | None, progress: OnIteration | None,
    near: Solution | None = None,
) -> GeometryFit:  # fmt: skip
    """Solve all fit trials and the static one as one problem, three times, with weights from the residuals before.

    A marker weighs 1 / sigma^2 times the share of its frames that count as independent: skin that slides the same way
    for a second is one observation, not a hundred, and would otherwise drag joint centres away from any prior. A
    solution near by stands for the first one.
    """
    problem, q, lengths = joint_problem(fit, trials, static, None if near is None else near.q)
    if near is None:
        solution = _run_solver(fit, replace(problem, robust=None), q, fit.xi, WEIGHTS_TOLERANCE, progress)
    else:
        solution = replace(near, q=q)
    for tolerance in (*[WEIGHTS_TOLERANCE] * (ROUNDS - 2), fit.options.tolerance):
        fit, problem = reweighted(fit, problem, solution, lengths)
        solution = _run_solver(fit, problem, solution.q, solution.xi, tolerance, progress)
    return finish_fit(fit, problem, solution)


def joint_problem(
    fit: GeometryFit, trials: dict[str, Markers], static: Markers | None,
    near: Float[Tensor, "dofs frames"] | None = None,
) -> tuple[MarkerProblem, Tensor, tuple[int, ...]]:  # fmt: skip
    """Build the joint problem of all fit trials and the static one, and solve its postures at the fit's geometry.

    Args:
        fit: first scale of the subject.
        trials: fit trials by name; of all of them together at most ``options.max_frames`` frames are taken.
        static: standing trial, None if there is none.
        near: postures of the same frames that are nearly right; None finds them from rest.

    Returns:
        The problem, the postures to start from (dofs, frames), and the number of frames of each trial.
    """
    pieces, at = [], 0
    for markers in joint_frames(trials, static, fit.options):
        posture = posture_prior(fit, fit.options.static_posture_sd if len(pieces) == len(trials) else None)
        problem = trial_problem(fit, markers, posture)
        at, first = at + len(markers.time), at
        pieces.append((problem, settled(fit, problem, None if near is None else near[:, first:at])))
    q = torch.cat([piece[1] for piece in pieces], dim=1)
    return side_by_side([piece[0] for piece in pieces]), q, tuple(piece[1].shape[1] for piece in pieces)


def joint_frames(trials: dict[str, Markers], static: Markers | None, options: GeometryOptions) -> list[Markers]:
    """Return the frames of each fit trial, and of the static one behind them, that the joint problem takes."""
    total = sum(len(m.time) for m in trials.values())
    share = min(1.0, options.max_frames / max(total, 1))
    found = [m.frames(evenly(len(m.time), max(2, round(share * len(m.time))))) for m in trials.values()]
    return found if static is None else [*found, static.frames(evenly(len(static.time), options.static_frames))]


def _run_solver(
    fit: GeometryFit, problem: MarkerProblem, q: Tensor, xi: Tensor, tolerance: float, progress: OnIteration | None
) -> Solution:
    """Minimise with the solver that the options name."""
    options = fit.options
    if options.solver == "adam":
        return solve_adam(problem, q, xi, options.gradient_iterations, progress)
    if options.solver == "lbfgs":
        return solve_lbfgs(problem, q, xi, options.gradient_iterations, progress)
    return solve_arrow(problem, q, xi, options.iterations, tolerance, progress)


def finish_fit(fit: GeometryFit, problem: MarkerProblem, solution: Solution) -> GeometryFit:
    """Return the fit at a solution of the joint problem, with its uncertainty from the chain's Jacobians."""
    uncertainty = estimate_uncertainty(problem, solution.q, solution.xi, fit.names, looseness(fit))
    return replace(fit, xi=solution.xi, solution=solution, uncertainty=uncertainty)
