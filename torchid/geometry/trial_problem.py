"""This module builds the marker problem of one trial, with a prior on its postures, or of several side by side."""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.geometry.posture.initial_posture import initial_posture, mended, settle
from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.geometry.result import GeometryFit
from torchid.kinematics.plan import plan_tree
from torchid.recording import Markers

LIMITLESS = 1e6
"""A limit of this size stands for none [m or rad]; chosen, far beyond any coordinate."""


def trial_problem(
    fit: GeometryFit, markers: Markers, posture: PosturePrior, index: Int[Tensor, " frames"] | None = None
) -> MarkerProblem:
    """Build the problem of the subject's markers in one trial, weighed by their scatter.

    Args:
        posture: prior of the postures, from ``posture_prior``.
        index: frames to take; None takes all.
    """
    markers = markers if index is None else markers.frames(index)
    position = markers.select(fit.attachment.labels).position.to(fit.xi)
    seen = torch.isfinite(position).all(dim=2)
    plan = plan_tree(fit.model.tree)
    place = torch.tensor(plan.position, device=fit.xi.device)
    return MarkerProblem(
        plan=plan,
        geometry=fit.prior,
        body=place[fit.attachment.body],
        target=torch.where(seen[..., None], position, 0.0).permute(1, 2, 0).contiguous(),
        weight=(seen / fit.sigma.square()).T.contiguous(),
        place=fit.attachment.mean,
        place_sd=fit.attachment.sd,
        free=torch.arange(len(fit.attachment.labels), device=fit.xi.device),
        posture=posture,
        robust=fit.options.robust,
    )


def posture_prior(fit: GeometryFit, sd: float | None = None) -> PosturePrior:
    """Return the prior of joint angles about rest, with soft limits; the base is free.

    Args:
        fit: model with rest, scatter and limits of its joints.
        sd: scatter of all joint angles [rad]; None takes the model's.
    """
    dofs = fit.model.tree.dofs
    precision = fit.xi.new_tensor([(sd or dof.sd) ** -2 for dof in dofs])
    precision[:6] = 0.0
    column = lambda values: fit.xi.new_tensor(values)[:, None].clamp(-LIMITLESS, LIMITLESS)  # noqa: E731
    return PosturePrior(
        mean=_rest(fit)[:, None],
        precision=precision[:, None],
        lower=column([-LIMITLESS] * 6 + [dof.lower for dof in dofs[6:]]),
        upper=column([LIMITLESS] * 6 + [dof.upper for dof in dofs[6:]]),
        limit_precision=fit.options.limit_sd**-2,
    )


def settled(
    fit: GeometryFit, problem: MarkerProblem, near: Float[Tensor, "dofs frames"] | None = None
) -> Float[Tensor, "dofs frames"]:
    """Find the postures of all frames at the fit's geometry.

    Args:
        fit: geometry, places of the markers and rest.
        near: postures that are nearly right and need only be mended; None starts from rest.
    """
    if near is None:
        return settle(problem, initial_posture(problem, fit.xi, _rest(fit)), fit.xi)
    return mended(problem, near, fit.xi)


def _rest(fit: GeometryFit) -> Float[Tensor, " dofs"]:
    """Return the model's resting coordinates."""
    return fit.xi.new_tensor([dof.rest for dof in fit.model.tree.dofs])


def side_by_side(problems: list[MarkerProblem]) -> MarkerProblem:
    """Join the problems of several trials into one.

    The prior of the postures counts once a trial, not once a frame: a thousand weak pulls towards the neutral pose
    would outweigh the priors on joint centres and landmarks, which alone say where a segment's axes point.

    Args:
        problems: trials of one subject; all but frames and posture prior are taken from the first.

    Returns:
        The problem on all frames, trial after trial.
    """
    lengths = [p.target.shape[2] for p in problems]
    precision = [p.posture.precision.expand(-1, n) / n for p, n in zip(problems, lengths, strict=True)]
    mean = [p.posture.mean.expand(-1, n) for p, n in zip(problems, lengths, strict=True)]
    posture = problems[0].posture
    limit = posture.limit_precision / max(lengths)
    return replace(
        problems[0],
        target=torch.cat([p.target for p in problems], dim=2),
        weight=torch.cat([p.weight for p in problems], dim=1),
        posture=replace(
            posture, mean=torch.cat(mean, dim=1), precision=torch.cat(precision, dim=1), limit_precision=limit
        ),
    )
