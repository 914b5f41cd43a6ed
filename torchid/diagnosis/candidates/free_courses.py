"""Evidence of markers for a motion in fixed ways whose course in time is free."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.marker_scene import Sway
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.response_cache import ResponseCache


def evidence_of_courses(response: MarkerResponse, sways: Sequence[Sway], scales: Sequence[float]) -> list[float]:
    """Return the log evidence of each displacement in one trial, geometry held, the residuals' scatter as it is [nat].

    Args:
        response: markers of the trial.
        sways: displacements, each with its ways and the courses that may be combined.
        scales: prior standard deviation of the coefficient of every course, one for each displacement.
    """
    bands, fixed = response.bands, ResponseCache(response)
    shifts = [fixed.shown(sway.ways) for sway in sways]
    left = bands.left(torch.cat([*shifts, bands.error[None]]))
    *ways, residual = left.split([*(len(s) for s in shifts), 1])
    each = zip(ways, sways, scales, strict=True)
    return [_evidence(own, residual[0], sway.courses[:, bands.middle], scale, bands.free) for own, sway, scale in each]


def _evidence(
    left: Float[Tensor, "ways bins rows"],
    residual: Float[Tensor, "bins rows"],
    courses: Float[Tensor, "courses bins"],
    scale: float,
    free: float,
) -> float:
    """Return the log evidence of one displacement [nat].

    Args:
        left: what postures leave of its ways.
        residual: what they leave of the markers' errors.
        courses: courses that may be combined along each way.
        scale: prior standard deviation of the coefficients.
        free: share of the rows that remain free (``MarkerBands.free``).
    """
    spread = residual.square().sum() / (free * residual.numel())
    A = torch.einsum("itr,jtr->tij", left, left) / spread
    b = torch.einsum("itr,tr->ti", left, residual) / spread
    gram = scale**2 * torch.einsum("tij,kt,lt->ikjl", A, courses, courses).flatten(2).flatten(0, 1)
    moment = scale * torch.einsum("ti,kt->ik", b, courses).flatten()
    L = torch.linalg.cholesky(gram + torch.eye(len(gram)).to(gram))
    u = torch.linalg.solve_triangular(L, moment[:, None], upper=False)
    return float(0.5 * u.square().sum() - L.diagonal().log().sum())
