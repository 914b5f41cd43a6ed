"""This module estimates how far each marker scatters, as white noise and as skin that slides, and weighs it by that."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.geometry.arrow.solver import Solution
from torchid.geometry.attachment import Attachment
from torchid.geometry.options import GeometryOptions
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.result import GeometryFit
from torchid.geometry.uncertainty import independent_share

LOOSE = {"thigh": 2.0, "shank": 2.0, "foot": 2.0, "upper": 2.0, "forearm": 2.0, "hand": 2.0}
"""Skin over the limbs slides this many times as far as over the bony points of pelvis and thorax.

The factor is a choice. Of the lower limb, skin slides most on the thigh (Leardini et al., Gait & Posture 21, 2005); a
foot also bends where the model is rigid.
"""
CHI2_MEDIAN = 2.366
"""Median of chi-squared with three degrees of freedom, the squared length of three standard normals; derived."""


def stated_sigma(attachment: Attachment, options: GeometryOptions) -> Float[Tensor, " markers"]:
    """Return the scatter of each marker as the options state it [m]; labels without an entry have 5 mm."""
    given = options.sigma_mm
    values = [given.get(label, 5.0) if isinstance(given, dict) else given for label in attachment.labels]
    return attachment.mean.new_tensor(values) * 1e-3


def reweighted(
    fit: GeometryFit, problem: MarkerProblem, solution: Solution, lengths: tuple[int, ...]
) -> tuple[GeometryFit, MarkerProblem]:
    """Weigh the markers of a problem to match the residuals of its solution.

    Args:
        fit: whose options say whether the scatter is estimated again.
        problem: from ``joint_problem``.
        lengths: frames of each trial in it.

    Returns:
        The fit with the scatter found, and the problem with weights 1 / sigma^2 times the share of frames that count
        as independent [1/m^2].
    """
    _, _, residual = problem.residual(solution.q, solution.xi)
    seen = problem.weight > 0
    share = independent_share(torch.where(seen[:, None], residual, torch.nan), lengths)
    if fit.options.reestimate_sigma:
        fit = replace(fit, sigma=_residual_sigma(fit, seen, residual, lengths))
    return fit, replace(problem, weight=seen * (share / fit.sigma.square())[:, None])


def _residual_sigma(
    fit: GeometryFit,
    seen: Bool[Tensor, "markers frames"],
    residual: Float[Tensor, "markers 3 frames"],
    lengths: tuple[int, ...],
) -> Float[Tensor, " markers"]:
    """Return the scatter per marker: white noise, the same for all, and skin that slides, in proportion to looseness.

    Half the mean square of successive differences is the white part (von Neumann 1941); what the residuals hold beyond
    it is skin. Markers have no scatter of their own, because three markers of a foot are fitted by the foot's own
    freedom, seem exact, and would lead the pelvis through the leg (`docs/decisions.md`, Geometry).
    """
    residual = torch.where(seen[:, None], residual, torch.nan)
    lost = len(fit.model.tree.dofs) / (3.0 * seen.sum(0).double().mean())
    steps = torch.cat([torch.diff(piece, dim=2) for piece in residual.split(list(lengths), dim=2)], dim=2)
    total, white = (_median_square(x) / (1.0 - lost).clamp(min=0.2) for x in (residual, steps))
    white = torch.minimum(0.5 * white, total)
    loose = looseness(fit).square()
    return (white + (total - white) * loose / loose.mean()).sqrt().clamp(min=1e-4)


def _median_square(vectors: Float[Tensor, "markers 3 frames"]) -> Float[Tensor, ""]:
    """Return the variance per coordinate from the median squared length, NaN passed over."""
    return vectors.square().sum(1).nanmedian() / CHI2_MEDIAN


def looseness(fit: GeometryFit) -> Float[Tensor, " markers"]:
    """Return how much more than a trunk marker each marker slides: as configured by label, else by its segment.

    Args:
        fit: with its markers and options.
    """
    given, names = fit.options.sigma_mm, fit.model.tree.names
    if isinstance(given, dict):
        return stated_sigma(fit.attachment, fit.options)
    return fit.xi.new_tensor([LOOSE.get(names[int(body)].split("_")[0], 1.0) for body in fit.attachment.body])
