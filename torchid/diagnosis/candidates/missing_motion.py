"""Joints whose markers follow a motion that the model lacks."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.joints import MissingDof
from torchid.effects.place import Place
from torchid.observation.response_cache import ResponseCache
from torchid.observation.trial import TrialObservation

JOINTS = 2
"""Joints proposed for each kind of missing motion."""


def loosest_joints(effect: MissingDof, observed: Sequence[TrialObservation]) -> tuple[Place, ...]:
    """Joints whose markers follow motion of their own, by the evidence of markers alone."""
    if observed[0].response is None:
        return ()
    places = effect.places([w.view for w in observed])
    score = torch.tensor([_loose(effect, places, w) for w in observed], dtype=torch.float64).sum(0)
    best = []
    for turning in (0.0, 1.0):
        own = [k for k, place in enumerate(places) if place.grid["turning"] == turning]
        best += sorted(own, key=lambda k: -float(score[k]))[:JOINTS]
    return tuple(replace(places[k], odds=1.0 / len(places)) for k in best)


def _loose(effect: MissingDof, places: Sequence[Place], observed: TrialObservation) -> list[float]:
    """Evidence of free courses of each joint in one trial, geometry held, residuals' scatter as it is."""
    response = observed.response
    assert response is not None
    bands, fixed = response.bands, ResponseCache(response)
    shifts, courses = [], []
    for place in places:
        sway = effect.sway(response.sight, place)
        shifts.append(fixed.shown(sway.ways))
        # Geometry that errs is a constant.
        courses.append(sway.courses[1:, bands.middle])
    left = bands.left(torch.cat([*shifts, bands.error[None]]))
    *ways, residual = left.split([*(len(s) for s in shifts), 1])
    each = zip(places, ways, courses, strict=True)
    return [_free(own, residual[0], modes, effect.scale(p)[0], bands.free) for p, own, modes in each]


def _free(
    left: Float[Tensor, "ways bins rows"],
    residual: Float[Tensor, "bins rows"],
    modes: Float[Tensor, "modes bins"],
    scale: float,
    free: float,
) -> float:
    """Evidence of courses along some ways that are combinations of modes with coefficients of this scale; ``free`` as
    in ``Coarse``."""
    spread = residual.square().sum() / (free * residual.numel())
    A = torch.einsum("itr,jtr->tij", left, left) / spread
    b = torch.einsum("itr,tr->ti", left, residual) / spread
    gram = scale**2 * torch.einsum("tij,kt,lt->ikjl", A, modes, modes).flatten(2).flatten(0, 1)
    moment = scale * torch.einsum("ti,kt->ik", b, modes).flatten()
    L = torch.linalg.cholesky(gram + torch.eye(len(gram)).to(gram))
    u = torch.linalg.solve_triangular(L, moment[:, None], upper=False)
    return float(0.5 * u.square().sum() - L.diagonal().log().sum())
