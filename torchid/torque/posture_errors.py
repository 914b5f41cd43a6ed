"""How far postures that were found from markers may be off: a precision for every frame, and how it grows with
frequency.

Errors of markers have the spectrum that their residuals show. What all markers of a segment do together shows in no
residual; it is as large, times ``TOGETHER``. Both of one spectrum, so that the precision of a course of postures is
that of a frame times a polynomial of the squared frequency, which is a penalty on the course and its derivatives.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.whitening import cosine_matrix
from torchid.filters import Smoother
from torchid.observation.marker_response import MarkerResponse
from torchid.torque.bodies import TOGETHER, TURN_PER_SHIFT
from torchid.torque.seen import KEPT

LEAST = 1e-4
"""Resolution. Least power of errors, relative to the scatter of the fit: markers without any leave no postures."""
BEYOND = 2.0
"""Resolution. Frequency up to which errors are looked at, over the cut-off: splines of the change reach as far."""
UNSEEN = 0.1
"""Choice. Standard deviation of every coordinate beside what markers say [rad, m]: which of two joints of the spine
turned, or whether a forearm did, markers hardly tell, and plates must not."""
STEPS = 100
"""Resolution. Steps in which the spectrum's numbers are found."""
TERMS = 3
"""Resolution. Numbers of a spectrum: there is one for the square of a course and of either derivative."""


def posture_precision(response: MarkerResponse) -> Float[Tensor, "frames dofs dofs"]:
    """Return the inverse covariance of postures under errors of markers as large as the scatter of the fit.

    Markers of a segment tell its pose with a precision that is constant in its axes. To its inverse is added how far
    all of them slide and turn as one; the precision is what is left.
    """
    sight, scene = response.sight, response.sight.scene
    own = _pose_precision(response)
    R = scene.state.at.R.permute(3, 0, 2, 1)
    both = R.new_zeros(*R.shape[:2], 6, 6)
    both[..., :3, :3] = both[..., 3:, 3:] = R
    seen = sight.body.unique()
    carried = response.carriage.unflatten(1, (-1, 6))[:, seen]
    turned = both[:, seen] @ own[seen] @ both[:, seen].mT
    H = carried.flatten(1, 2).mT @ (turned @ carried).flatten(1, 2)
    torch.diagonal(H, dim1=1, dim2=2).add_(UNSEEN**-2)
    return H


def _pose_precision(response: MarkerResponse) -> Float[Tensor, "bodies 6 6"]:
    """Precision of the place and turn of each body's markers in its axes [1/m^2, 1/rad^2]."""
    sight, weight = response.sight, response.mean_weight
    p, count = sight.p_BM_B, len(sight.scene.tree.names)
    arm = torch.linalg.cross(torch.eye(3).to(p).expand(len(p), 3, 3), p[:, None].expand(-1, 3, -1), dim=2).mT
    lever = torch.cat([torch.eye(3).to(p).expand(len(p), 3, 3), arm], 2)
    told = p.new_zeros(count, 6, 6).index_add(0, sight.body, weight[:, None, None] * lever.mT @ lever)
    scatter = (weight > 0.0).sum() / weight.sum().clamp(min=torch.finfo(weight.dtype).tiny)
    together = scatter * TOGETHER**2 * torch.tensor([1.0] * 3 + [TURN_PER_SHIFT**2] * 3).to(p).diag()
    return torch.linalg.solve(torch.eye(6).to(p) + told @ together, told)


def error_penalty(response: MarkerResponse, smoother: Smoother) -> Float[Tensor, " 3"]:
    """Return weights of the squares of a course and of its first and second derivative [1, s^2, s^4].

    Per frame and times ``posture_precision`` they are the precision of a course of postures: one over the power of the
    errors, as a polynomial of the squared frequency whose likelihood is largest (Whittle, Ark Mat 2:423 (1953)).

    Args:
        smoother: filter that the motion has passed, and errors of markers with it.
    """
    frequency, power = _error_power(response, BEYOND * smoother.cutoff_hz)
    power = (power * smoother.response(frequency).square()).clamp(min=LEAST)
    squared = (2.0 * math.pi * frequency).square()
    terms = torch.stack([torch.ones_like(squared), squared, squared.square()], 1)
    logs = (1.0 / (3.0 * (power[:, None] * terms).mean(0))).log().requires_grad_(True)
    solver = torch.optim.LBFGS([logs], max_iter=STEPS, line_search_fn="strong_wolfe")

    def cost() -> Tensor:
        solver.zero_grad()
        precision = terms @ logs.exp()
        total = (power * precision - precision.log()).mean()
        total.backward()
        return total

    with torch.enable_grad():
        solver.step(cost)
    return logs.detach().exp()


def _error_power(response: MarkerResponse, highest_hz: float) -> tuple[Tensor, Tensor]:
    """Frequencies [Hz], and the mean square of the cosine coefficients of markers' errors, relative to the scatter of
    the fit. What postures take of an error is given back."""
    kept = response.bands.kept.view(-1, 3).mean(1).clamp(min=KEPT)
    scaled = response.error * (response.weight.sqrt() / kept.sqrt()[:, None])[:, None]
    frames, rate = scaled.shape[2], response.sight.scene.rate
    count = min(frames, max(TERMS + 1, math.ceil(2.0 * highest_hz * frames / rate)))
    C = cosine_matrix(frames, count).to(scaled)[1:]
    seen = (response.weight > 0.0).double().mean().clamp(min=1.0 / response.weight.numel())
    power = (scaled.flatten(0, 1) @ C.mT).square().mean(0) / seen
    return 0.5 * rate / frames * torch.arange(1, count).to(power), power
