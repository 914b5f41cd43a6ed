"""How far each marker scatters about its place, and what it therefore weighs: white noise, and skin that slides."""

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
"""Skin over the limbs' muscles slides about twice as far as over the bony points of pelvis and thorax (Leardini et al.,
Gait & Posture 21, 2005; Peters et al., Gait & Posture 31, 2010); a foot also bends where the model is rigid."""
CHI2_MEDIAN = 2.366
"""Median of the squared length of a vector of three standard normals."""


def stated_sigma(attachment: Attachment, options: GeometryOptions) -> Float[Tensor, " markers"]:
    """Scatter of each marker as the options state it [m]."""
    given = options.sigma_mm
    values = [given.get(label, 5.0) if isinstance(given, dict) else given for label in attachment.labels]
    return attachment.mean.new_tensor(values) * 1e-3


def reweighted(
    fit: GeometryFit, problem: MarkerProblem, solution: Solution, lengths: tuple[int, ...]
) -> tuple[GeometryFit, MarkerProblem]:
    """Weights that match the residuals of a solution; also the fit with the scatter found.

    Args:
        fit: whose options say whether the scatter is estimated again.
        problem: from ``joint_problem``.
        solution: of that problem.
        lengths: frames of each trial in it.
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
    """Scatter per marker: white noise, the same for all, and skin that slides, in proportion to ``looseness``.

    Half the mean square of successive differences is the white part; what the residuals hold beyond it is skin.
    A scatter of its own for every marker, from its residuals, is a trap: a foot's three markers are fitted by the
    foot's own freedom, seem exact, and lead the pelvis through the leg. On real walks it raised the force residual
    from 25 N to 41 N (with leverage taken into account: 32 N).
    """
    residual = torch.where(seen[:, None], residual, torch.nan)
    lost = len(fit.model.tree.dofs) / (3.0 * seen.sum(0).double().mean())
    steps = torch.cat([torch.diff(piece, dim=2) for piece in residual.split(list(lengths), dim=2)], dim=2)
    total, white = (_median_square(x) / (1.0 - lost).clamp(min=0.2) for x in (residual, steps))
    white = torch.minimum(0.5 * white, total)
    loose = _looseness(fit).square()
    return (white + (total - white) * loose / loose.mean()).sqrt().clamp(min=1e-4)


def _median_square(vectors: Float[Tensor, "markers 3 frames"]) -> Float[Tensor, ""]:
    """Variance per coordinate, robustly; NaN are passed over."""
    return vectors.square().sum(1).nanmedian() / CHI2_MEDIAN


def _looseness(fit: GeometryFit) -> Float[Tensor, " markers"]:
    """How much more than a trunk marker each marker slides: as configured by label, else by its segment."""
    given, names = fit.options.sigma_mm, fit.model.tree.names
    if isinstance(given, dict):
        return stated_sigma(fit.attachment, fit.options)
    return fit.xi.new_tensor([LOOSE.get(names[int(body)].split("_")[0], 1.0) for body in fit.attachment.body])
